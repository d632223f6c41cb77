"""Augmentation of windows: settings, edits of arms, jumps, and their order."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.parts import GRAVITY
from recon.core import rotations as so3
from training.humor.legs import (
    may_move_pelvis,
    may_raise_leg,
    may_step_aside,
    with_leg_raised,
    with_pelvis_moved,
    with_step_added,
)
from training.humor.moments import (
    Moments,
    RandomDraws,
    bone_directions,
    is_plausible,
    stays_above_ground,
    with_edited,
)


@dataclass(frozen=True)
class Variation:
    """Settings of the augmentation of windows; zeros leave them as recorded."""

    mirror: float = 0.5
    """Chance of being mirrored."""
    reverse: float = 0.2
    """Chance of being played backwards: few people were recorded walking so."""
    speed: float = 0.15
    """Played up to this fraction faster or slower."""
    shape: float = 0.5
    """Standard deviation by which each shape coefficient is moved."""
    halves: float = 0.0
    """Chance of getting the trunk and arms of another clip."""
    raises: float = 0.0
    """Chance of a raised leg, where the other foot stands. A window in which a body could not move
    so stays as it was; and raises, sidesteps, bends and flights are tried in this order until one
    is made."""
    sidesteps: float = 0.0
    """Chance of a step aside, where both feet stand."""
    bends: float = 0.0
    """Chance of a pelvis that is lowered, turned and tilted over feet that stay where they are."""
    flights: float = 0.0
    """Chance of being in the air along a parabola."""
    arms: float = 0.0
    """Chance of arms that move otherwise."""
    kinds: float = 0.0
    """How far kinds of motion are balanced: 0 draws a kind as often as its clips say, 1 draws all
    kinds equally often."""
    people: float = 0.0
    """How far people are balanced, likewise."""


VARIED = Variation(
    speed=0.2,
    shape=1.0,
    halves=0.3,
    raises=0.6,
    sidesteps=0.4,
    bends=0.2,
    flights=0.05,
    arms=0.2,
    kinds=0.5,
    people=0.3,
)
"""The default variation of a training. Most windows differ from what was recorded, because the
corpus shows few people and few motions."""


_SHOULDER = math.radians(70)
_ELBOW = math.radians(80)
_ARM_PERIODS = (0.8, 3.0)
_BEHIND, _ACROSS = -0.75, -0.6
"""How far the upper arm's direction may point back and to the other side, of its length."""
_TRUNK = 0.14
"""Metres that elbows and wrists keep from the line between pelvis and neck."""
_HANDS = (20, 21)


def may_move_arms(moments: Moments) -> Bool[Tensor, " windows"]:
    """Mask of the windows in which no hand is in contact, so arms may be replaced."""
    return ~moments.ever_in_contact(*_HANDS)


def with_arms_moved(
    moments: Moments, random: torch.Generator
) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Change the arms of windows at random; return them, and a mask of plausible results."""
    chance = RandomDraws(random, moments.translation)
    rotations = moments.rotations.clone()
    for shoulder, elbow, side in ((16, 18, 1.0), (17, 19, -1.0)):
        axis = torch.randn(len(rotations), 3, generator=random).to(rotations)
        axis = axis / axis.norm(dim=-1, keepdim=True)
        wave = 2 * chance.waves(moments.seconds, *_ARM_PERIODS) - chance.uniform(0.0, 1.0)[:, None]
        angle = chance.uniform(0.0, 0.5 * _SHOULDER)[:, None] * wave
        turn = so3.exp(angle[..., None] * axis[:, None])
        bend = chance.uniform(-_ELBOW, _ELBOW)[:, None]
        bend = bend * (0.5 + 0.5 * chance.waves(moments.seconds, *_ARM_PERIODS))
        flat = torch.zeros_like(bend)
        rotations[:, :, shoulder] = turn @ rotations[:, :, shoulder]
        hinge = so3.exp(torch.stack((flat, -side * bend, flat), -1))
        rotations[:, :, elbow] = rotations[:, :, elbow] @ hinge
    made = moments.derived(rotations=rotations)
    upper = bone_directions(rotations, moments.rest, (16, 17), (18, 19))
    inside = (upper[..., 2] > _BEHIND) & (upper[..., 0] > _ACROSS)
    return made, inside.flatten(1).all(1) & arms_clear_of_trunk(moments, made) & is_plausible(
        moments, made
    )


def arms_clear_of_trunk(old: Moments, new: Moments) -> Bool[Tensor, " windows"]:
    """Mask of windows whose elbows and wrists stay out of the trunk, or as near as recorded."""
    before, after = (_distances_from_trunk(m.posed()[1]) for m in (old, new))
    allowed = before.amin(1, keepdim=True).clamp(max=_TRUNK) - 1e-3
    return (after > allowed).flatten(1).all(1)


def _distances_from_trunk(
    joints: Float[Tensor, "windows times 22 3"],
) -> Float[Tensor, "windows times 4"]:
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


def with_upper_body_of(legs: Moments, trunks: Moments) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Combine the lower body of windows `legs` with the upper body of windows `trunks`.

    The trunk is tilted in the world as it was recorded, and turned as the legs are: relative to
    the heading of its pelvis, its orientation is that of its own recording. What the two pelvises
    differ by is shared by the three joints of the spine.

    Refused are windows in which a hand carries weight in either, where pelvises differ too much,
    or where arms would reach into the ground.
    """
    differ = so3.log(_pelvis_tilt(legs).mT @ _pelvis_tilt(trunks))
    third = so3.exp(differ / 3)
    rotations = legs.rotations.clone()
    rotations[:, :, list(UPPER)] = trunks.rotations[:, :, list(UPPER)]
    # each trunk joint turns by a third of the difference, which is given in the pelvis's axes;
    # `below` rotates the axes of the next joint's parent to those of the pelvis
    below = torch.eye(3).to(third)
    for joint in TRUNK:
        own = trunks.rotations[:, :, joint]
        rotations[:, :, joint] = below.mT @ third @ below @ own
        below = below @ own
    made = legs.derived(rotations=rotations)
    near = (differ.norm(dim=-1) < _FARTHEST).all(1)
    hands = legs.ever_in_contact(*_HANDS) | trunks.ever_in_contact(*_HANDS)
    return made, near & ~hands & stays_above_ground(legs, made)


def _pelvis_tilt(moments: Moments) -> Float[Tensor, "windows times 3 3"]:
    """Orientation of the pelvis at every time, with its heading rotated away."""
    root = moments.rotations[:, :, 0]
    return so3.undo_heading(root) @ root


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
_CARRIERS = (0, 4, 5, 20, 21)


def may_jump(moments: Moments) -> Bool[Tensor, " windows"]:
    """Mask of windows that may become jumps: only feet carry weight, vertical speed is steady."""
    rising = moments.translation[..., 2].diff(dim=1) / moments.seconds.diff(dim=1)
    steady = rising.amax(1) - rising.amin(1) < _STEADY
    return steady & ~moments.ever_in_contact(*_CARRIERS)


def with_flight(
    moments: Moments, random: torch.Generator
) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Turn windows into jumps without contacts; return them, and a mask of plausible results."""
    chance = RandomDraws(random, moments.translation)
    seconds = moments.seconds
    last = seconds[:, -1].clamp(min=0.1)
    apex = (0.1 + 0.8 * chance.uniform(0.0, 1.0)) * last
    fall = 0.5 * GRAVITY * (seconds - apex[:, None]).square()
    height = chance.uniform(*_CLEAR)[:, None] + fall.amax(1, keepdim=True) - fall
    angle, speed = chance.uniform(0.0, 2 * math.pi), chance.uniform(0.0, _DRIFT)
    level = (speed[:, None] * torch.stack((angle.cos(), angle.sin()), -1))[:, None]
    path = torch.cat((seconds[..., None] * level, height[..., None]), -1)

    tucked, pointed = chance.uniform(0.0, _TUCKED), chance.uniform(0.0, _POINTED)
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
    return made, is_plausible(moments, made)


def with_random_edits(moments: Moments, variation: Variation, random: torch.Generator) -> Moments:
    """Edit legs and arms of windows at random; implausible edits are dropped."""
    legs = (
        (may_raise_leg, with_leg_raised, variation.raises),
        (may_step_aside, with_step_added, variation.sidesteps),
        (may_move_pelvis, with_pelvis_moved, variation.bends),
        (may_jump, with_flight, variation.flights),
    )
    for group in (legs, ((may_move_arms, with_arms_moved, variation.arms),)):
        free = torch.ones_like(moments.rest[:, 0, 0], dtype=torch.bool)
        for may, edit, chance in group:
            if chance == 0:
                continue
            drawn = torch.rand(len(free), generator=random).to(moments.rest)
            rows = chosen_rows((drawn < chance) & free & may(moments))
            if len(rows) > 0:
                made, accepted = edit(moments[rows], random)
                moments = with_edited(moments, rows, made, accepted)
                free = free.index_put((rows,), ~accepted)
    return moments


def chosen_rows(chosen: Bool[Tensor, " windows"]) -> Int[Tensor, " some"]:
    """Return the indices of the windows whose mask is true."""
    return chosen.nonzero()[:, 0]
