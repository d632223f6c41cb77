"""Matched clouds: derivatives that were written by hand against differences."""

import pytest
import torch

from observations.depth import PointCloud
from observations.surfels import Surfels, fixed_scale_kernel, tukey
from recon.core import rotations as so3
from recon.core.scene import Scene, UnknownGround
from recon.method.protocols import Decoded, Estimate
from recon.method.quadratic import FRAME, ClipModel
from tests import laws

pytestmark = pytest.mark.numerics


def seen(body, frames=2, **fields):
    motion = laws.a_motion(body, clips=1, frames=frames)
    g = torch.Generator().manual_seed(5)
    points = body.pose(motion).vertices[:, :, ::40]
    points = points + 0.02 * torch.randn(points.shape, generator=g, dtype=points.dtype)
    present = torch.rand(points.shape[:-1], generator=g) < 0.8
    present[:, 0] &= frames < 4  # a moment without points
    return motion, PointCloud(points, present, Surfels.of(body, 600), motion.fps, **fields)


def ground():
    found = UnknownGround.create(torch.zeros(1, 3).double())
    return found.replace(lift=found.lift + 0.3, tilt=found.tilt + 0.2)


def stepped(motion, steps, shape=0.0):
    """The motion after steps of frames; joints turn by rotation vectors."""
    turns = so3.exp(steps[..., 3:].unflatten(-1, (22, 3)))
    return motion.replace(
        translation=motion.translation + steps[..., :3],
        rotations=motion.rotations @ turns,
        shape=motion.shape + shape,
    )


@pytest.mark.parametrize("kernel", [tukey, fixed_scale_kernel])
@pytest.mark.parametrize("tilted", [False, True])
def test_the_gradient_is_that_of_the_value(body, kernel, tilted):
    motion, cloud = seen(body, frames=4, kernel=kernel)
    scene = Scene(torch.zeros(1, 0, 3).double(), ground() if tilted else None)
    held = cloud.matched(laws.estimate_of(body, motion, scene))

    def energy(x):
        moved = stepped(motion, x[:, : 4 * FRAME].unflatten(1, (4, -1)), x[:, 4 * FRAME :])
        return held(laws.estimate_of(body, moved, scene)).sum()

    zero = torch.zeros(1, 4 * FRAME + motion.shape.shape[-1]).double().requires_grad_()
    (gradient,) = torch.autograd.grad(energy(zero), zero)
    way = torch.randn(zero.shape, dtype=zero.dtype)
    numeric = (energy(1e-6 * way) - energy(-1e-6 * way)).item() / 2e-6
    assert numeric == pytest.approx((gradient * way).sum().item(), rel=1e-5)


@pytest.mark.parametrize("tilted", [False, True])
def test_the_hessian_is_that_of_the_distances(body, tilted):
    motion, cloud = seen(body, kernel=fixed_scale_kernel)
    scene = Scene(torch.zeros(1, 0, 3).double(), ground() if tilted else None)
    estimate = laws.estimate_of(body, motion, scene)
    held = cloud.matched(estimate)
    turn = torch.eye(63).double().expand(2, 63, 63)
    model = ClipModel(Estimate(Decoded(motion), body.pose(motion), scene), 0, turn, 2, True)
    held.add_surface_curvature(3.0, model)
    shapes = motion.shape.shape[-1]

    def distances(x):
        moved = stepped(motion, x[: 2 * FRAME].reshape(1, 2, FRAME), x[None, 2 * FRAME :])
        return held.residuals(laws.estimate_of(body, moved, scene)).values.flatten()

    jacobian = torch.stack(
        [
            (distances(1e-6 * row) - distances(-1e-6 * row)) / 2e-6
            for row in torch.eye(2 * FRAME + shapes).double()
        ],
        -1,
    )
    # ½ s² d² / (s² + d²) of Geman and McClure has this derivative by d² / 2
    slope = (1 + (distances(torch.zeros(2 * FRAME + shapes).double()) / 0.1).square()) ** -2
    exact = 3.0 * (jacobian.mT * slope) @ jacobian
    found = torch.zeros_like(exact)
    for k in range(2):
        rows = slice(k * FRAME, (k + 1) * FRAME)
        found[rows, rows] = model.part.inner[k, 0]
        found[rows, 2 * FRAME :] = model.part.border[k]
        found[2 * FRAME :, rows] = model.part.border[k].mT
    found[2 * FRAME :, 2 * FRAME :] = model.part.corner
    assert (found - exact).norm() < 0.05 * exact.norm()


def test_discs_follow_the_pose_where_the_body_does(toy_body):
    """SMPL bodies have offsets that follow the pose; only the nearest disc's are wanted."""
    g = torch.Generator().manual_seed(2)
    directions = 0.02 * torch.randn(
        9 * 21, toy_body.template.numel(), generator=g, dtype=torch.float64
    )
    body = toy_body.replace(pose_directions=directions.unflatten(1, (-1, 3)))
    motion = laws.a_motion(body, clips=1, frames=3)
    points = body.pose(motion).vertices + 0.05
    present = torch.ones(points.shape[:-1], dtype=torch.bool)
    cloud = PointCloud(points, present, Surfels.of(body), motion.fps)
    estimate = laws.estimate_of(body, motion)
    held = cloud.matched(estimate)
    middles, normals = (
        each.gather(-2, held.pairs[..., None].expand(*held.pairs.shape, 3))
        for each in cloud.surfels.posed(estimate.body)
    )
    away = points - middles
    height = (away * normals).sum(-1)
    across = (away - height[..., None] * normals).norm(dim=-1)
    beyond = (across - torch.from_numpy(cloud.surfels.radii)[held.pairs]).clamp(min=0)
    distances = held.residuals(estimate).distances
    assert torch.allclose(distances, torch.hypot(height, beyond), atol=1e-12)
