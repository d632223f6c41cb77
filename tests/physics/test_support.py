"""Support: who carries a body that does not fall, where nobody saw its legs."""

from dataclasses import replace

import pytest
import torch

from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.physics.energies import dynamics_of
from recon.physics.support import (
    BALANCE,
    HEIGHT,
    REACH,
    SPEED,
    TOLERANCE,
    SupportEnergy,
    heavy_tailed,
)
from recon.physics.zmp import GRAVITY, zmp
from tests import laws
from tests.standing_body import path, standing, times

UNSEEN = SupportEnergy(torch.tensor([True]))


def value(body, motion) -> float:
    return UNSEEN(laws.estimate_of(body, motion.map(lambda t: t[None]))).item()


def test_support_keeps_the_contract_of_energies(body):
    walkers = laws.a_motion(body, frames=8, fps=20.0)
    laws.check_energy(SupportEnergy(torch.tensor([True, True])), body, walkers, None)


def test_who_stands_is_carried_and_who_glides_above_the_ground_is_not(body):
    time = times(2.0, 30.0)
    stands = value(body, standing(body, path(like=time), 30.0))
    glides = value(body, standing(body, path(x=1.3 * time, z=0.13, like=time), 30.0))
    # the least of ten pairs, some of which carry, is taken softly
    assert 0 <= stands < 57 * 0.3
    assert glides > 57 * 4


def test_who_flies_needs_no_foot(body):
    time = times(0.5, 30.0)
    rise = 0.5 + 3 * time - 0.5 * GRAVITY * time.square()
    assert value(body, standing(body, path(z=rise, like=time), 30.0)) == pytest.approx(0, abs=1e-6)


def test_one_foot_carries_who_leans_over_it(body):
    """A foot was enough wherever it stood: dancers' legs hung below bodies that leaned aside."""
    time = times(1.0, 30.0)
    both = standing(body, path(like=time), 30.0)
    turned = both.rotations.clone()
    bent = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=turned.dtype)
    turned[:, 4] = bent
    one = both.replace(rotations=turned)
    raised = laws.estimate_of(body, one.map(lambda t: t[None])).body.joints[0, 0]
    assert raised[7, 2] > raised[8, 2] + 0.2
    beside = float((raised[8, :2] - raised[0, :2]).norm()) - REACH
    assert value(body, one) > 27 * heavy_tailed(torch.tensor(0.5 * (0.7 * beside / BALANCE) ** 2))
    leaning = leaning_over(one, raised[8] - raised[0])
    # the least of ten is taken softly: less than a nat per frame between two feet and one
    assert abs(value(body, leaning) - value(body, both)) < 27 * 1.0
    assert value(body, leaning) < value(body, one)


def leaning_over(motion: Motion, foot: torch.Tensor) -> Motion:
    """The body turned about the direction it faces until its pelvis is above the foot."""
    angle = torch.atan2(foot[0], -foot[2])
    turn = so3.exp(torch.stack((0 * angle, angle, 0 * angle)))
    rotations = motion.rotations.clone()
    rotations[:, 0] = turn @ rotations[:, 0]
    return motion.replace(rotations=rotations)


def test_clips_whose_legs_were_seen_have_no_energy(body):
    walkers = laws.a_motion(body, frames=8, fps=20.0)
    estimate = laws.estimate_of(body, walkers)
    some = SupportEnergy(torch.tensor([True, False]))(estimate)
    assert some[0] > 0
    assert some[1] == 0


def test_padding_counts_nothing(body):
    walkers = laws.a_motion(body, frames=10, fps=20.0)
    support = SupportEnergy(torch.tensor([True, True]))
    wild = walkers.translation.clone()
    wild[:, 7:] += torch.randn(2, 3, 3, dtype=torch.float64)
    padded = walkers.replace(translation=wild, valid=torch.arange(10).expand(2, 10) < 7)
    short = support(laws.estimate_of(body, walkers.window(0, 7)))
    assert torch.allclose(support(laws.estimate_of(body, padded)), short, rtol=1e-10)


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_clips_without_accelerations_have_no_energy(body, frames):
    clip = laws.a_motion(body, frames=8, fps=30.0).window(0, frames)
    assert (SupportEnergy(torch.tensor([True, True]))(laws.estimate_of(body, clip)) == 0).all()


def test_its_curvature_is_that_of_the_foot_that_rests(body):
    time = times(0.4, 30.0)
    still = standing(body, path(like=time), 30.0).map(lambda t: t[None])
    estimate = laws.estimate_of(body, still)
    joints = estimate.body.joints.clone()
    # the right foot is far, and of the left one only the toe is a little too high
    joints[0, :, [8, 11], 2] += 1.0
    joints[0, :, 7, 2] += 0.5
    joints[0, :, 10, 2] += TOLERANCE + 0.002
    joints[0, :, 10, :2] = zmp(dynamics_of(estimate))[0, 0]
    estimate = replace(estimate, body=replace(estimate.body, joints=joints))
    coefficients = torch.zeros(len(time), 3, 66, dtype=torch.float64)
    UNSEEN.add_curvature(2.0, estimate, 0, coefficients)
    place = coefficients[:, 0].unflatten(-1, (22, 3))
    middle = len(time) // 2
    held = (30 / SPEED) ** 2
    assert place[middle, 10, 0] == pytest.approx(2.0 * 2 * held, rel=0.01)
    assert place[middle, 10, 2] == pytest.approx(2.0 * (2 * held + 1 / HEIGHT**2), rel=0.01)
    assert coefficients[middle, 1, 30] == pytest.approx(-2.0 * held, rel=0.01)
    others = [k for k in range(22) if k not in FEET]
    assert (place[:, others] == 0).all()
    assert place[middle, 8].abs().max() < 1e-3 * place[middle, 10, 0]


def test_curvature_of_seen_legs_is_none(body):
    still = standing(body, path(like=times(0.4, 30.0)), 30.0).map(lambda t: t[None])
    coefficients = torch.zeros(still.frames, 3, 66, dtype=torch.float64)
    estimate = laws.estimate_of(body, still)
    SupportEnergy(torch.tensor([False])).add_curvature(1.0, estimate, 0, coefficients)
    assert (coefficients == 0).all()
