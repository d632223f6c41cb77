"""Moments of jumps: a body in the air along a parabola, its feet off the ground and stretched."""

import math

import torch
from jaxtyping import Bool
from torch import Tensor

from recon.core import rotations as so3
from training.humor.moments import Chance, Moments, possible

GRAVITY = 9.81
_CLEAR = (0.01, 0.1)
"""Metres that every joint is higher than recorded where it is lowest."""
_DRIFT = 1.5
"""Metres per second, horizontally."""
_POINTED = math.radians(35)
_TUCKED = math.radians(60)
"""Most that knees are bent more than recorded; hips by half of it."""
_STEADY = 0.5
"""Metres per second by which the vertical speed of the recorded pelvis may change within a
window: beyond, recorded and added accelerations together are not gravity's."""
_LIMBS = (0, 4, 5, 20, 21)


def may_fly(moments: Moments) -> Bool[Tensor, " windows"]:
    """Windows that hands, knees and pelvis do not carry, and that hardly rise or fall faster."""
    rising = moments.translation[..., 2].diff(dim=1) / moments.seconds.diff(dim=1)
    steady = rising.amax(1) - rising.amin(1) < _STEADY
    return steady & ~moments.ever(*_LIMBS)


def flown(moments: Moments, random: torch.Generator) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows in free flight, and which of them a body could move so; nothing is in contact."""
    chance = Chance(random, moments.translation)
    seconds = moments.seconds
    last = seconds[:, -1].clamp(min=0.1)
    apex = (0.1 + 0.8 * chance.between(0.0, 1.0)) * last
    fall = 0.5 * GRAVITY * (seconds - apex[:, None]).square()
    height = chance.between(*_CLEAR)[:, None] + fall.amax(1, keepdim=True) - fall
    angle, speed = chance.between(0.0, 2 * math.pi), chance.between(0.0, _DRIFT)
    level = (speed[:, None] * torch.stack((angle.cos(), angle.sin()), -1))[:, None]
    path = torch.cat((seconds[..., None] * level, height[..., None]), -1)

    tucked, pointed = chance.between(0.0, _TUCKED), chance.between(0.0, _POINTED)
    flat = torch.zeros_like(tucked)
    hip, knee, ankle = (
        so3.exp(torch.stack((turn, flat, flat), -1))[:, None, None]
        for turn in (-tucked / 2, tucked, pointed)
    )
    rotations = moments.rotations.clone()
    rotations[:, :, 1:3] = hip @ rotations[:, :, 1:3]
    rotations[:, :, 4:6] = rotations[:, :, 4:6] @ knee
    rotations[:, :, 7:9] = rotations[:, :, 7:9] @ ankle
    made = moments.derived(
        rotations=rotations,
        translation=moments.translation + path,
        contacts=torch.zeros_like(moments.contacts),
    )
    return made, possible(moments, made)
