"""Moments of joints against sums over all vertices, and signs that laboratories know."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from recon.body.model import BodyModel
from recon.body.opensim import leg_axes
from recon.body.parts import GRAVITY, vertex_masses_of_segments
from recon.core import rotations as so3
from recon.core.motion import MotionFile
from recon.core.skeleton import JOINTS, joint_index
from recon.physics.dynamics import inner_frames, second_differences
from recon.physics.forces import ground_forces
from recon.physics.moments import joint_moments
from recon.physics.plates import MeasuredForces
from tests.standing_body import path, standing, times

FPS, MASS = 60.0, 70.0
LEFT_LEG = ("left_hip", "left_knee", "left_ankle", "left_foot")


@pytest.fixture(scope="module")
def swinging(body: BodyModel):
    """A body whose hips and knees bend and turn smoothly, with its forces."""
    t = times(1.0, FPS)
    motion = standing(body, path(x=0.5 * t**2, like=t), FPS)
    turns = motion.rotations.clone()
    for name, axis in (("left_hip", [-0.8, 0.2, 0.1]), ("left_knee", [0.9, 0.0, 0.0])):
        turn = torch.tensor(axis, dtype=torch.float64) * torch.sin(3 * t)[:, None] ** 2
        turns[:, joint_index(name)] = so3.exp(turn)
    motion = motion.replace(rotations=turns)
    return motion, ground_forces(MotionFile(motion), body, mass=MASS)


def test_moments_are_those_of_all_masses_below_a_joint(body: BodyModel, swinging) -> None:
    motion, forces = swinging
    off = replace(forces, force=torch.zeros_like(forces.force))
    found = joint_moments(motion, body, off).moments
    own = body.to(dtype=torch.float64)
    posed, axes = own.pose(motion), leg_axes(own, motion, "rajagopal2016")
    masses = MASS * vertex_masses_of_segments(own)
    bone = own.weights.argmax(-1)
    vertices = posed.vertices
    pull = second_differences(vertices, FPS) + vertices.new_tensor([0, 0, GRAVITY])
    step = (len(vertices) - len(pull)) // 2
    for name, parts in (("hip_flexion_l", LEFT_LEG), ("knee_angle_l", LEFT_LEG[1:])):
        below = torch.isin(bone, torch.tensor([JOINTS.index(one) for one in parts]))
        arms = inner_frames(vertices - posed.joints[:, None, joint_index(parts[0])], FPS)
        each = masses[:, None] * torch.linalg.cross(arms, pull, dim=-1)
        expected = (each[:, below].sum(1).numpy() * axes[name][step:-step]).sum(-1)
        assert np.abs(expected).max() > 3
        assert found[name][step:-step] == pytest.approx(expected, abs=0.02)


def test_forces_act_with_their_lever_and_plates_come_first(body: BodyModel, swinging) -> None:
    motion, forces = swinging
    frames = motion.frames
    push = np.zeros((frames, 2, 3))
    push[:, 0] = [20.0, -30.0, 500.0]
    place = np.zeros((frames, 2, 3))
    place[:, 0] = [0.2, 0.1, 0.0]
    known = np.zeros((frames, 2), dtype=bool)
    known[:, 0] = True
    plates = MeasuredForces(push, place, np.full((frames, 2), 4.0), known, ())
    off = replace(forces, force=torch.zeros_like(forces.force))
    without, found = joint_moments(motion, body, off), joint_moments(motion, body, forces, plates)
    ankle = body.pose(motion).joints[:, joint_index("left_ankle")].numpy()
    axis = leg_axes(body, motion, "rajagopal2016")["ankle_angle_l"]
    whole = -np.cross(place[:, 0] - ankle, push[:, 0]) - [0, 0, 4.0]
    change = found.moments["ankle_angle_l"] - without.moments["ankle_angle_l"]
    assert change == pytest.approx((whole * axis).sum(-1), abs=1e-3)
    assert found.measured[:, 0].all()
    assert not found.measured[:, 1].any()
    estimated = joint_moments(motion, body, forces)
    assert (found.std["ankle_angle_l"] < 30).all()
    assert found.moments["knee_angle_r"] == pytest.approx(estimated.moments["knee_angle_r"])


def test_who_stands_on_the_toes_pushes_them_down_on_both_sides_alike(body: BodyModel) -> None:
    """Plantar flexion is negative, as OpenSim's inverse dynamics has it."""
    upright = standing(body, path(like=times(0.5, FPS)), FPS)
    forces = ground_forces(MotionFile(upright), body, mass=MASS)
    toes = forces.centre + forces.centre.new_tensor([0.0, -0.06, 0.0])  # it faces -y
    found = joint_moments(upright, body, replace(forces, centre=toes)).moments
    assert (found["ankle_angle_l"] < -10).all()
    for name in ("ankle_angle", "knee_angle", "hip_flexion", "hip_adduction", "hip_rotation"):
        assert found[f"{name}_l"] == pytest.approx(found[f"{name}_r"], abs=1.5)
