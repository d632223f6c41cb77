"""Deep bends, turns and leanings of the pelvis over feet that stay where they are."""

import math

import torch
from jaxtyping import Bool
from torch import Tensor

from priors.humor.training.variety.legs import ANKLES, KNEES, Aim, brought
from priors.humor.training.variety.limits import possible
from priors.humor.training.variety.moments import Moments, forward_of
from priors.humor.training.variety.waves import Chance
from recon.core import rotations as so3

_DEPTH = (0.02, 0.45)
"""Metres by which the pelvis is lowered at most, of a logarithmically uniform choice."""
_PERIODS = (1.1, 3.0)
"""Seconds; slow enough that lowering and rising take less than gravity gives."""
_STOOP = math.radians(60)
"""Most that the trunk leans forward in the deepest bend."""
_LEVER = 0.2
"""Metres that the pelvis goes back for a trunk leaning by a right angle, so that the centre of
mass stays over the feet."""
_TURN = math.radians(30)
_ROLL = math.radians(10)
_SHIFT = 0.06
"""Metres sideways and forward."""
_HANDS = (20, 21)


def may_bend(moments: Moments) -> Bool[Tensor, " windows"]:
    """Windows in which neither hands nor knees nor the pelvis carry weight."""
    return ~moments.ever(0, *KNEES, *_HANDS)


def bent(moments: Moments, random: torch.Generator) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows with another path of the pelvis, and which of them a body could move so.

    Both feet stay exactly where they were, in contact or not, and so do their labels.
    """
    chance = Chance(random, moments.translation)
    orientations, joints = posed = moments.posed()
    root, pelvis = orientations[:, :, 0], joints[:, :, 0]
    ahead = forward_of(root)
    left = torch.stack((-ahead[..., 1], ahead[..., 0], torch.zeros_like(ahead[..., 0])), -1)
    up = ahead.new_tensor([0.0, 0.0, 1.0])

    depth = chance.slow(*_DEPTH)
    lowered = 0.3 + 0.7 * chance.wave(moments.seconds, *_PERIODS)
    stoop = (chance.between(0.0, _STOOP / _DEPTH[1]) * depth)[:, None] * lowered
    turn = chance.between(-_TURN, _TURN)[:, None] * _half(chance, moments)
    roll = chance.between(-_ROLL, _ROLL)[:, None] * _half(chance, moments)
    aside = chance.between(-_SHIFT, _SHIFT)[:, None] * _half(chance, moments)
    on = chance.between(-_SHIFT, _SHIFT)[:, None] * _half(chance, moments)
    on = on - _LEVER * stoop.sin()

    angle = turn[..., None] * up + stoop[..., None] * left + roll[..., None] * ahead
    path = pelvis + on[..., None] * ahead + aside[..., None] * left
    path = path - (depth[:, None] * lowered)[..., None] * up
    aim = Aim(so3.exp(angle) @ root, path, joints[:, :, list(ANKLES)], depth)
    rotations, reached = brought(moments.rotations, posed, moments.rest, aim)
    made = moments.derived(rotations=rotations, translation=moments.translation + path - pelvis)
    return made, reached.all(1) & possible(moments, made)


def _half(chance: Chance, moments: Moments) -> Tensor:
    """Waves between a half and one: a displacement that lasts, and changes."""
    return 0.5 + 0.5 * chance.wave(moments.seconds, *_PERIODS)
