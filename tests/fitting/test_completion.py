"""Cycles from few points, few frames and landmarks, with a small prior of made-up walks."""

import math

import pytest
import torch

from observations.depth import PointCloud
from observations.joints3d import Joints3D
from observations.keypoints2d import Keypoints2D
from observations.markers3d import Markers3D
from observations.surfels import Surfels
from recon.body.landmarks import LANDMARKS_16, landmark
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.core.struct import concatenate
from recon.fitting.cycles import complete
from recon.fitting.methods import FitOptions
from tests.filmed import cameras, view
from tests.priors.tiny_anchor import tiny_weights, walks
from training.weights import save_anchor

BODY = BodyModel.load()


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> FitOptions:
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_anchor(path, tiny_weights(BODY), {})
    return FitOptions(prior="anchor", weights=str(path))


def truth(seed: int, turned: float = 0.0) -> Motion:
    """A walk that the prior has not seen, heading anywhere."""
    walk = walks(BODY, 3, seed)[seed % 2]
    T = torch.eye(4)
    c, s = math.cos(turned), math.sin(turned)
    T[:2, :2] = torch.tensor([[c, -s], [s, c]])
    T[:2, 3] = torch.tensor([1.5, -0.7])
    return walk.carried(T, BODY.rest_joints(walk.shape)[0])


def cloud(motion: Motion, points: int, frames: range | None = None) -> PointCloud:
    """Points of the skin, others in every frame."""
    vertices = BODY.pose(motion).vertices
    random = torch.Generator().manual_seed(0)
    pick = torch.randint(len(BODY.template), (motion.frames, points), generator=random)
    seen = vertices.gather(1, pick[..., None].expand(-1, -1, 3))
    present = torch.zeros(motion.frames, points, dtype=torch.bool)
    present[list(frames or range(motion.frames))] = True
    seen = seen.where(present[..., None], 0.0)
    return PointCloud(seen[None], present[None], Surfels.of(BODY, 800), motion.fps)


def landmarks(motion: Motion) -> Markers3D:
    vertices = tuple(landmark(name) for name in LANDMARKS_16)
    positions = BODY.pose(motion).points(torch.tensor(vertices))[None]
    visible = torch.ones(positions.shape[:-1], dtype=torch.bool)
    return Markers3D(positions, visible, vertices, motion.fps)


def vertex_error(found: Motion, expected: Motion) -> float:
    times = expected.times.clamp(max=float(found.times[-1]))
    pair = [BODY.pose(m.at(times, expected.fps)).vertices for m in (found, expected)]
    return float((pair[0] - pair[1]).norm(dim=-1).mean())


def test_landmarks_alone(settings):
    walk = truth(1, 2.5)
    found = complete([landmarks(walk)], settings, BODY)
    assert vertex_error(found.result.clip(0), walk) < 0.03
    names = [report.stage.name for report in found.result.reports]
    assert names == ["place", "rough", "cycle", "body"]


@pytest.mark.parametrize(("seed", "turned"), [(2, 0.0), (3, 4.0)])
def test_sparse_points_alone_find_heading_and_foot(settings, seed, turned):
    walk = truth(seed, turned)
    found = complete([cloud(walk, 40)], settings, BODY)
    assert vertex_error(found.result.clip(0), walk) < 0.04


def test_few_frames(settings):
    walk = truth(1, 1.0)
    last = walk.frames - 1
    seen = cloud(walk, 300, range(last // 5, last + 1, last // 5))
    found = complete([seen], settings, BODY)
    assert vertex_error(found.result.clip(0), walk) < 0.05


@pytest.mark.slow
def test_dense_points_tell_what_no_code_has(settings):
    walk = truth(2)
    raised = walk.rotations.clone()
    # Nearer than the robust kernel's scale: points that are farther off count as outliers.
    angle = torch.tensor([0.0, 0.0, 0.15])
    raised[:, JOINTS.index("left_elbow")] = so3.exp(angle)
    walk = walk.replace(rotations=raised)
    found = complete([cloud(walk, 500)], settings, BODY)
    reports = {report.stage.name: report for report in found.result.reports}
    assert set(reports) == {"place", "rough", "cycle", "body", "details"}
    motion = found.result.clip(0)
    bent = so3.log(motion.rotations[:, JOINTS.index("left_elbow")]).norm(dim=-1).mean()
    assert float(bent) > 0.04  # in no walk of the prior it bends at all
    wrist = JOINTS.index("left_wrist")
    places = [BODY.pose(one).joints[:, wrist] for one in (motion.at(walk.times, walk.fps), walk)]
    # Without the correction of the elbow the wrist is 3.5 cm off.
    assert float((places[0] - places[1]).norm(dim=-1).mean()) < 0.01


def test_a_batch_is_its_clips(settings):
    clips = [truth(1, 1.0), truth(2, 3.0)]
    longest = max(clip.frames for clip in clips)

    def padded(one: Markers3D) -> Markers3D:
        more = longest - one.visible.shape[1]
        pad = torch.nn.functional.pad
        return one.replace(
            positions=pad(one.positions, (0, 0, 0, 0, 0, more)),
            visible=pad(one.visible, (0, 0, 0, more)),
        )

    seen = [landmarks(clip) for clip in clips]
    together = complete([concatenate([padded(one) for one in seen])], settings, BODY)
    for k, one in enumerate(seen):
        alone = complete([one], settings, BODY).result.clip(0)
        assert together.result.clip(k).frames == alone.frames
        assert vertex_error(together.result.clip(k), alone) < 0.003


def test_joints_are_enough(settings):
    walk = truth(3, 0.5)
    positions = BODY.pose(walk).joints[None]
    visible = torch.ones(positions.shape[:-1], dtype=torch.bool)
    seen = Joints3D(positions, visible, tuple(range(22)), walk.fps)
    assert vertex_error(complete([seen], settings, BODY).result.clip(0), walk) < 0.03


@pytest.mark.parametrize(("seconds", "fps"), [(0.2, 50.0), (4.0, 10.0)])
def test_what_lasts_too_short_or_too_long_is_refused(settings, seconds, fps):
    walk = truth(1)
    seen = landmarks(walk)
    frames = round(seconds * fps) + 1
    rows = torch.arange(frames).clamp(max=walk.frames - 1)
    seen = seen.replace(positions=seen.positions[:, rows], visible=seen.visible[:, rows], fps=fps)
    with pytest.raises(ValueError, match="data of one gait cycle"):
        complete([seen], settings, BODY)


def test_images_alone_are_refused(settings):
    walk = truth(1)
    seen = view(walk, cameras(walk, 1)[0])
    assert isinstance(seen, Keypoints2D)
    with pytest.raises(ValueError, match="scans, landmarks or joints"):
        complete([seen], settings, BODY)  # pyright: ignore[reportArgumentType]
