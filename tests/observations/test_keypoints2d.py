"""Reprojection: golden value and gradient, laws, cameras that move, points that are not seen."""

import numpy as np
import pytest
import torch

from observations.correspondences import BodyPoints
from observations.keypoints2d import Keypoints2D
from recon.core import rotations as so3
from recon.core.camera import Camera, full_hd_camera, pose_looking_at
from recon.simulation.images import orbiting_camera
from tests import laws
from tests.conftest import GOLDEN

TARGET = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
PLACE = torch.tensor([4.0, 0.0, 1.5], dtype=torch.float64)
IGNORED = [1, 9, 12]
"""Points whose confidences HuMoR does not use."""


@pytest.fixture(scope="module")
def golden():
    with np.load(GOLDEN / "losses.npz", allow_pickle=False) as file:
        return {k: torch.from_numpy(file[k]).double() for k in file.files if k != "names"}


def a_camera(clips: int = 2, poses: int = 1) -> Camera:
    """Looking at the walkers, fixed or carried around them by a radian; axes (clips, poses)."""
    camera = full_hd_camera().to(dtype=torch.float64).placed(PLACE, TARGET)
    moving = orbiting_camera(camera, TARGET, poses, 1.0) if poses > 1 else camera
    T = moving.T_camera_world.reshape(1, poses, 4, 4).expand(clips, poses, 4, 4)
    return camera.replace(
        camera_matrix=camera.camera_matrix.expand(clips, 1, 3, 3), T_camera_world=T
    )


def seen_exactly(body, motion, camera, layout="smpl22", **fields) -> Keypoints2D:
    points = BodyPoints.of_layout(layout, body)
    pixels = camera.project(points.of(body.pose(motion))).pixels
    confidence = torch.ones_like(pixels[..., 0]) * points.known
    return Keypoints2D(pixels, confidence, points, camera, motion.fps, motion.start_time, **fields)


def value_of(seen, body, motion):
    return seen(laws.estimate_of(body, motion))


def pushed(motion, metres=0.05):
    return motion.replace(translation=motion.translation + metres)


def golden_view(golden, points) -> Keypoints2D:
    matrix = torch.zeros(2, 1, 3, 3).double()
    matrix[:, 0, 0, 0], matrix[:, 0, 1, 1] = golden["cam_f"].unbind(-1)
    matrix[:, 0, :2, 2] = golden["cam_c"]
    matrix[:, 0, 2, 2] = 1.0
    confidence = golden["obs_joints2d"][..., 2].clone()
    confidence[..., IGNORED] = 0.0
    camera = Camera.create(matrix, (1920, 1080), None, torch.eye(4).double().expand(2, 1, 4, 4))
    return Keypoints2D(golden["obs_joints2d"][..., :2], confidence, points, camera, 30.0)


def golden_points(toy_body) -> BodyPoints:
    """All joints and the first three vertices, which stand for OpenPose's points there."""
    of_joints, of_vertices = torch.eye(25)[:, :22], torch.eye(25)[:, 22:]
    names = tuple(map(str, range(25)))
    known = torch.ones(25, dtype=torch.bool)
    return BodyPoints(of_joints, of_vertices, torch.arange(3), names, (0,) * len(names), known)


def test_golden_joints2d(golden, toy_body):
    """Ours is half of the published energy."""
    seen = golden_view(golden, golden_points(toy_body))
    motion = laws.Motion.create(
        golden["camera_trans"], so3.exp(golden["camera_pose"]), golden["betas"], 30.0
    )
    value = 2 * value_of(seen, toy_body, motion).sum().item()
    assert value == pytest.approx(float(golden["value_joints2d"]), rel=1e-6)


def test_golden_gradient(golden, toy_body):
    leaf = golden["points25"].clone().requires_grad_()

    class Given(BodyPoints):
        def of(self, posed):  # noqa: ARG002
            return leaf

    some = golden_points(toy_body)
    given = Given(
        some.of_joints, some.of_vertices, some.vertices, some.names, some.bones, some.known
    )
    seen = golden_view(golden, given)
    value = 2 * value_of(seen, toy_body, laws.a_motion(toy_body, frames=8)).sum()
    assert value.item() == pytest.approx(float(golden["value_joints2d"]), rel=1e-9)
    (gradient,) = torch.autograd.grad(value, leaf)
    torch.testing.assert_close(gradient, golden["grad_joints2d_points25"], rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("poses", [1, 6])
def test_the_energy_keeps_its_contract_and_vanishes_at_the_truth(poses, toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(toy_body, motion, a_camera(2, poses))
    laws.check_energy(seen, toy_body, motion, motion)
    laws.check_energy(seen, toy_body, pushed(motion), None)
    assert (value_of(seen, toy_body, pushed(motion)) > 1).all()


def test_a_moving_camera_is_not_a_fixed_one(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(toy_body, motion, a_camera(2, 6))
    fixed = seen.replace(camera=a_camera(2, 1))
    assert (value_of(fixed, toy_body, motion) > 100).all()


@pytest.mark.parametrize("poses", [1, 40])
def test_windows_of_a_view_add_up_to_it(poses, toy_body):
    """A window that began at the first camera pose again would see another world."""
    motion = laws.a_motion(toy_body, frames=40)
    seen = seen_exactly(toy_body, motion, a_camera(2, poses))
    away = pushed(motion)
    first, second = seen.window(0.0, 19 / 30), seen.window(20 / 30, 39 / 30)
    assert second.start_time == pytest.approx(20 / 30)
    parts = value_of(first, toy_body, away) + value_of(second, toy_body, away)
    torch.testing.assert_close(parts, value_of(seen, toy_body, away))
    laws.check_energy(second, toy_body, motion, motion)


def test_a_window_beyond_a_moving_camera_sees_nothing_there(toy_body):
    motion = laws.a_motion(toy_body, frames=40)
    seen = seen_exactly(toy_body, motion, a_camera(2, 40))
    late = seen.window(30 / 30, 59 / 30)
    assert late.pixels.shape[1] == 30
    assert (late.confidence[:, :10] == 1).all()
    assert (late.confidence[:, 10:] == 0).all()
    value = value_of(late, toy_body, pushed(motion))
    torch.testing.assert_close(
        value, value_of(seen.window(1.0, 39 / 30), toy_body, pushed(motion))
    )


def test_behind_the_camera_is_finite_and_costs_the_most(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(toy_body, motion, a_camera())
    behind = motion.replace(translation=motion.translation + 2 * PLACE)
    laws.check_energy(seen, toy_body, behind, None)
    most = 0.5 * 2 * seen.sigma**2 * seen.confidence.square().sum((-2, -1))
    torch.testing.assert_close(value_of(seen, toy_body, behind), most)
    assert (value_of(seen, toy_body, pushed(motion, 30.0)) <= most).all()


def test_a_body_half_behind_the_camera_has_a_finite_gradient(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(toy_body, motion, a_camera())
    amid = motion.replace(translation=motion.translation + PLACE - 0.9 * TARGET)
    depth = seen.camera.project(toy_body.pose(amid).joints).depth
    assert (depth > 0.01).any()
    assert (depth < 0.01).any()
    laws.check_energy(seen, toy_body, amid, None)


def test_no_confidence_counts_nothing_and_half_a_quarter(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(toy_body, motion, a_camera())
    nothing = seen.replace(confidence=seen.confidence * 0)
    assert (value_of(nothing, toy_body, pushed(motion)) == 0).all()
    hidden = seen.confidence.clone()
    hidden[..., ::2] = 0
    partly = seen.replace(confidence=hidden)
    spoilt = partly.replace(pixels=partly.pixels + 1e4 * (hidden == 0)[..., None])
    away = pushed(motion)
    assert torch.equal(value_of(partly, toy_body, away), value_of(spoilt, toy_body, away))
    half = seen.replace(confidence=seen.confidence / 2)
    torch.testing.assert_close(4 * value_of(half, toy_body, away), value_of(seen, toy_body, away))


def test_more_frames_a_second_do_not_count_more(toy_body):
    slow, fast = laws.a_motion(toy_body, frames=31), laws.a_motion(toy_body, frames=121, fps=120.0)
    camera = a_camera()
    one = value_of(seen_exactly(toy_body, slow, camera), toy_body, pushed(slow))
    four = value_of(seen_exactly(toy_body, fast, camera), toy_body, pushed(fast))
    torch.testing.assert_close(four, one, rtol=0.03, atol=0)
    fine = seen_exactly(toy_body, fast, camera)  # 120 Hz data on a 30 Hz motion
    torch.testing.assert_close(value_of(fine, toy_body, pushed(slow)), one, rtol=0.05, atol=0)


def test_an_outlier_pulls_less_than_an_error(toy_body):
    motion = laws.a_motion(toy_body)
    seen = seen_exactly(toy_body, motion, a_camera())
    wild = seen.pixels.clone()
    wild[:, 2, 4] += 5000.0
    value = value_of(seen.replace(pixels=wild), toy_body, motion)
    torch.testing.assert_close(value, value.new_full((2,), 0.5 * 2 * 100.0**2), rtol=1e-3, atol=0)


def test_every_clip_of_a_batch_has_its_own_camera(toy_body):
    """Row selection of a batch selects cameras too."""
    motion = laws.a_motion(toy_body)
    two = a_camera()
    shifted = two.T_camera_world.clone()
    shifted[1] = pose_looking_at(PLACE + 1.0, TARGET)
    seen = seen_exactly(toy_body, motion, two.replace(T_camera_world=shifted))
    laws.check_energy(seen, toy_body, pushed(motion), None)
    torch.testing.assert_close(seen[torch.tensor([1])].camera.T_camera_world[0], shifted[1])
