"""The ground and the world it defines: equal to the reference, and free of its singularities."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from recon.core import rotations as so3
from recon.core.camera import (
    Ground,
    rotation_to_heading_frame,
    tangent_basis,
    transform,
    world_from_camera,
)

pytestmark = pytest.mark.numerics

GOLDEN = Path(__file__).parents[1] / "golden" / "floor.npz"


@pytest.fixture(scope="module")
def golden() -> dict[str, Tensor]:
    with np.load(GOLDEN, allow_pickle=False) as file:
        return {name: torch.from_numpy(np.asarray(file[name])) for name in file.files}


def planes(*batch: int) -> Ground:
    return Ground.create(
        torch.randn(*batch, 3, dtype=torch.float64), torch.randn(*batch, dtype=torch.float64)
    )


def decoded(floor: Tensor) -> Ground:
    """HuMoR's normal-times-offset vector as a plane whose normal points up in the image."""
    offset = floor.norm(dim=-1)
    normal = floor / offset[:, None]
    sign = torch.where(normal[:, 1] > 0, -1.0, 1.0)
    return Ground.create(normal * sign[:, None], offset * sign)


def test_canonical_frame_equals_the_exact_reference(golden: dict[str, Tensor]) -> None:
    plane = golden["exact_plane4"]
    ground = Ground.create(plane[:, :3], plane[:, 3])
    torch.testing.assert_close(decoded(golden["floor"]).coefficients, ground.coefficients)
    root = so3.exp(golden["root_aa"])
    rotation = rotation_to_heading_frame(ground, root[:, 0])
    torch.testing.assert_close(rotation, golden["exact_R"], rtol=0, atol=1e-10)
    moved = rotation[:, None] @ root
    torch.testing.assert_close(moved, golden["exact_canonical_root"], rtol=0, atol=1e-10)

    joints = golden["camera_joints"]
    height = ground.heights(joints)[:, 0, :1]
    torch.testing.assert_close(height, golden["exact_height"], rtol=0, atol=1e-10)  # metres
    # The reference puts the first SMPL translation, not the pelvis, above the world's origin:
    # the two frames differ by the rest pelvis.
    T = world_from_camera(ground, root[:, 0], joints[:, 0, 0])
    rest = joints[:, 0, 0] - golden["trans"][:, 0]
    shift = rest * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
    ours = transform(T[:, None], joints) + shift[:, None, None]
    # metres; the camera-frame joints come from smplx, whose exponential map is off by 1e-8
    torch.testing.assert_close(ours, golden["exact_canonical_joints"], rtol=0, atol=1e-7)
    translation = ours[:, :, 0] - rest[:, None]
    torch.testing.assert_close(
        translation, golden["exact_canonical_trans"], rtol=0, atol=1e-10
    )  # metres


def test_frame_of_a_body_parallel_to_the_ground_equals_the_exact_reference(
    golden: dict[str, Tensor],
) -> None:
    """The reference intersects a ray with the ground here and returns NaN."""
    assert golden["degenerate_ref_R"].isnan().any()
    ground = decoded(golden["degenerate_floor"])
    root = so3.exp(golden["degenerate_root_aa"][:, 0])
    rotation = rotation_to_heading_frame(ground, root)
    torch.testing.assert_close(rotation, golden["degenerate_exact_R"], rtol=0, atol=1e-10)
    moved = (rotation @ root)[:, None]
    torch.testing.assert_close(
        moved, golden["degenerate_exact_canonical_root"], rtol=0, atol=1e-10
    )


def test_world_has_the_ground_at_zero_and_the_body_facing_forward() -> None:
    ground, root = planes(6), so3.exp(torch.randn(6, 3, dtype=torch.float64))
    origin = torch.randn(6, 3, dtype=torch.float64)
    T = world_from_camera(ground, root, origin)
    points = torch.randn(6, 9, 3, dtype=torch.float64)
    world = transform(T, points)
    torch.testing.assert_close(world[..., 2], ground.heights(points))
    above = transform(T, origin[:, None])[:, 0, :2]
    torch.testing.assert_close(above, torch.zeros_like(above), rtol=0, atol=1e-12)
    rotation = T[:, :3, :3]
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(6, dtype=torch.float64))
    right = (rotation @ -root[:, :, :1])[..., 0]
    torch.testing.assert_close(right[:, 1], torch.zeros_like(right[:, 1]), rtol=0, atol=1e-12)
    assert (right[:, 0] > 0).all()
    seen = Ground.seen_from(torch.linalg.inv(T))
    torch.testing.assert_close(seen.coefficients, ground.coefficients)


def test_lying_on_the_side_still_has_a_frame_and_a_gradient() -> None:
    """The body's right is then parallel to the normal and gives no heading."""
    vertical = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).requires_grad_()
    ground = Ground(vertical, torch.zeros(1, dtype=torch.float64))
    root = so3.exp(torch.tensor([[0.0, torch.pi / 2, 0.0]], dtype=torch.float64))
    rotation = rotation_to_heading_frame(ground, root)
    identity = torch.eye(3, dtype=torch.float64)[None]
    torch.testing.assert_close(rotation @ rotation.mT, identity, rtol=0, atol=1e-12)
    front = (rotation @ root[:, :, 2:])[0, :, 0]
    torch.testing.assert_close(front, torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64))
    (gradient,) = torch.autograd.grad(rotation[..., 0].sum(), vertical)
    assert gradient.isfinite().all()


def test_frame_is_differentiable_in_ground_and_body() -> None:
    normal = planes(2).normal.requires_grad_()
    turn = torch.randn(2, 3, dtype=torch.float64, requires_grad=True)
    origin = torch.randn(2, 3, dtype=torch.float64)
    offset = torch.zeros(2, dtype=torch.float64, requires_grad=True)

    def frame(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        return world_from_camera(Ground.create(a, b), so3.exp(c), origin)

    assert torch.autograd.gradcheck(frame, (normal, offset, turn))


def test_tangent_basis_is_orthonormal_also_at_the_poles() -> None:
    poles = torch.tensor([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0]], dtype=torch.float64)
    normal = torch.cat((poles, planes(20).normal))
    frame = torch.cat((tangent_basis(normal), normal[..., None]), -1)
    identity = torch.eye(3, dtype=torch.float64).expand_as(frame)
    torch.testing.assert_close(frame.mT @ frame, identity)


def test_heights_follow_the_batch_of_the_ground() -> None:
    ground = planes(3)
    joints = torch.randn(3, 4, 22, 3, dtype=torch.float64)
    for k in range(3):
        expected = joints[k] @ ground.normal[k] - ground.offset[k]
        torch.testing.assert_close(ground.heights(joints)[k], expected)
        torch.testing.assert_close(ground[k].heights(joints[k]), expected)


def test_a_normal_of_any_length_describes_the_same_plane() -> None:
    ground = planes(5)
    again = Ground.create(3 * ground.normal, 3 * ground.offset)
    torch.testing.assert_close(again.coefficients, ground.coefficients)
    with pytest.raises(ValueError, match="not zero"):
        Ground.create(torch.zeros(3), torch.zeros(()))
