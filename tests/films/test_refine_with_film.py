"""Estimates of networks refined with the film they were told from, rendered of a known motion."""

from pathlib import Path

import numpy as np
import pytest
import torch

import recon
from benchmarks.films.rendering import Actor, Set, render
from benchmarks.refine import RegressorErrors, estimated
from observations.correspondences import PLACES, BodyPoints
from recon import cli
from recon.core import rotations as so3
from recon.core.camera import Camera, pose_looking_at
from recon.core.skeleton import FEET
from recon.detections.records import detections_of_rows
from recon.detections.tables import detection_arrays
from recon.fitting.settings import ReadOptions
from recon.formats.cameras import guessed_camera
from recon.formats.replacing import save_arrays
from recon.keypoints3d.layouts import MHR70
from recon.metrics.errors import point_errors, similarity_aligned
from recon.reading.estimate_in_film import people_of_film, view_of_estimate
from recon.simulation.images import keypoints2d
from recon.simulation.points import Corruption
from tests.filmed import bundled, walk
from tests.films.painted import write

SIZE, FRAMES = (450, 600), 32
NAMES = [name for name in MHR70 if name in PLACES]


def truth() -> recon.Motion:
    return walk(FRAMES)


def camera() -> Camera:
    """Beside the walk, looking a little down."""
    middle = bundled().pose(truth()).joints[:, 0].mean(0)
    place = middle + torch.tensor([3.2, 2.0, 0.4])
    matrix = torch.from_numpy(guessed_camera(SIZE).camera_matrix).float()
    return Camera.create(matrix, SIZE, T_camera_world=pose_looking_at(place, middle))


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    body, rng = bundled(), np.random.default_rng(0)
    scene, actor = Set.drawn(1, 6.0), Actor.drawn(body, 1)
    skin = actor.body.pose(truth()).vertices.numpy()
    images = [render(scene, camera(), [(actor, one)], rng) for one in skin]
    return write(tmp_path_factory.mktemp("rendered") / "film.mp4", images)


def told(seed: int, path: Path) -> Path:
    """An estimate in the camera's frame, y down, as networks write it."""
    wrong = estimated(truth(), RegressorErrors(occlusion=0.5), seed=seed)
    seen = wrong.carried(camera().T_camera_world, bundled().rest_joints(wrong.shape)[0])
    np.savez(
        path, poses=so3.log(seen.rotations.double()).flatten(1).numpy(),
        trans=seen.translation.numpy(), betas=np.zeros(10), mocap_framerate=30.0,
    )  # fmt: skip
    return path


def errors(found: recon.Motion) -> dict[str, float]:
    own, true = (bundled().pose(one).joints.double() for one in (found, truth()))
    stands = true[:, list(FEET)].diff(dim=0).norm(dim=-1) < 0.005
    slid = own[:, list(FEET)].diff(dim=0).norm(dim=-1)[stands].mean() * truth().fps
    rise = own.mean(0)[15] - own.mean(0)[[7, 8]].mean(0)
    return {
        "joints": float(point_errors(similarity_aligned(own, true), true).mean()),
        "slip": float(slid),
        "tilt": float(torch.atan2(rise[:2].norm(), rise[2])),
    }


@pytest.mark.slow
@pytest.mark.numerics
def test_with_the_film_refined_estimates_stand_and_are_upright(film, tmp_path):
    known = {"shape": truth().shape, "up": "y-down"}
    alone, both = list[dict[str, float]](), list[dict[str, float]]()
    for seed in (3, 4, 5):
        estimate = told(seed, tmp_path / "results.npz")
        alone.append(errors(recon.refine(estimate, "pose", **known).motion))
        result = recon.refine(
            estimate, "pose", film=film, detections=str(tmp_path / "kept"), **known
        )
        both.append(errors(result.motion))
        assert [one.unit for one in result.residuals] == ["metres", "pixels"]
        assert any("of the body's size from the estimate" in note for note in result.notes)
    shares = {
        name: np.mean([one[name] for one in both]) / np.mean([one[name] for one in alone])
        for name in both[0]
    }
    assert shares["joints"] < 1.1  # 0.96 to 1.02: the film is encoded a little otherwise each time
    assert shares["slip"] < 0.8
    assert shares["tilt"] < 0.5


@pytest.mark.slow
def test_the_command_takes_the_film_and_draws_a_sheet(film, tmp_path):
    estimate = told(3, tmp_path / "results.npz")
    words = ["refine", str(estimate), "--film", str(film), "--up", "y-down", "--prior", "pose"]
    assert cli.run([*words, "--checks", "none", "--out", str(tmp_path / "a.npz")]) == cli.OK
    assert (tmp_path / "a.sheet.png").is_file()
    assert (tmp_path / "a.detections").is_dir()


@pytest.mark.slow
def test_keypoints_of_sam_3d_body_are_refined_with_their_film(film, tmp_path):
    body, rng = bundled(), np.random.default_rng(2)
    true = BodyPoints.of_names(NAMES, body).of(body.pose(truth()))
    seen = so3.transform(camera().T_camera_world, true).numpy()
    size = np.exp(0.03 * rng.normal(size=(FRAMES, 1, 1)))
    hips = seen[:, [NAMES.index("left_hip"), NAMES.index("right_hip")]].mean(1, keepdims=True)
    points = np.zeros((FRAMES, len(MHR70), 3))
    points[:, [MHR70.index(one) for one in NAMES]] = (seen - hips) * size
    # what a network gets wrong it gets wrong in every frame
    points += 0.04 * rng.normal(size=points.shape[1:]) + 0.02 * rng.normal(size=points.shape)
    there, matrix = points + hips * size, camera().camera_matrix.numpy()
    pixels = (there @ matrix.T)[..., :2] / there[..., 2:]
    np.savez(
        tmp_path / "sam.npz", pred_keypoints_3d=points, pred_cam_t=(hips * size)[:, 0],
        pred_keypoints_2d=pixels,
    )  # fmt: skip
    alone = errors(recon.refine(tmp_path / "sam.npz", "pose", frame_rate=30.0).motion)
    found = errors(recon.refine(tmp_path / "sam.npz", "pose", film=film).motion)
    assert found["joints"] < alone["joints"]


def film_of(run: slice, path: Path) -> Path:
    """Detections in a film of a walk, of which these frames are kept."""
    motion = walk(60)
    file = keypoints2d(motion, bundled(), camera(), Corruption(noise=3.0), 0, "coco17")
    kept = np.concatenate((file.pixels, file.confidence[..., None]), -1)[run]
    found = detections_of_rows("film", list(range(len(kept))), list(zip(
        range(len(kept)), kept, [0] * len(kept), strict=True)))  # fmt: skip
    more = {"frame_rate": np.array(30.0), "image_size": np.array(SIZE)}
    save_arrays(path, detection_arrays(found) | more)
    return path


@pytest.mark.parametrize(
    ("run", "said"),
    [
        (slice(None), ""), (slice(None, None, -1), "if the film runs backwards"),
        (slice(15, None), "if the film begins 0.5 s later"),
    ],
)  # fmt: skip
def test_a_film_that_runs_otherwise_than_the_estimate_is_told(tmp_path, run, said):
    """A film run backwards, or cut otherwise, pulled the body away from the estimate unsaid."""
    seen = people_of_film(film_of(run, tmp_path / "film.npz"), ReadOptions())
    motion = walk(60)
    estimate = motion.carried(camera().T_camera_world, bundled().rest_joints(motion.shape)[0])
    try:
        found = [one.message for one in view_of_estimate(seen, estimate, bundled())[2]]
    except recon.ObservationError as error:
        found = [str(error)]
    assert len(found) == bool(said)
    assert all(said in one for one in found)


def test_an_estimate_and_its_film_have_rates_of_their_own(film, tmp_path):
    """The film's rate was taken for both: a path was twice as fast, with a vague warning."""
    every, half = np.load(told(3, tmp_path / "results.npz")), tmp_path / "half.npz"
    np.savez(half, poses=every["poses"][::2], trans=every["trans"][::2])
    ask = {"film": film, "up": "y-down", "unit": "m"}
    with pytest.raises(recon.ReconError, match="are not the 32 of the film; give its frame rate"):
        recon.refine(half, "pose", **ask)
    assert recon.refine(half, "pose", frame_rate=15.0, **ask).motion.fps == 15


@pytest.mark.slow
def test_a_film_of_somebody_else_is_refused(film, tmp_path):
    arrays = dict(np.load(told(3, tmp_path / "results.npz")))
    arrays["trans"] += np.random.default_rng(0).normal(size=(FRAMES, 3))
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(recon.ReconError, match="nobody in the film moves like the estimate"):
        recon.refine(tmp_path / "a.npz", "pose", film=film, up="y-down", unit="m")
