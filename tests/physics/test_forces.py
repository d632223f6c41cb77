"""Forces of the ground: bodies that stand, lean, jump, lie; what nobody could answer is said."""

import math

import pytest
import torch

from recon.body.model import BodyModel
from recon.body.parts import GRAVITY, vertex_masses_of_segments
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion, MotionFile
from recon.physics.dynamics import body_dynamics
from recon.physics.forces import GroundForces, ground_forces
from recon.physics.zmp import zmp
from tests.standing_body import path, standing, times

FPS = 100.0
STILL = path(like=times(1.0, FPS))


def forces_of(motion: Motion, body: BodyModel, mass: float | None = 70.0, **more) -> GroundForces:
    return ground_forces(MotionFile(motion, **more), body, mass=mass)


def test_who_stands_presses_with_the_whole_weight_on_both_feet(body: BodyModel) -> None:
    found = forces_of(standing(body, STILL, FPS), body)
    whole = found.force.sum(1)
    assert torch.allclose(whole[:, 2], whole.new_tensor(70 * GRAVITY), rtol=1e-6)
    assert whole[:, :2].abs().max() < 1e-6
    assert found.force[..., 2].min() > 0.4 * 70 * GRAVITY
    assert found.contact.all()
    assert found.warnings == ()
    # feet that lean on each other push apart
    assert (found.force[:, 0, 0] * found.force[:, 1, 0] < 0).all()


def test_who_leans_to_one_side_presses_there_so_that_the_moment_is_right(body: BodyModel) -> None:
    motion = standing(body, STILL, FPS)
    leaning = motion.rotations.clone()
    side = so3.exp(torch.tensor([0.0, 0.0, 0.4], dtype=torch.float64))
    leaning[:, 3] = side  # spine1
    motion = motion.replace(rotations=leaning)
    found = forces_of(motion, body)
    share = found.force[..., 2] / found.force[..., 2].sum(1, keepdim=True)
    moving = body_dynamics(body.pose(motion), vertex_masses_of_segments(body), FPS)
    line = found.centre[0, 1, :2] - found.centre[0, 0, :2]
    acting = (share[0, :, None] * found.centre[0, :, :2]).sum(0)
    assert ((acting - zmp(moving)[0]) @ line).abs() < 1e-9
    heavier = int(share[0].argmax())
    assert share[0, heavier] > 0.6


def test_the_whole_force_is_newtons_and_flight_has_none(body: BodyModel) -> None:
    t = times(1.0, FPS)
    fall = (t - 0.5).clamp(min=0)
    motion = standing(body, path(z=3 * fall - GRAVITY * fall.square() / 2, like=t), FPS)
    found = forces_of(motion, body)
    up = found.force[..., 2].sum(1)
    assert (up[t > 0.62] == 0).all()
    assert torch.allclose(up[t < 0.44], up.new_tensor(70 * GRAVITY), rtol=1e-6)
    assert up.max() > 2 * 70 * GRAVITY  # the push-off
    assert found.warnings == ()


def test_ground_of_another_height_and_uncertain_joints(body: BodyModel) -> None:
    low = standing(body, STILL, FPS)
    high = low.replace(translation=low.translation + low.translation.new_tensor([0, 0, 0.5]))
    here = forces_of(low, body)
    there = forces_of(high, body, ground=torch.tensor([0.0, 0.0, 1.0, 0.5]))
    assert torch.allclose(here.force, there.force, atol=1e-6)
    assert torch.allclose(there.centre[..., 2], there.centre.new_tensor(0.5))
    unsure = forces_of(low, body, joint_std=torch.full((len(STILL), 22), 0.05))
    assert (unsure.force_std > here.force_std).all()
    assert (unsure.centre_std > here.centre_std).all()


def test_a_mass_that_nobody_gave_is_that_of_the_shape_and_is_said(body: BodyModel) -> None:
    motion = standing(body, STILL, FPS)
    guessed, known = forces_of(motion, body, None), forces_of(motion, body)
    assert 60 < guessed.mass < 80
    assert "no mass given" in guessed.warnings[0]
    relative = guessed.force_std / guessed.mass
    assert (relative[..., 2] > known.force_std[..., 2] / known.mass).all()


def test_nobody_on_the_ground_and_who_lies_are_said(body: BodyModel) -> None:
    motion = standing(body, STILL, FPS)
    above = motion.replace(translation=motion.translation + motion.translation.new_tensor(1.0))
    found = forces_of(above, body)
    assert not found.force.any()
    assert "no foot ever stands" in found.warnings[0]
    turned = motion.rotations.clone()
    turned[:, 0] = so3.exp(torch.tensor([-math.pi / 2, 0, 0], dtype=torch.float64)) @ turned[:, 0]
    lying = motion.replace(rotations=turned, translation=torch.zeros_like(motion.translation))
    lowest = body.pose(lying.window(0, 1)).vertices[..., 2].min()
    down = lying.translation.new_tensor([0, 0, float(lowest)])
    found = forces_of(lying.replace(translation=lying.translation - down), body)
    assert not found.force.any()
    assert found.warnings


@pytest.mark.parametrize(
    ("frames", "mass", "ground", "said"),
    [
        (5, 70.0, (0.0, 0.0, 1.0, 0.0), "11 frames or more"),
        (40, 70_000.0, (0.0, 0.0, 1.0, 0.0), "give kilograms"),
        (40, math.nan, (0.0, 0.0, 1.0, 0.0), "give kilograms"),
        (40, 70.0, (0.1, 0.0, 0.995, 0.0), "level ground"),
    ],
)
def test_what_has_no_forces_is_refused(body, frames, mass, ground, said) -> None:
    motion = standing(body, STILL[:frames], FPS)
    with pytest.raises(ReconError, match=said):
        forces_of(motion, body, mass, ground=torch.tensor(ground))


def test_one_leg_carries_all_and_how_far_it_is_out_of_balance_widens_deviations(body) -> None:
    motion = standing(body, STILL, FPS)
    lifted = motion.rotations.clone()
    knee = so3.exp(torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64))
    lifted[:, 2], lifted[:, 5] = knee.mT, knee  # right hip and knee
    over = so3.exp(torch.tensor([0.0, 0.0, -0.3], dtype=torch.float64))
    both = forces_of(motion, body)
    falling = forces_of(motion.replace(rotations=lifted), body)
    lifted[:, 3] = over  # the trunk leans to the left, over the standing foot
    balanced = forces_of(motion.replace(rotations=lifted), body)
    for found in (falling, balanced):
        assert found.contact[:, 0].all()
        assert not found.contact[:, 1].any()
        assert torch.allclose(found.force[:, 0, 2], found.force.new_tensor(70 * GRAVITY))
        assert not found.force[:, 1].any()
        assert not found.force_std[:, 1].any()
        # towards the middle, but within the sole
        assert 0 < (both.centre - found.centre)[0, 0, 0] < 0.05
    assert (balanced.centre_std < 0.9 * falling.centre_std).all()
    assert (balanced.force_std[:, 0, :2] < falling.force_std[:, 0, :2]).all()
