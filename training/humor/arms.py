"""Arms moved otherwise than recorded: shoulders turned, elbows bent, each arm by itself."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core import rotations as so3
from training.humor.moments import Chance, Moments, above_ground, bones, possible

_SHOULDER = math.radians(70)
_ELBOW = math.radians(80)
_PERIODS = (0.8, 3.0)
_BEHIND, _ACROSS = -0.75, -0.6
"""How far the upper arm's direction may point back and to the other side, of its length."""
_TRUNK = 0.14
"""Metres that elbows and wrists keep from the line between pelvis and neck."""
_HANDS = (20, 21)


def may_move(moments: Moments) -> Bool[Tensor, " windows"]:
    """Windows in which hands are free."""
    return ~moments.ever(*_HANDS)


def moved(moments: Moments, random: torch.Generator) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows with other arms, and which of them a body could move so."""
    chance = Chance(random, moments.translation)
    rotations = moments.rotations.clone()
    for shoulder, elbow, side in ((16, 18, 1.0), (17, 19, -1.0)):
        axis = torch.randn(len(rotations), 3, generator=random).to(rotations)
        axis = axis / axis.norm(dim=-1, keepdim=True)
        wave = 2 * chance.wave(moments.seconds, *_PERIODS) - chance.between(0.0, 1.0)[:, None]
        angle = chance.between(0.0, 0.5 * _SHOULDER)[:, None] * wave
        turn = so3.exp(angle[..., None] * axis[:, None])
        bend = chance.between(-_ELBOW, _ELBOW)[:, None]
        bend = bend * (0.5 + 0.5 * chance.wave(moments.seconds, *_PERIODS))
        flat = torch.zeros_like(bend)
        rotations[:, :, shoulder] = turn @ rotations[:, :, shoulder]
        hinge = so3.exp(torch.stack((flat, -side * bend, flat), -1))
        rotations[:, :, elbow] = rotations[:, :, elbow] @ hinge
    made = moments.derived(rotations=rotations)
    upper = bones(rotations, moments.rest, (16, 17), (18, 19))
    inside = (upper[..., 2] > _BEHIND) & (upper[..., 0] > _ACROSS)
    return made, inside.flatten(1).all(1) & clear_of_trunk(moments, made) & possible(moments, made)


def clear_of_trunk(old: Moments, new: Moments) -> Bool[Tensor, " windows"]:
    """Whether no elbow or wrist is nearer to the trunk than flesh allows, or than it ever was."""
    before, after = (_from_trunk(m.posed()[1]) for m in (old, new))
    allowed = before.amin(1, keepdim=True).clamp(max=_TRUNK) - 1e-3
    return (after > allowed).flatten(1).all(1)


def _from_trunk(joints: Float[Tensor, "windows times 22 3"]) -> Float[Tensor, "windows times 4"]:
    """Distances of elbows and wrists from the line between pelvis and neck, metres."""
    start, line = joints[:, :, :1], joints[:, :, 12:13] - joints[:, :, :1]
    limbs = joints[:, :, 18:22] - start
    along = ((limbs * line).sum(-1) / line.square().sum(-1)).clamp(0, 1)
    return (limbs - along[..., None] * line).norm(dim=-1)


TRUNK = (3, 6, 9)
"""Joints of the spine, from the lowest."""
UPPER = (*TRUNK, *range(12, 22))
"""Joints of the upper half."""
_FARTHEST = math.radians(50)
"""Most by which the two pelvises differ in tilt; the spine takes up the difference."""


def joined(legs: Moments, trunks: Moments) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Windows with the lower half of the first and the upper half of the second.

    The trunk is tilted in the world as it was recorded, and turned as the legs are: relative to
    the heading of its pelvis, its orientation is that of its own recording. What the two pelvises
    differ by is shared by the three joints of the spine.

    Refused are windows in which a hand carries weight in either, where pelvises differ too much,
    or where arms would reach into the ground.
    """
    differ = so3.log(_level(legs).mT @ _level(trunks))
    third = so3.exp(differ / 3)
    rotations = legs.rotations.clone()
    rotations[:, :, list(UPPER)] = trunks.rotations[:, :, list(UPPER)]
    # third · third · third · s1 · s2 · s3, with each third moved to its own joint
    below = torch.eye(3).to(third)
    for joint in TRUNK:
        own = trunks.rotations[:, :, joint]
        rotations[:, :, joint] = below.mT @ third @ below @ own
        below = below @ own
    made = legs.derived(rotations=rotations)
    near = (differ.norm(dim=-1) < _FARTHEST).all(1)
    hands = legs.ever(*_HANDS) | trunks.ever(*_HANDS)
    return made, near & ~hands & above_ground(legs, made)


def _level(moments: Moments) -> Float[Tensor, "windows times 3 3"]:
    """Orientations of the pelvis less its heading."""
    root = moments.rotations[:, :, 0]
    return so3.heading(root) @ root
