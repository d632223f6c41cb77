"""Frames of the HUMOS prior: exact both ways, blind to place and heading, on the ground."""

import math

import pytest
import torch

from priors.humos.frames import (
    HOP,
    NUMBERS,
    BodyFrames,
    LappedBasis,
    lever_lengths,
    lowest_heights,
    window_count,
)
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length, with_shape
from recon.core import rotations as so3
from tests.priors.tiny_humos import rows_of_walks
from tests.walking import a_walk
from training.humos.corpus import mirrored, relative_to_first_frame
from training.humos.train import fitted_basis

BODY = BodyModel.load()


def close(found, expected, atol):
    torch.testing.assert_close(found, expected, atol=atol, rtol=0)


def walk(fps=20.0):
    found = a_walk(BODY, seconds=2.0, fps=fps)
    shape = torch.linspace(-1, 1, BODY.shape_size)
    return with_shape(found, BODY, shape)


def wild(seed=0):
    """Any pose at any place."""
    random = torch.Generator().manual_seed(seed)
    motion = walk()
    turns = torch.randn(motion.frames, 22, 3, generator=random)
    return motion.replace(
        rotations=motion.rotations @ so3.exp(0.7 * turns),
        translation=motion.translation + torch.randn(motion.frames, 3, generator=random),
    )


def turned(motion, angle, shift=(1.0, -2.0, 0.0)):
    T = so3.rigid(so3.about_z(torch.tensor(angle)), torch.tensor(shift))
    return motion.carried(T, BODY.rest_joints(motion.shape)[0])


@pytest.mark.parametrize("motion", [walk(), wild()], ids=["walk", "any poses"])
def test_round_trip_is_exact(motion):
    frames, base = BodyFrames.of(motion, BODY)
    again = BodyFrames.unpack(frames.pack()).motion(motion.shape, BODY, motion.fps, base)
    close(again.translation, motion.translation, atol=2e-5)
    close(again.rotations, motion.rotations, atol=2e-5)


@pytest.mark.parametrize("angle", [0.3, 2.0, math.pi, -1.5])
def test_features_do_not_see_heading_and_place(angle):
    plain, _ = BodyFrames.of(walk(), BODY)
    other, base = BodyFrames.of(turned(walk(), angle), BODY)
    close(other.pack(), plain.pack(), atol=1e-4)
    again = other.motion(walk().shape, BODY, 20.0, base)
    close(again.translation, turned(walk(), angle).translation, atol=1e-4)


def test_beginning_anew_is_what_a_window_is_encoded_as():
    whole, _ = BodyFrames.of(turned(wild(), 0.5), BODY)
    later = whole.map(lambda rows: rows[20:])
    again = relative_to_first_frame(later)
    assert float(again.place[0].abs().max()) == 0
    close(again.direction[0], torch.tensor([1.0, 0.0]), atol=1e-6)
    close(relative_to_first_frame(again).pack(), again.pack(), atol=1e-6)
    c, s = later.direction[0]
    back = torch.stack((torch.stack((c, s)), torch.stack((-s, c))))
    close(again.place, (later.place - later.place[0]) @ back.mT, atol=1e-5)


def test_mirrored_twice_is_the_same_and_once_exchanges_the_feet():
    frames, base = BodyFrames.of(wild(), BODY)
    close(mirrored(mirrored(frames)).pack(), frames.pack(), atol=1e-6)
    shape = torch.zeros(BODY.shape_size)
    base = torch.eye(4)
    one = BODY.pose(frames.motion(shape, BODY, 20.0, base)).joints
    other = BODY.pose(mirrored(frames).motion(shape, BODY, 20.0, base)).joints
    close(other[:, 10], one[:, 11] * torch.tensor([-1.0, 1.0, 1.0]), atol=2e-2)


def test_any_body_stands_as_high_above_the_ground():
    motion = walk()
    frames, base = BodyFrames.of(motion, BODY)
    for seed in range(3):
        shape = torch.randn(BODY.shape_size, generator=torch.Generator().manual_seed(seed))
        made = frames.motion(shape, BODY, 20.0, base)
        legs = leg_length(BODY, shape) / leg_length(BODY, motion.shape)
        close(lowest_heights(BODY.pose(made)), lowest_heights(BODY.pose(motion)) * legs, atol=1e-5)


def test_joints_are_those_of_the_motion_about_the_pelvis():
    motion = wild()
    frames, base = BodyFrames.of(motion, BODY)
    joints = BODY.pose(motion).joints
    seen = (joints - base[:3, 3]) @ base[:3, :3]
    seen = seen - seen[:, :1] * torch.tensor([0.0, 0.0, 1.0])
    close(frames.joints(motion.shape, BODY), seen, atol=1e-4)


def test_levers_are_lengths_of_bones():
    assert lever_lengths().shape == (22,)
    assert 0.3 < float(lever_lengths()[1]) < 0.8  # a thigh, and half as much again
    assert float(lever_lengths()[10]) == pytest.approx(1.5 * 0.08)


@pytest.mark.parametrize("frames", [16, 37, 40])
def test_windows_add_up_to_the_motion(frames):
    """With all directions kept nothing is lost, at any length."""
    random = torch.Generator().manual_seed(0)
    size = 2 * HOP * NUMBERS
    rows = torch.randn(2, frames, NUMBERS, generator=random)
    every = LappedBasis(torch.zeros(size), torch.eye(size), torch.ones(size))
    coefficients = every.analyse(rows)
    assert coefficients.shape == (2, window_count(frames), size)
    close(every.synthesise(coefficients, frames), rows, atol=1e-5)


def test_few_directions_are_enough_for_walks():
    rows = rows_of_walks(BODY)
    basis = fitted_basis(rows, 16)
    others = rows_of_walks(BODY, count=4, seed=1)
    away = basis.synthesise(basis.analyse(others), others.shape[1]) - others
    plain = others - others.mean((0, 1))
    assert float(away.square().mean()) < 0.02 * float(plain.square().mean())
    with pytest.raises(ValueError, match="more windows"):
        fitted_basis(rows[:1], 16)
