"""Energies of a body on the ground: laws, planted faults, flight, rates and gradients."""

import pytest
import torch

from recon.core import rotations as so3
from recon.physics import energies as physics
from recon.physics.dynamics import difference_step
from recon.physics.energies import FloatingUnlessFlying
from recon.physics.zmp import GRAVITY
from tests import laws
from tests.standing_body import path, standing, times

ENERGIES = (physics.penetration, physics.floating, physics.slide, physics.dynamic_stability)


def value(energy, body, motion) -> float:
    return energy(laws.estimate_of(body, motion.map(lambda t: t[None]))).item()


@pytest.fixture(scope="module")
def walkers(body):
    """Two clips that sway and sink into the ground."""
    motion = laws.a_motion(body, frames=8, fps=20.0)
    low = body.pose(motion).vertices[..., 2].amin((-1, -2))
    drop = torch.stack((torch.zeros(2), torch.zeros(2), low + 0.03), -1)
    return motion.replace(translation=motion.translation - drop[:, None])


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
def test_energies_keep_their_contract(energy, body, walkers):
    still = standing(body, path(like=times(0.4))).map(lambda t: t[None])
    balanced = energy is physics.dynamic_stability
    laws.check_energy(energy, body, walkers, None if balanced else still)
    assert (energy(laws.estimate_of(body, walkers)) > 0).all()


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
def test_padding_counts_nothing(energy, body, walkers):
    short = laws.estimate_of(body, walkers.window(0, 6))
    wild = walkers.rotations.clone()
    wild[:, 6:] = so3.exp(torch.randn(2, 2, 22, 3, dtype=torch.float64))
    padded = walkers.replace(rotations=wild, valid=torch.arange(8).expand(2, 8) < 6)
    assert torch.allclose(energy(laws.estimate_of(body, padded)), energy(short), rtol=1e-10)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
@pytest.mark.parametrize("frames", [1, 2])
def test_short_clips_have_an_energy(energy, body, frames, walkers):
    assert energy(laws.estimate_of(body, walkers.window(0, frames))).isfinite().all()


def test_penetration_is_half_the_square_of_each_sunk_part(body):
    deep = standing(body, path(z=-0.035, like=times(1.0, 30.0)), 30.0)
    # two feet, 31 frames, 3 cm below the tolerance; the lowest point is 3 mm blurred
    expected = 0.5 * 2 * 31 * 0.03**2
    assert value(physics.penetration, body, deep) == pytest.approx(expected, rel=0.2)
    assert value(physics.floating, body, deep) == 0


def test_hovering_is_floating_and_falling_is_not(body):
    t = times(0.5)
    hovering = standing(body, path(z=0.105, like=t))
    assert value(physics.floating, body, hovering) == pytest.approx(
        0.5 * len(t) * 0.1**2 * 30 / 20, rel=0.1
    )
    flying = standing(body, path(z=0.1 + 2 * t - GRAVITY / 2 * t.square(), like=t))
    assert value(physics.floating, body, flying) < 1e-12
    assert value(physics.dynamic_stability, body, flying) < 1e-12


def test_floating_where_flight_is_known(body):
    t = times(0.5)
    hovering = standing(body, path(z=0.105, like=t)).map(lambda x: x[None])
    some = FloatingUnlessFlying(torch.arange(len(t))[None] >= 3)
    ours, whole = (f(laws.estimate_of(body, hovering)) for f in (some, physics.floating))
    assert ours.item() == pytest.approx(whole.item() * 3 / len(t), rel=1e-6)
    laws.check_energy(some, body, hovering, None)


def test_slide_is_half_the_square_of_the_step_and_lets_go(body):
    t = times(1.0, 30.0)

    def sliding(speed, height=0.0):
        return value(
            physics.slide, body, standing(body, path(x=speed * t, z=height, like=t), 30.0)
        )

    slow = 0.1
    # soles up to 1.5 cm high are in contact by 0.73 and more
    most = 0.5 * 2 * 30 * (slow / 30) ** 2
    assert 0.7 * most < sliding(slow) < most
    assert sliding(5.0) < sliding(0.1) * 26  # the square would be 2500 times
    assert sliding(slow, height=0.06) < 1e-4 * most


def test_a_push_that_tips_the_body_costs_and_standing_hardly(body):
    t = times(1.0)
    still = value(physics.dynamic_stability, body, standing(body, path(like=t)))
    pushed = value(physics.dynamic_stability, body, standing(body, path(x=t.square(), like=t)))
    assert still < 0.3 * pushed
    # cart and table: 2 m/s² at about 0.95 m move the ZMP by 0.19 m
    expected = 0.5 * (len(t) - 2) * 1.5 * (0.19**2 * 0.09 / (0.09 + 0.19**2))
    assert pushed - still == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("energy", ENERGIES, ids=lambda e: e.__name__)
def test_values_do_not_depend_on_the_frame_rate(energy, body):
    t = times(2.0, 120.0)
    up = 0.02 * torch.sin(torch.pi * t)
    sway = standing(body, path(x=0.1 * torch.sin(3 * t), z=up, like=t), 120.0)
    coarse, fine = (value(energy, body, sway.resample(fps)) for fps in (20.0, 120.0))
    # the ends count for different durations, and have no acceleration
    assert coarse == pytest.approx(fine, rel=0.15)


def test_dynamic_stability_has_its_gradient(body):
    t = times(0.3)
    still = standing(body, path(x=t.square(), like=t)).map(lambda x: x[None])

    def energy(shift, turn):
        rotations = still.rotations @ so3.exp(turn)
        moved = still.replace(translation=still.translation + shift, rotations=rotations)
        return physics.dynamic_stability(laws.estimate_of(body, moved))

    shift = 1e-3 * torch.randn(1, len(t), 3, dtype=torch.float64)
    turn = 1e-3 * torch.randn(1, len(t), 22, 3, dtype=torch.float64)
    inputs = shift.requires_grad_(), turn.requires_grad_()
    assert torch.autograd.gradcheck(energy, inputs, eps=1e-6, atol=1e-6, fast_mode=True)


def test_the_few_points_are_near_the_whole_surface(body, walkers):
    estimate = laws.estimate_of(body, walkers)
    parts = physics.lowest_of_parts(estimate).amin(-1)
    lowest = estimate.body.vertices[..., 2].amin(-1)
    assert ((parts - lowest).abs() < 0.008).all()  # metres
    assert difference_step(walkers.fps) == 1
