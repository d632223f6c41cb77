"""Closed-form inverse kinematics of legs: the knee is on a circle about the line hip-ankle."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.skeleton import FEET
from recon.core.struct import TensorStruct
from training.humor.moments import (
    CHANNELS,
    Moments,
    RandomDraws,
    at_frames,
    forward_directions,
    is_plausible,
    minimum_jerk,
    speeds,
)

HIPS, KNEES, ANKLES = (1, 2), (4, 5), (7, 8)
"""Joints of the left and the right leg."""

_STRAIGHT = 0.998
"""Longest distance from hip to ankle, of the leg's length; further only where it was recorded."""

_FOLDED = 0.35
"""Shortest distance, of the leg's length."""


@dataclass(frozen=True)
class LegTargets(TensorStruct):
    """Target positions of pelvis and ankles; feet keep their orientations in the world."""

    root: Float[Tensor, "windows times 3 3"]
    pelvis: Float[Tensor, "windows times 3"]
    ankles: Float[Tensor, "windows times 2 3"]
    forward: Float[Tensor, " windows"]
    """Metres that count for the direction of the kneecap beside the knee's own distance from the
    line between hip and ankle. Zero gives recorded knees back exactly; straight knees need more to
    know where to bend."""


def legs_reaching(
    rotations: Float[Tensor, "windows times 22 3 3"],
    posed: tuple[Float[Tensor, "windows times 22 3 3"], Float[Tensor, "windows times 22 3"]],
    rest: Float[Tensor, "windows 22 3"],
    aim: LegTargets,
) -> tuple[Float[Tensor, "windows times 22 3 3"], Bool[Tensor, "windows 2"]]:
    """Solve for joint rotations with which both legs reach target ankles from a target pelvis.

    Thigh and shank turn by the shortest way from where they pointed in the world, so that
    kneecaps keep facing where the feet do.

    Args:
        rotations: as recorded.
        posed: orientations and positions of the joints with these rotations.
        rest: joints of the unposed bodies.
        aim: where to.

    Returns:
        Rotations, and for the left and right leg of every window whether its ankle is reached in
        all moments.
    """
    orientations, joints = posed
    hip, knee, ankle = (joints[:, :, list(three)] for three in (HIPS, KNEES, ANKLES))
    offset = rest[:, list(HIPS)] - rest[:, :1]
    begin = aim.pelvis[:, :, None] + torch.einsum("wtij,wsj->wtsi", aim.root, offset)

    upper, lower = (knee - hip).norm(dim=-1), (ankle - knee).norm(dim=-1)
    line = aim.ankles - begin
    reach = line.norm(dim=-1)
    along = line / reach[..., None]
    x = (upper**2 - lower**2 + reach**2) / (2 * reach)
    radius = (upper**2 - x**2).clamp(min=0).sqrt()

    was = ankle - hip
    apart = _perpendicular_part(knee - hip, was / was.norm(dim=-1, keepdim=True))
    facing = orientations[:, :, list(HIPS), :, 2]
    pole = _perpendicular_part(apart + aim.forward[:, None, None, None] * facing, along)
    pole = pole / pole.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    bent = begin + x[..., None] * along + radius[..., None] * pole

    thigh = smallest_rotation(knee - hip, bent - begin) @ orientations[:, :, list(HIPS)]
    shank = smallest_rotation(ankle - knee, aim.ankles - bent) @ orientations[:, :, list(KNEES)]
    foot = orientations[:, :, list(ANKLES)]
    made = rotations.clone()
    made[:, :, 0] = aim.root
    made[:, :, list(HIPS)] = aim.root[:, :, None].mT @ thigh
    made[:, :, list(KNEES)] = thigh.mT @ shank
    made[:, :, list(ANKLES)] = shank.mT @ foot

    length = upper + lower
    far = (reach > _STRAIGHT * length) & (reach > was.norm(dim=-1) + 1e-4)
    return made, ~(far | (reach < _FOLDED * length)).any(1)


def smallest_rotation(
    start: Float[Tensor, "*shape 3"], end: Float[Tensor, "*shape 3"]
) -> Float[Tensor, "*shape 3 3"]:
    """The smallest rotation from one direction to another: I + K + K² / (1 + cos)."""
    a = start / start.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    b = end / end.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    skew = so3.hat(torch.linalg.cross(a, b))
    cosine = (a * b).sum(-1)[..., None, None].clamp(min=-0.99)
    return torch.eye(3).to(skew) + skew + skew @ skew / (1 + cosine)


def _perpendicular_part(vector: Tensor, unit: Tensor) -> Tensor:
    """The part of a vector that is perpendicular to a direction."""
    return vector - (vector * unit).sum(-1, keepdim=True) * unit


_DEPTH = (0.02, 0.45)
"""Metres by which the pelvis is lowered at most, of a logarithmically uniform choice."""
_BEND_PERIODS = (1.1, 3.0)
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


def may_move_pelvis(moments: Moments) -> Bool[Tensor, " windows"]:
    """Mask of windows in which neither hands nor knees nor the pelvis carry weight."""
    return ~moments.ever_in_contact(0, *KNEES, *_HANDS)


def with_pelvis_moved(
    moments: Moments, random: torch.Generator
) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Move the pelvis of windows at random; return them, and a mask of plausible results.

    Both feet stay exactly where they were, in contact or not, and so do their labels.
    """
    chance = RandomDraws(random, moments.translation)
    orientations, joints = posed = moments.posed()
    root, pelvis = orientations[:, :, 0], joints[:, :, 0]
    ahead = forward_directions(root)
    left = torch.stack((-ahead[..., 1], ahead[..., 0], torch.zeros_like(ahead[..., 0])), -1)
    up = ahead.new_tensor([0.0, 0.0, 1.0])

    depth = chance.log_uniform(*_DEPTH)
    lowered = 0.3 + 0.7 * chance.waves(moments.seconds, *_BEND_PERIODS)
    stoop = (chance.uniform(0.0, _STOOP / _DEPTH[1]) * depth)[:, None] * lowered
    turn = chance.uniform(-_TURN, _TURN)[:, None] * _varying_factor(chance, moments)
    roll = chance.uniform(-_ROLL, _ROLL)[:, None] * _varying_factor(chance, moments)
    aside = chance.uniform(-_SHIFT, _SHIFT)[:, None] * _varying_factor(chance, moments)
    on = chance.uniform(-_SHIFT, _SHIFT)[:, None] * _varying_factor(chance, moments)
    on = on - _LEVER * stoop.sin()

    angle = turn[..., None] * up + stoop[..., None] * left + roll[..., None] * ahead
    path = pelvis + on[..., None] * ahead + aside[..., None] * left
    path = path - (depth[:, None] * lowered)[..., None] * up
    aim = LegTargets(so3.exp(angle) @ root, path, joints[:, :, list(ANKLES)], depth)
    rotations, reached = legs_reaching(moments.rotations, posed, moments.rest, aim)
    made = moments.derived(rotations=rotations, translation=moments.translation + path - pelvis)
    return made, reached.all(1) & is_plausible(moments, made)


def _varying_factor(chance: RandomDraws, moments: Moments) -> Tensor:
    """Random factors between 0.5 and 1 that vary smoothly over the times of a window."""
    return 0.5 + 0.5 * chance.waves(moments.seconds, *_BEND_PERIODS)


_HIGHEST = math.radians(100)
_BACK = 0.35
"""Most that the thigh turns from where it was recorded, and the share of it that is left of a
raise backwards."""
_DIRECTIONS = (math.radians(-10), math.radians(150))
"""Directions of a raise, from forward over sideways to back, radians."""
_RAISE_PERIODS = (1.0, 3.0)
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
_SIDES = ((1, 4, 7, 10), (2, 5, 8, 11))
"""Hip, knee, ankle and toes, left and right."""


def may_raise_leg(moments: Moments) -> Bool[Tensor, " windows"]:
    """Mask of windows in which one foot always stands and neither hands nor knees carry weight."""
    stands = _foot_stands(moments, 0) | _foot_stands(moments, 1)
    return stands & ~moments.ever_in_contact(0, *_HANDS, 4, 5)


def with_leg_raised(
    moments: Moments, random: torch.Generator
) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Raise one leg in each window; return the windows, and a mask of plausible results.

    The other foot stands on the ground all the time, and stays exactly where it is. The pelvis
    goes the other way by as much as keeps the centre of mass in its place.
    """
    chance = RandomDraws(random, moments.translation)
    either = chance.uniform(0.0, 1.0) < 0.5
    right = torch.where(_foot_stands(moments, 0), either | ~_foot_stands(moments, 1), False)
    orientations, joints = posed = moments.posed()
    ahead = forward_directions(orientations[:, :, 0])
    left = torch.stack((-ahead[..., 1], ahead[..., 0], torch.zeros_like(ahead[..., 0])), -1)
    side = torch.where(right, -1.0, 1.0)[:, None]

    wave = chance.waves(moments.seconds, *_RAISE_PERIODS)
    direction = chance.uniform(*_DIRECTIONS)[:, None]
    behind = ((direction - 0.5 * math.pi) / (_DIRECTIONS[1] - 0.5 * math.pi)).clamp(min=0)
    height = chance.uniform(0.1 * _HIGHEST, _HIGHEST)[:, None] * wave
    height = height * (1 - (1 - _BACK) * behind)
    straight = chance.uniform(0.0, 1.0) < 0.5
    knee = torch.where(straight, 0.0, chance.uniform(0.0, _KNEE))[:, None] * wave
    pointed = chance.uniform(0.0, _POINTED)[:, None] * wave
    tilt = chance.uniform(0.0, _TILT)[:, None] * height * direction.sin() * side

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
    path[..., 2] = -chance.uniform(0.0, _LOWERED)[:, None] * (1 - height.cos())
    aim = LegTargets(root, joints[:, :, 0] + path, joints[:, :, list(ANKLES)], flat[:, 0] + 0.02)
    rotations, reached = legs_reaching(moments.rotations, posed, moments.rest, aim)
    for joints_of, of_it in zip(_SIDES, (~right, right), strict=True):
        for joint in joints_of:
            rotations[of_it, :, joint] = free[of_it, :, joint]

    made = moments.derived(rotations=rotations, translation=moments.translation + path)
    feet = made.posed()[1] - joints
    lifted = [torch.stack([feet[:, :, j] for j in pair], 2) for pair in ((7, 10), (8, 11))]
    own_feet = torch.where(right[:, None, None, None], lifted[1], lifted[0])
    above = (own_feet[..., 2] > -_TOUCH).flatten(1).all(1)
    reached = torch.where(right, reached[:, 0], reached[:, 1])
    made = made.derived(contacts=moments.contacts & ~_contacts_lost(moments, feet, right))
    return made, reached & above & is_plausible(moments, made)


def _foot_stands(moments: Moments, side: int) -> Bool[Tensor, " windows"]:
    ankle, toe = (moments.contacts[..., CHANNELS[j]] for j in _SIDES[side][2:])
    return (ankle | toe).all(1)


def _contacts_lost(
    moments: Moments, change: Tensor, right: Tensor
) -> Bool[Tensor, "windows frames 9"]:
    """Mask of contact labels that are removed because the leg is raised."""
    gone = at_frames(change).norm(dim=-1) > _TOUCH
    gone = gone | (speeds(moments.seconds, change) > _LEAVING)
    found = torch.zeros(*gone.shape[:2], len(CHANNELS), dtype=torch.bool, device=gone.device)
    for joints, is_raised in zip(_SIDES, (~right, right), strict=True):
        for joint in joints[1:]:
            found[..., CHANNELS[joint]] = gone[..., joint] & is_raised[:, None]
    return found


_LENGTH = (0.06, 0.45)
_LASTS = (0.3, 0.7)
"""Seconds that the foot is in the air."""
_EARLIER = 0.15
"""Seconds by which the pelvis begins earlier than the foot, and ends later."""
_HEIGHT = (0.03, 0.15)
_STEP_LOWERED = (0.02, 0.08)
"""Metres."""
_SPREAD = math.radians(70)
"""Most that a step leads away from sideways."""
_APART = 0.07
"""Metres sideways that feet keep from each other; they do not cross."""


def may_step_aside(moments: Moments) -> Bool[Tensor, " windows"]:
    """Mask of windows in which both feet always stand on the ground, and nothing else does."""
    return moments.always_in_contact(*FEET) & ~moments.ever_in_contact(0, 4, 5, *_HANDS)


def with_step_added(
    moments: Moments, random: torch.Generator
) -> tuple[Moments, Bool[Tensor, " windows"]]:
    """Add a part of a step to windows; return them, and a mask of plausible results.

    The foot that steps loses its contacts while it is in the air, the other one stays exactly
    where it is, and the pelvis goes half of the way.
    """
    chance = RandomDraws(random, moments.translation)
    right = chance.uniform(0.0, 1.0) < 0.5
    orientations, joints = posed = moments.posed()
    root, pelvis = orientations[:, :, 0], joints[:, :, 0]
    ahead = forward_directions(root[:, :1])
    left = torch.stack((-ahead[..., 1], ahead[..., 0], torch.zeros_like(ahead[..., 0])), -1)

    lasts = chance.uniform(*_LASTS)
    room = moments.seconds[:, -1]
    start = chance.uniform(0.0, 1.0) * (room + lasts) - lasts
    way = minimum_jerk(moments.seconds, start, lasts)
    follows = minimum_jerk(moments.seconds, start - _EARLIER, lasts + 2 * _EARLIER)
    angle = chance.uniform(-_SPREAD, _SPREAD)[:, None, None]
    size = (chance.log_uniform(*_LENGTH) * chance.sign())[:, None, None]
    whole = size * (angle.cos() * left + angle.sin() * ahead)

    foot = way[..., None] * whole
    lift = chance.uniform(*_HEIGHT)[:, None] * 4 * way * (1 - way)
    foot = torch.stack((*foot[..., :2].unbind(-1), lift), -1)
    moving = torch.stack((~right, right), -1)[:, None, :, None]
    ankles = joints[:, :, list(ANKLES)] + torch.where(moving, foot[:, :, None], 0.0)
    path = 0.5 * follows[..., None] * whole
    low = chance.uniform(*_STEP_LOWERED)
    path = torch.stack((*path[..., :2].unbind(-1), -low[:, None].expand_as(way)), -1)

    aim = LegTargets(root, pelvis + path, ankles, low)
    rotations, reached = legs_reaching(moments.rotations, posed, moments.rest, aim)
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
    return made, apart.all(1) & reached.all(1) & is_plausible(moments, made)
