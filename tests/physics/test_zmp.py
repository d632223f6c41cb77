"""The zero-moment point against Newton and Euler, and the published one against it."""

import torch
from torch import Tensor

from recon.physics.dynamics import Dynamics
from recon.physics.zmp import (
    GRAVITY,
    HUMOS_CODE_GRAVITY,
    relative_load,
    share_carried,
    zmp,
    zmp_of_humos_code,
)
from tests.physics.point_masses import points_dynamics

FPS = 20.0


def dynamics(
    acceleration=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), height=1.0, mass=70.0
) -> Dynamics:
    def one(*values: float) -> Tensor:
        return torch.tensor([values], dtype=torch.float64)

    total = torch.tensor(mass, dtype=torch.float64)
    return Dynamics(total, one(0.3, -0.2, height), one(*acceleration), one(*spin))


def parabola(points: Tensor, accelerations: Tensor) -> Tensor:
    """Three frames (3 points 3) at 20 Hz through the points with these accelerations."""
    t = torch.tensor([-1.0, 0.0, 1.0], dtype=torch.float64)[:, None, None] / FPS
    velocities = torch.randn_like(points)
    return points + velocities * t + accelerations * t.square() / 2


def test_who_stands_still_presses_under_the_centre_of_mass() -> None:
    points = torch.rand(50, 3, dtype=torch.float64).expand(3, 50, 3)
    moving = points_dynamics(points, torch.rand(50, dtype=torch.float64), FPS)
    for kind in (zmp, zmp_of_humos_code):
        assert (kind(moving) - moving.centre[..., :2]).abs().max() < 1e-6
    assert torch.allclose(relative_load(moving), torch.ones(1, dtype=torch.float64))


def test_cart_and_table() -> None:
    height, push = 0.9, 2.0
    moving = dynamics((push, 0.0, 0.0), height=height)
    shift = (zmp(moving) - moving.centre[..., :2])[0]
    expected = torch.tensor([-height * push / GRAVITY, 0.0], dtype=torch.float64)
    assert torch.allclose(shift, expected, atol=1e-12)


def test_a_vertical_push_moves_nothing() -> None:
    for push in (-3.0, 5.0):
        still = torch.tensor([[0.3, -0.2]], dtype=torch.float64)
        assert torch.allclose(zmp(dynamics((0.0, 0.0, push))), still, atol=1e-12)


def test_the_ground_has_no_moment_about_it() -> None:
    masses = torch.rand(50, dtype=torch.float64) + 0.1
    places = torch.rand(50, 3, dtype=torch.float64) * 2
    accelerations = 4 * torch.randn(50, 3, dtype=torch.float64)
    moving = points_dynamics(parabola(places, accelerations), masses, FPS)
    assert moving.spin.abs().max() > 1  # the test is about more than the centre of mass
    point = torch.cat((zmp(moving)[0], torch.zeros(1, dtype=torch.float64)))
    up = torch.tensor([0.0, 0.0, GRAVITY], dtype=torch.float64)
    forces = masses[:, None] * (accelerations + up)
    moment = torch.linalg.cross(places - point, forces).sum(0)
    assert moment[:2].abs().max() < 1e-8


def test_a_rod_that_spins_up_presses_on_the_side_that_its_moment_says() -> None:
    half = torch.tensor([0.5, 0.0, 0.0], dtype=torch.float64)
    above = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    lift = torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64)
    # the end at +x goes up: the ground must push harder there
    points = parabola(torch.stack((above + half, above - half)), torch.stack((lift, -lift)))
    moving = points_dynamics(points, torch.ones(2, dtype=torch.float64), FPS)
    expected = 0.5 * 2.0 / GRAVITY  # Σ x m a_z / Σ m g
    assert torch.allclose(zmp(moving)[0, 0], torch.tensor(expected, dtype=torch.float64))


def test_free_fall_has_no_weight_and_a_finite_gradient() -> None:
    fall = torch.tensor([[0.5, 0.0, -GRAVITY]], dtype=torch.float64, requires_grad=True)
    moving = dynamics(spin=(3.0, -2.0, 0.0)).replace(acceleration=fall)
    weight = share_carried(moving)
    assert weight.item() == 0
    (slope,) = torch.autograd.grad((weight * zmp(moving).square().sum(-1)).sum(), fall)
    assert slope.isfinite().all()
    assert zmp(moving).abs().max() < 10  # metres
    assert share_carried(dynamics()).item() == 1


def test_the_released_one_differs_by_its_denominator_alone() -> None:
    moving = dynamics((1.0, -0.5, 2.5), (4.0, -7.0, 1.0))
    centre = moving.centre[..., :2]
    ratio = (GRAVITY + 2.5) / (HUMOS_CODE_GRAVITY - 2.5)
    assert torch.allclose(zmp_of_humos_code(moving) - centre, ratio * (zmp(moving) - centre))


def test_the_released_one_is_finite_at_its_singularity() -> None:
    pushed = dynamics((1.0, 0.0, HUMOS_CODE_GRAVITY), (0.0, 1.0, 0.0))
    assert zmp_of_humos_code(pushed).isfinite().all()
