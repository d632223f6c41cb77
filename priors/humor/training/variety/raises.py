"""One leg raised forward, sideways or back, straight or with the knee bent, on the other one."""

import math

import torch
from jaxtyping import Bool
from torch import Tensor

from priors.humor.training.variety.legs import ANKLES, Aim, brought
from priors.humor.training.variety.limits import possible
from priors.humor.training.variety.moments import CHANNELS, Moments, at_frames, forward_of, speeds
from priors.humor.training.variety.waves import Chance
from recon.core import rotations as so3

_HIGHEST = math.radians(100)
_BACK = 0.35
"""Most that the thigh turns from where it was recorded, and the share of it that is left of a
raise backwards."""
_DIRECTIONS = (math.radians(-10), math.radians(150))
"""Directions of a raise, from forward over sideways to back, radians."""
_PERIODS = (1.0, 3.0)
"""Seconds of raising and lowering."""
_KNEE = math.radians(120)
_POINTED = math.radians(30)
"""Most that the foot of the raised leg is stretched."""
_LEG_SHARE = 0.16
"""Mass of a leg, as a share of the body's; its centre is near the knee."""
_TRUNK_LEVER = 0.2
"""Metres by which the centre of mass moves with a trunk that leans by a right angle."""
_TILT = 0.3
"""Share of a raise sideways that the pelvis makes at most."""
_LOWERED = 0.05
_TOUCH, _LEAVING = 0.01, 0.05
"""Metres, and metres per second, by which a foot moves otherwise than recorded before its label
of contact is dropped."""
_HANDS = (20, 21)
_SIDES = ((1, 4, 7, 10), (2, 5, 8, 11))
"""Hip, knee, ankle and toes, left and right."""


def may_raise(moments: Moments) -> Bool[Tensor, " windows"]:
    """Windows in which a foot stands all the time, and neither hands nor knees carry weight."""
    stands = _stands(moments, 0) | _stands(moments, 1)
    return stands & ~moments.ever(0, *_HANDS, 4, 5)


def raised(moments: Moments, random: torch.Generator) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows in which one leg is raised, and which of them a body could move so.

    The other foot stands on the ground all the time, and stays exactly where it is. The pelvis
    goes the other way by as much as keeps the centre of mass in its place.
    """
    chance = Chance(random, moments.translation)
    either = chance.between(0.0, 1.0) < 0.5
    right = torch.where(_stands(moments, 0), either | ~_stands(moments, 1), False)
    orientations, joints = posed = moments.posed()
    ahead = forward_of(orientations[:, :, 0])
    left = torch.stack((-ahead[..., 1], ahead[..., 0], torch.zeros_like(ahead[..., 0])), -1)
    side = torch.where(right, -1.0, 1.0)[:, None]

    wave = chance.wave(moments.seconds, *_PERIODS)
    direction = chance.between(*_DIRECTIONS)[:, None]
    behind = ((direction - 0.5 * math.pi) / (_DIRECTIONS[1] - 0.5 * math.pi)).clamp(min=0)
    height = chance.between(0.1 * _HIGHEST, _HIGHEST)[:, None] * wave
    height = height * (1 - (1 - _BACK) * behind)
    straight = chance.between(0.0, 1.0) < 0.5
    knee = torch.where(straight, 0.0, chance.between(0.0, _KNEE))[:, None] * wave
    pointed = chance.between(0.0, _POINTED)[:, None] * wave
    tilt = chance.between(0.0, _TILT)[:, None] * height * direction.sin() * side

    flat = torch.zeros_like(height)
    swing = torch.stack((-direction.cos() * height, flat, side * direction.sin() * height), -1)
    turns = (swing, torch.stack((knee, flat, flat), -1), torch.stack((pointed, flat, flat), -1))
    free = moments.rotations.clone()
    for joints_of, of_it in zip(_SIDES, (~right, right), strict=True):
        hip, bend, ankle = (so3.exp(turn[of_it]) for turn in turns)
        own = free[of_it]
        own[:, :, joints_of[0]] = hip @ own[:, :, joints_of[0]]
        own[:, :, joints_of[1]] = own[:, :, joints_of[1]] @ bend
        own[:, :, joints_of[2]] = own[:, :, joints_of[2]] @ ankle
        free[of_it] = own

    root = so3.exp(tilt[..., None] * ahead) @ orientations[:, :, 0]
    knees = moments.derived(rotations=free).posed()[1] - joints
    moved = torch.where(right[:, None, None], knees[:, :, 5], knees[:, :, 4])
    level = moved.new_tensor([1.0, 1.0, 0.0])
    path = -_LEG_SHARE * moved * level + (_TRUNK_LEVER * tilt.sin())[..., None] * left
    path[..., 2] = -chance.between(0.0, _LOWERED)[:, None] * (1 - height.cos())
    aim = Aim(root, joints[:, :, 0] + path, joints[:, :, list(ANKLES)], flat[:, 0] + 0.02)
    rotations, reached = brought(moments.rotations, posed, moments.rest, aim)
    for joints_of, of_it in zip(_SIDES, (~right, right), strict=True):
        for joint in joints_of:
            rotations[of_it, :, joint] = free[of_it, :, joint]

    made = moments.derived(rotations=rotations, translation=moments.translation + path)
    feet = made.posed()[1] - joints
    lifted = [torch.stack([feet[:, :, j] for j in pair], 2) for pair in ((7, 10), (8, 11))]
    own_feet = torch.where(right[:, None, None, None], lifted[1], lifted[0])
    above = (own_feet[..., 2] > -_TOUCH).flatten(1).all(1)
    reached = torch.where(right, reached[:, 0], reached[:, 1])
    made = made.derived(contacts=moments.contacts & ~_moved(moments, feet, right))
    return made, reached & above & possible(moments, made)


def _stands(moments: Moments, side: int) -> Bool[Tensor, " windows"]:
    ankle, toe = (moments.contacts[..., CHANNELS[j]] for j in _SIDES[side][2:])
    return (ankle | toe).all(1)


def _moved(moments: Moments, change: Tensor, right: Tensor) -> Bool[Tensor, "windows frames 9"]:
    """Labels of the raised leg that end, for it has left its place, or is leaving it."""
    gone = at_frames(change).norm(dim=-1) > _TOUCH
    gone = gone | (speeds(moments.seconds, change) > _LEAVING)
    found = torch.zeros(*gone.shape[:2], len(CHANNELS), dtype=torch.bool, device=gone.device)
    for joints_of, of_it in zip(_SIDES, (~right, right), strict=True):
        for joint in joints_of[1:]:
            found[..., CHANNELS[joint]] = gone[..., joint] & of_it[:, None]
    return found
