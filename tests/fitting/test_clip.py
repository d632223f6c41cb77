"""Clips from images: ground unknown and known, one view and three, mixtures, batches, long."""

import math

import pytest
import torch

from observations.depth import PointCloud
from observations.first_guess import with_first_guess
from observations.joints3d import Joints3D
from observations.keypoints2d import Keypoints2D
from observations.surfels import Surfels
from recon.body.soles import ground_heights
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting import clip as clip_module
from recon.fitting.clip import clip_problem, fit_clip
from recon.fitting.methods import FitOptions
from recon.fitting.records import ClipFit
from recon.formats.observations import CameraArrays, KeypointsFile
from recon.method.stages import StageReport
from recon.reading.images import keypoints_of
from recon.simulation.points import Corruption, joints3d
from tests.filmed import bundled, cameras, joint_error, turned, view, walk

POSE = FitOptions(prior="pose")
HUMOR = FitOptions(prior="humor")


def one_view(truth: Motion, angle: float = 0.0, seed: int = 0) -> Keypoints2D:
    return view(truth, cameras(truth, 1, angle)[0], seed=seed)


def lost(seen: Keypoints2D) -> Keypoints2D:
    """The same pixels from a camera whose pose nobody knows; the recording's frame is another."""
    camera = CameraArrays(
        seen.camera.camera_matrix[0, 0].double().numpy(), seen.camera.image_size, None, None
    )
    file = KeypointsFile(
        seen.pixels[0].double().numpy(), seen.confidence[0].double().numpy(), "openpose25",
        seen.fps, camera,
    )  # fmt: skip
    return keypoints_of(file, bundled())


def in_camera(points: torch.Tensor, T_camera: torch.Tensor) -> torch.Tensor:
    return points @ T_camera[:3, :3].mT + T_camera[:3, 3]


def aligned_error(found: ClipFit, seen: Keypoints2D, truth: Motion, true: Keypoints2D) -> float:
    """Mean distance of joints about the pelvis, seen from the camera, metres."""
    T = seen.camera.T_camera_world[0, 0] @ torch.linalg.inv(found.T_world_recording[0])
    ours = in_camera(found.result.body.joints[0].detach(), T)
    theirs = in_camera(bundled().pose(truth).joints, true.camera.T_camera_world[0, 0])
    return float(((ours - ours[:, :1]) - (theirs - theirs[:, :1])).norm(dim=-1).mean())


def camera_height(found: ClipFit, seen: Keypoints2D) -> float:
    eye = found.T_world_recording[0] @ seen.camera.T_world_camera[0, 0]
    return float(eye[2, 3])


@pytest.mark.numerics
@pytest.mark.parametrize("settings", [POSE, HUMOR], ids=["pose", "humor"])
def test_one_camera_of_unknown_pose(settings):
    truth = walk(16)
    true = one_view(truth)
    seen = lost(true)
    found = fit_clip([seen], settings, bundled())
    assert not found.ground_known
    assert not any(found.result.failed)
    assert aligned_error(found, seen, truth, true) < 0.09  # metres
    assert camera_height(found, seen) == pytest.approx(1.6, abs=0.25)  # metres
    up = (found.T_world_recording[0] @ seen.camera.T_world_camera[0, 0])[2, :3]
    true_up = true.camera.T_world_camera[0, 0, 2, :3]
    assert math.degrees(math.acos(float((up * true_up).sum().clamp(max=1)))) < 8
    soles = float(ground_heights(found.result.motion.detach(), bundled())[0])
    assert abs(soles) < 0.05
    # HuMoR's networks like short steps: they shrank a man by a fifth, whom one view cannot measure
    finding = [report.stage.name for report in found.result.reports if moves_shape(report)]
    assert finding == ["pose"]


def moves_shape(report: StageReport) -> bool:
    return "shape" in report.stage.free


def test_a_second_view_tells_the_size_and_one_view_does_not():
    """Who turned cartwheels before one camera of known pose became a child near the camera."""
    truth = walk(12)
    alone = fit_clip([one_view(truth)], HUMOR, bundled())
    finding = [report.stage.name for report in alone.result.reports if moves_shape(report)]
    assert finding == ["pose"]
    both = [one_view(truth), view(truth, cameras(truth, 2)[1], seed=1)]
    assert moves_shape(fit_clip(both, HUMOR, bundled()).result.reports[-1])


@pytest.mark.parametrize("angle", [0.0, 1.5])
def test_a_known_ground_sets_the_distance_of_one_camera(angle):
    """What a camera sees does not change when all is farther and larger; soles at z = 0 decide."""
    truth = walk(16)
    found = fit_clip([one_view(truth, angle)], POSE, bundled())
    assert found.ground_known
    torch.testing.assert_close(found.T_world_recording[0], torch.eye(4))
    assert joint_error(found.result.motion.detach()[0], truth) < 0.09
    assert abs(float(ground_heights(found.result.motion.detach(), bundled())[0])) < 0.06


@pytest.mark.parametrize("settings", [POSE, HUMOR], ids=["pose", "humor"])
def test_three_views_give_the_motion_itself(settings):
    truth = walk(16)
    seen = [view(truth, c, seed=k) for k, c in enumerate(cameras(truth, 3))]
    found = fit_clip(seen, settings, bundled())
    assert joint_error(found.result.motion.detach()[0], truth) < 0.03
    assert found.result.reports[0].stage.name == "pose"  # triangulated points place the body
    assert all(1 < noise.own < 8 for noise in found.noises)  # pixels


@pytest.mark.numerics
def test_joints_and_images_add_up():
    """Noisy joints of the upper body, images of everything."""
    truth = walk(16)
    joints = joints3d(truth, bundled(), Corruption(noise=0.03, hide_below=0.8), 0)
    named = joints.map(lambda t: t[None])
    seen = one_view(truth)
    alone = fit_clip([named], POSE, bundled())
    both = fit_clip([named, seen], POSE, bundled())
    worse = joint_error(alone.result.motion.detach()[0], truth)
    better = joint_error(both.result.motion.detach()[0], truth)
    assert better < 0.03
    assert better < 0.85 * worse
    terms = {term.name for term in both.result.reports[-1].stage.terms}
    assert {"data 1", "data 2"} <= terms


def test_clips_of_a_batch_are_fitted_as_alone():
    first, second = walk(16), turned(walk(16), 1.0)
    a, b = one_view(first), one_view(second, 0.5, seed=3)
    told = FitOptions(prior="pose", noise=(4.0,))
    both = fit_clip([concatenate([a, b])], told, bundled())
    alone = fit_clip([b], told, bundled())
    away = (both.result.body.joints[1] - alone.result.body.joints[0]).detach().norm(dim=-1)
    assert away.mean() < 0.01  # metres


@pytest.mark.slow
def test_long_recordings_keep_one_ground(monkeypatch):
    monkeypatch.setattr(clip_module, "LONG", 1.0)
    monkeypatch.setattr("recon.fitting.long.WINDOW", 1.0)
    truth = walk(36)
    true = one_view(truth)
    seen = lost(true)
    found = fit_clip([seen], HUMOR, bundled())
    assert found.result.motion.frames == 36
    assert not any(found.result.failed)
    assert aligned_error(found, seen, truth, true) < 0.1
    assert camera_height(found, seen) == pytest.approx(1.6, abs=0.3)


def test_posed_and_unposed_together_are_refused():
    seen = one_view(walk(16))
    with pytest.raises(ValueError, match="ground_known the same in all"):
        fit_clip([seen, lost(seen)], POSE, bundled())


def test_noise_may_be_told_in_pixels_and_metres():
    truth = walk(8)
    joints = joints3d(truth, bundled(), Corruption(noise=0.02), 0).map(lambda t: t[None])
    told = FitOptions(prior="pose", noise=(0.05, 7.0))
    found = fit_clip([joints, one_view(truth)], told, bundled())
    assert isinstance(joints, Joints3D)
    assert found.noises[0].own == 0.05
    assert found.noises[1].own == 7.0


def test_a_view_whose_errors_last_weighs_less_unless_its_noise_is_told():
    """Detectors err alike for some frames; believed in each, feet would follow them and slip."""
    new, seen = torch.Generator().manual_seed(0), one_view(walk(48))
    white = 8 * torch.randn(seen.pixels.shape, generator=new)
    errors = white.clone()
    for k in range(1, seen.moments):
        errors[:, k] = 0.8 * errors[:, k - 1] + 0.6 * white[:, k]
    fresh, lasting = (seen.derived(pixels=seen.pixels + one) for one in (white, errors))
    told = FitOptions(prior="pose", noise=(3.0,))

    def repetition(one: Keypoints2D, options: FitOptions) -> float:
        problem = clip_problem(*with_first_guess([one], bundled(), None, None), options, bundled())
        return problem.after_pose_prior()[0].repetition

    assert repetition(fresh, POSE) < 1.5
    assert repetition(lasting, POSE) > 3
    assert repetition(lasting, told) == 1.0


def test_nobody_in_the_first_frames():
    """HuMoR's first frame decides everything; here it may be empty."""
    truth = walk(16)
    seen = one_view(truth)
    confidence = seen.confidence.clone()
    confidence[:, :5] = 0
    late = seen.replace(confidence=confidence)
    found = fit_clip([late], POSE, bundled())
    assert joint_error(found.result.motion.detach()[0], truth) < 0.09


@pytest.mark.slow
def test_a_long_recording_of_depth_alone_finds_its_heading_in_its_first_seconds():
    """Comparing headings window by window, it met windows that no hypothesis has."""
    body, count = bundled(), 43
    there, up = torch.zeros(count), torch.full((count,), float(walk().translation[0, 2]))
    standing = Motion.create(
        torch.stack([0.03 * torch.arange(count), there, up], -1),
        walk().rotations[:1].expand(count, -1, -1, -1),
        walk().shape,
        fps=3.0,
    )
    generator = torch.Generator().manual_seed(0)
    pick = torch.randint(len(body.template), (count, 60, 1), generator=generator)
    seen = body.pose(standing).vertices.gather(1, pick.expand(-1, -1, 3))
    everywhere = torch.ones(1, count, 60, dtype=torch.bool)
    cloud = PointCloud(seen[None], everywhere, Surfels.of(body, 400), 3.0)
    found = fit_clip([cloud], POSE, body)
    assert found.result.motion.frames == count
    assert joint_error(found.result.clip(0), standing) < 0.08
