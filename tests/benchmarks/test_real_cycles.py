"""Real cycles: which markers are given, and that constant offsets of the others are no error."""

from importlib import resources

import pytest
import torch

from benchmarks.real_cycles import OFFSET_EVERY, RealCycle, divided, judged, sixteen, together
from benchmarks.scans import observed_frames
from recon.body.landmarks import LANDMARKS_16, landmark
from recon.body.model import BodyModel
from recon.formats.motions import load_motion
from recon.ingest.markers.coverage import MarkerSet

FPS, FRAMES = 50.0, 31
LEFT_OUT = ("left_heel", "c7")


@pytest.fixture(scope="module")
def float_body() -> BodyModel:
    return BodyModel.load()


@pytest.fixture(scope="module")
def cycle(float_body) -> RealCycle:
    """Markers of a known motion, two of them 3 cm beside their landmarks."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion.resample(FPS).window(50, 50 + FRAMES)
    motion = motion.replace(start_time=0.0)
    posed = float_body.pose(motion)
    given = [landmark(name) for name in LANDMARKS_16[2:]]
    vertices = tuple(landmark(name) for name in LEFT_OUT)
    turns = posed.orientations[:, float_body.weights[list(vertices)].argmax(-1)]
    beside = torch.tensor([[0.03, 0.0, 0.0], [0.0, 0.0, -0.03]])
    points = posed.points(torch.tensor(given))
    return RealCycle(
        name="demo",
        given=sixteen(given, points, torch.ones(FRAMES, 14, dtype=torch.bool), FPS),
        labels=LEFT_OUT,
        vertices=vertices,
        positions=posed.points(torch.tensor(vertices)) + (turns @ beside[..., None])[..., 0],
        visible=torch.ones(FRAMES, 2, dtype=torch.bool),
        everything=motion,
    )


def test_landmarks_that_are_not_there_are_never_visible(cycle):
    assert cycle.landmarks == 14
    assert not cycle.given.visible[..., :2].any()
    assert cycle.given.visible[..., 2:].all()


def test_few_frames_are_those_at_the_anchors(cycle):
    seen = cycle.seen(5)
    frames = seen.visible[0].any(-1).nonzero()[:, 0].tolist()
    assert frames == observed_frames(FRAMES, 5).tolist()
    assert (seen.positions[~seen.visible] == 0).all()


def test_a_constant_offset_is_no_error_with_its_own_offset_and_one_without(cycle, float_body):
    found = judged(cycle.everything, cycle, float_body)
    assert set(found["left out"]) == set(LEFT_OUT)
    assert max(found["left out"].values()) < 0.1
    assert min(found["nominal"].values()) > 15


def test_frames_that_tell_the_offset_are_not_judged(cycle, float_body):
    shift = torch.zeros(FRAMES, 1, 1)
    shift[1::2] = 0.02
    moved = RealCycle(**{**vars(cycle), "positions": cycle.positions + shift})
    alone = torch.arange(FRAMES) % OFFSET_EVERY != 0
    expected = 1000 * 0.02 * 3**0.5 * alone[1::2].sum().item() / alone.sum().item()
    found = judged(moved.everything, moved, float_body)["left out"]
    assert found["c7"] == pytest.approx(expected, abs=0.1)


def test_markers_that_were_never_seen_in_the_offset_frames_are_not_judged(cycle, float_body):
    visible = cycle.visible.clone()
    visible[::OFFSET_EVERY, 0] = False
    found = judged(cycle.everything, RealCycle(**{**vars(cycle), "visible": visible}), float_body)
    assert set(found["left out"]) == {"c7"}


def test_one_marker_for_a_landmark_and_no_neighbour_on_it_among_the_judged():
    labels = ("RKNE", "RKNE2", "C7")
    vertices = (landmark("right_knee_lateral"),) * 2 + (landmark("c7"),)
    markers = MarkerSet(labels, vertices, (False,) * 3, torch.zeros(3, 3), ())
    visible = torch.ones(4, 3, dtype=torch.bool)
    visible[0, 0] = False
    assert divided(markers, visible) == ([1], [2])


def test_a_batch_is_as_long_as_its_longest(cycle):
    short = cycle.given.replace(
        positions=cycle.given.positions[:, :20], visible=cycle.given.visible[:, :20]
    )
    batch = together([short, cycle.given])
    assert batch.visible.shape == (2, FRAMES, 16)
    assert not batch.visible[0, 20:].any()
