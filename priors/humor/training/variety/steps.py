"""Steps in any direction, most of them sideways, made by a body that stands on both feet."""

import math

import torch
from jaxtyping import Bool
from torch import Tensor

from priors.humor.training.variety.legs import ANKLES, Aim, brought
from priors.humor.training.variety.limits import possible
from priors.humor.training.variety.moments import CHANNELS, Moments, at_frames, forward_of
from priors.humor.training.variety.waves import Chance, step
from recon.core.skeleton import FEET

_LENGTH = (0.06, 0.45)
_LASTS = (0.3, 0.7)
"""Seconds that the foot is in the air."""
_EARLIER = 0.15
"""Seconds by which the pelvis begins earlier than the foot, and ends later."""
_HEIGHT = (0.03, 0.15)
_LOWERED = (0.02, 0.08)
"""Metres."""
_SPREAD = math.radians(70)
"""Most that a step leads away from sideways."""
_APART = 0.07
"""Metres sideways that feet keep from each other; they do not cross."""
_HANDS = (20, 21)


def may_step(moments: Moments) -> Bool[Tensor, " windows"]:
    """Windows in which both feet stand on the ground all the time, and nothing else does."""
    return moments.always(*FEET) & ~moments.ever(0, 4, 5, *_HANDS)


def stepped(moments: Moments, random: torch.Generator) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows with a part of a step, and which of them a body could move so.

    The foot that steps loses its contacts while it is in the air, the other one stays exactly
    where it is, and the pelvis goes half of the way.
    """
    chance = Chance(random, moments.translation)
    right = chance.between(0.0, 1.0) < 0.5
    orientations, joints = posed = moments.posed()
    root, pelvis = orientations[:, :, 0], joints[:, :, 0]
    ahead = forward_of(root[:, :1])
    left = torch.stack((-ahead[..., 1], ahead[..., 0], torch.zeros_like(ahead[..., 0])), -1)

    lasts = chance.between(*_LASTS)
    room = moments.seconds[:, -1]
    start = chance.between(0.0, 1.0) * (room + lasts) - lasts
    way = step(moments.seconds, start, lasts)
    follows = step(moments.seconds, start - _EARLIER, lasts + 2 * _EARLIER)
    angle = chance.between(-_SPREAD, _SPREAD)[:, None, None]
    size = (chance.slow(*_LENGTH) * chance.sign())[:, None, None]
    whole = size * (angle.cos() * left + angle.sin() * ahead)

    foot = way[..., None] * whole
    lift = chance.between(*_HEIGHT)[:, None] * 4 * way * (1 - way)
    foot = torch.stack((*foot[..., :2].unbind(-1), lift), -1)
    moving = torch.stack((~right, right), -1)[:, None, :, None]
    ankles = joints[:, :, list(ANKLES)] + torch.where(moving, foot[:, :, None], 0.0)
    path = 0.5 * follows[..., None] * whole
    low = chance.between(*_LOWERED)
    path = torch.stack((*path[..., :2].unbind(-1), -low[:, None].expand_as(way)), -1)

    aim = Aim(root, pelvis + path, ankles, low)
    rotations, reached = brought(moments.rotations, posed, moments.rest, aim)
    place = at_frames(way)
    air = (place > 0) & (place < 1)
    contacts = moments.contacts.clone()
    for joint in FEET:
        own = right if joint in (8, 11) else ~right
        contacts[..., CHANNELS[joint]] &= ~(air & own[:, None])
    made = moments.derived(
        rotations=rotations, translation=moments.translation + path, contacts=contacts
    )
    apart = ((ankles[:, :, 0] - ankles[:, :, 1]) * left).sum(-1) > _APART
    return made, apart.all(1) & reached.all(1) & possible(moments, made)
