"""Cameras: OpenCV's projection, its inverse, and finite numbers behind the lens."""

import pytest
import torch
from torch import Tensor

from recon.core import rotations as so3
from recon.core.camera import Camera, depth_camera, full_hd_camera, pose_looking_at

LENSES = [
    None,
    [-0.28, 0.08, 0.001, -0.0005],
    [-0.28, 0.08, 0.001, -0.0005, -0.01],
    [0.3, -0.1, 0.001, 0.0005, 0.02, 0.4, -0.05, 0.03],
]


def numbers(values: list[float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def camera(lens: list[float] | None, *frames: int) -> Camera:
    matrix = numbers([900.0, 1.5, 640.0, 0.0, 910.0, 355.0, 0.0, 0.0, 1.0]).view(3, 3)
    pose = torch.eye(4, dtype=torch.float64).repeat(*frames, 1, 1)
    pose[..., :3, :3] = so3.exp(0.2 * torch.randn(*frames, 3, dtype=torch.float64))
    pose[..., :3, 3] = numbers([0.1, -0.2, 4.0])
    return Camera.create(matrix, (1280, 720), None if lens is None else numbers(lens), pose)


@pytest.mark.parametrize("lens", LENSES)
def test_projection_is_opencvs(lens: list[float] | None) -> None:
    import cv2

    seen = camera(lens).replace(
        camera_matrix=numbers([900.0, 0.0, 640.0, 0.0, 910.0, 355.0, 0.0, 0.0, 1.0]).view(3, 3)
    )
    points = torch.randn(40, 3, dtype=torch.float64)
    pose = seen.T_camera_world.numpy()
    expected, _ = cv2.projectPoints(
        points.numpy(),
        cv2.Rodrigues(pose[:3, :3])[0],
        pose[:3, 3],
        seen.camera_matrix.numpy(),
        None if lens is None else numbers(lens).numpy(),
    )
    found = seen.project(points)
    expected = torch.from_numpy(expected[:, 0])
    torch.testing.assert_close(found.pixels, expected, rtol=0, atol=1e-8)  # pixels
    assert found.in_front.all()


@pytest.mark.parametrize("lens", LENSES)
def test_unprojection_undoes_projection(lens: list[float] | None) -> None:
    seen = camera(lens, 5)
    points = 0.8 * torch.randn(5, 11, 3, dtype=torch.float64)
    image = seen.project(points)
    back = seen.unproject(image.pixels, image.depth)
    torch.testing.assert_close(back, points, rtol=0, atol=1e-7)  # metres


@pytest.mark.parametrize("lens", LENSES)
def test_projection_is_differentiable(lens: list[float] | None) -> None:
    seen = camera(lens)
    points = torch.randn(3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda p: seen.project(p).pixels, (points,))
    pose = seen.T_camera_world.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda T: seen.derived(T_camera_world=T).project(points.detach()).pixels, (pose,)
    )


def test_points_behind_the_camera_are_marked_finite_and_without_gradient() -> None:
    seen = full_hd_camera().to(dtype=torch.float64)
    points = torch.tensor(
        [[0.0, 0.0, -2.0], [1.0, 1.0, 0.0], [1.0, 0.5, 1e-5], [0.1, 0.1, 2.0]],
        dtype=torch.float64,
        requires_grad=True,
    )
    image = seen.project(points)
    assert image.in_front.tolist() == [False, False, False, True]
    assert image.pixels.isfinite().all()
    (gradient,) = torch.autograd.grad(image.pixels.sum(), points)
    assert gradient.isfinite().all()
    assert gradient[:3].eq(0).all()


def test_a_moving_camera_sees_every_frame_from_its_own_place() -> None:
    seen = camera(LENSES[1], 4)
    points = torch.randn(4, 6, 3, dtype=torch.float64)
    moving = seen.project(points).pixels
    for k in range(4):
        still = seen.replace(T_camera_world=seen.T_camera_world[k])
        torch.testing.assert_close(moving[k], still.project(points[k]).pixels)
    batch = seen.project(points.expand(2, 4, 6, 3)).pixels
    torch.testing.assert_close(batch[1], moving)


def test_world_and_camera_frames_are_inverse() -> None:
    seen = camera(None, 3)
    points = torch.randn(3, 5, 3, dtype=torch.float64)
    torch.testing.assert_close(seen.to_world(seen.to_camera(points)), points)
    identity = torch.eye(4, dtype=torch.float64).expand(3, 4, 4)
    torch.testing.assert_close(seen.T_world_camera @ seen.T_camera_world, identity)


@pytest.mark.parametrize("preset", [full_hd_camera(), depth_camera()])
def test_a_placed_camera_sees_its_target_in_the_middle_and_upright(preset: Camera) -> None:
    position, target = numbers([1.0, 4.0, 1.5]), numbers([0.0, 0.0, 0.9])
    seen = preset.to(dtype=torch.float64).placed(position, target)
    person = torch.stack((target, target + numbers([0, 0, 0.8]), target + numbers([1, 0, 0])))
    image = seen.project(person)
    width, height = seen.image_size
    middle = numbers([width / 2, height / 2])
    torch.testing.assert_close(image.pixels[0], middle, rtol=0, atol=1e-9)  # pixels
    torch.testing.assert_close(image.depth[0], (target - position).norm())
    assert image.pixels[1, 1] < height / 2  # up in the world is up in the image
    assert image.pixels[2, 0] < width / 2  # facing -y, the world's +x is to the left
    assert seen.in_image(image.pixels).all()
    assert not seen.in_image(image.pixels + width).any()
    rotation = seen.T_camera_world[:3, :3]
    torch.testing.assert_close(rotation @ rotation.mT, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(rotation).item() == pytest.approx(1.0)


def test_bad_cameras_are_refused() -> None:
    matrix = full_hd_camera().camera_matrix
    with pytest.raises(ValueError, match="focal lengths must be positive"):
        Camera.create(-matrix, (1920, 1080))
    with pytest.raises(ValueError, match="image size"):
        Camera.create(matrix, (0, 1080))
    with pytest.raises(ValueError, match="4 or 5 or 8 distortion coefficients"):
        Camera.create(matrix, (1920, 1080), torch.zeros(6))
    with pytest.raises(ValueError, match="move the camera or the target sideways"):
        pose_looking_at(numbers([0.0, 0.0, 3.0]), numbers([0.0, 0.0, 0.0]))


def test_a_moving_camera_is_where_its_clock_says_and_stands_still_beyond_its_poses() -> None:
    still = depth_camera().to(dtype=torch.float64)
    place = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    place[:, 0, 3] = numbers([10.0, 20.0, 30.0])
    moving = still.replace(T_camera_world=place)
    assert moving.at(range(-2, 5)).T_camera_world[:, 0, 3].tolist() == [
        10.0, 10.0, 10.0, 20.0, 30.0, 30.0, 30.0,
    ]  # fmt: skip
    assert moving.at(range(1, 2)).T_camera_world.shape == (1, 4, 4)
    two = still.replace(T_camera_world=place[:2])
    assert two.at(range(3)).T_camera_world[:, 0, 3].tolist() == [10.0, 20.0, 20.0]
    fixed = still.replace(T_camera_world=place[:1])
    assert fixed.at(range(7)) is fixed
