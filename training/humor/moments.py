"""Windows of translations and joint rotations, before joints and velocities are computed.

Edits change these rotations and translations at every moment alike, those beside the frames
included, from whose differences velocities are taken; so velocities always belong to positions.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import forward_kinematics
from recon.core.skeleton import CONTACT_JOINTS, FEET, JOINTS
from recon.core.struct import TensorStruct

PER_FRAME = 3
"""Moments of every frame: one just before it, itself, and one just after."""

CHANNELS = {joint: channel for channel, joint in enumerate(CONTACT_JOINTS)}
"""Channel of the contact labels by joint."""


@dataclass(frozen=True)
class Moments(TensorStruct):
    """Windows of motion (world, z up, metres), with a moment before and after each frame."""

    translation: Float[Tensor, "windows times 3"]
    rotations: Float[Tensor, "windows times 22 3 3"]
    contacts: Bool[Tensor, "windows frames 9"]
    """Whether a joint of `CONTACT_JOINTS` carries weight."""
    seconds: Float[Tensor, "windows times"]
    """Time of every moment as the window is played, zero at its first frame."""
    rest: Float[Tensor, "windows 22 3"]
    """Joints of the unposed bodies."""

    def posed(
        self,
    ) -> tuple[Float[Tensor, "windows times 22 3 3"], Float[Tensor, "windows times 22 3"]]:
        """World orientations and positions of all joints."""
        orientations, joints = forward_kinematics(self.rotations, self.rest)
        return orientations, joints + self.translation[:, :, None]

    def always_in_contact(self, *joints: int) -> Bool[Tensor, " windows"]:
        """Mask of windows in which all the given joints are in contact in every frame."""
        return self.contacts[..., [CHANNELS[j] for j in joints]].flatten(1).all(1)

    def ever_in_contact(self, *joints: int) -> Bool[Tensor, " windows"]:
        """Mask of windows in which at least one of the given joints is in contact at some time."""
        return self.contacts[..., [CHANNELS[j] for j in joints]].flatten(1).any(1)


def with_edited(
    moments: Moments,
    rows: Int[Tensor, " some"],
    edited: Moments,
    accepted: Bool[Tensor, " some"],
) -> Moments:
    """Replace the windows `rows` by their edited versions, where the edit was accepted."""
    kept = rows[accepted]

    def with_new_rows(old: Tensor, new: Tensor) -> Tensor:
        return old.index_put((kept,), new[accepted])

    return moments.derived(
        translation=with_new_rows(moments.translation, edited.translation),
        rotations=with_new_rows(moments.rotations, edited.rotations),
        contacts=with_new_rows(moments.contacts, edited.contacts),
    )


def at_frames(values: Float[Tensor, "windows times *rest"]) -> Tensor:
    """Select the values at the frames, without the moments before and after each frame."""
    return values[:, 1::PER_FRAME]


def speeds(
    seconds: Float[Tensor, "windows times"], places: Float[Tensor, "windows times joints 3"]
) -> Float[Tensor, "windows frames joints"]:
    """Speeds at the frames, m/s, from the neighbouring moments."""
    span = (seconds[:, 2::PER_FRAME] - seconds[:, ::PER_FRAME])[..., None, None]
    return ((places[:, 2::PER_FRAME] - places[:, ::PER_FRAME]) / span).norm(dim=-1)


def forward_directions(roots: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3"]:
    """Horizontal unit vectors in which bodies face: from their left side, turned by 90 degrees."""
    left = roots[..., 0]
    ahead = torch.stack((left[..., 1], -left[..., 0], torch.zeros_like(left[..., 0])), -1)
    return ahead / ahead.norm(dim=-1, keepdim=True).clamp(min=1e-6)


NAMES = ("hip flexion", "hip abduction", "knee flexion", "ankle dorsiflexion", "elbow flexion")
"""Angles of `joint_angles`, for the left and the right side each."""

LOWEST = tuple(math.radians(a) for a in (-35, -40, -8, -65, -10))
HIGHEST = tuple(math.radians(a) for a in (135, 85, 150, 45, 150))
"""Radians. Dancers raise a straight leg sideways to about 85 degrees."""

_SLACK = math.radians(1)
_CLEARANCE = 0.10
"""Metres that joints other than feet stay above the ground; their flesh is that thick."""
_SOLE = 0.02


def joint_angles(
    rotations: Float[Tensor, "windows times 22 3 3"], rest: Float[Tensor, "windows 22 3"]
) -> Float[Tensor, "windows times 2 5"]:
    """Angles named in `NAMES`, left and right, radians; zero with legs and arms straight at rest.

    The rest pose has y up, z forward and x to the left; bones of the right side are mirrored.
    """
    thigh = bone_directions(rotations, rest, (1, 2), (4, 5))
    shank = bone_directions(rotations, rest, (4, 5), (7, 8))
    foot = bone_directions(rotations, rest, (7, 8), (10, 11))
    forearm = bone_directions(rotations, rest, (18, 19), (20, 21))
    toe = rest[:, None, [10, 11]] - rest[:, None, [7, 8]]
    down = thigh[..., 1:].norm(dim=-1) > 0.4
    flexion = torch.where(down, torch.atan2(thigh[..., 2], -thigh[..., 1]), 0.0)
    return torch.stack(
        (
            flexion,
            thigh[..., 0].clamp(-1, 1).asin(),
            torch.atan2(-shank[..., 2], -shank[..., 1]),
            torch.atan2(foot[..., 1], foot[..., 2]) - torch.atan2(toe[..., 1], toe[..., 2]),
            torch.atan2(forearm[..., 2], forearm[..., 0]),
        ),
        -1,
    )


def bone_directions(
    rotations: Float[Tensor, "windows times 22 3 3"],
    rest: Float[Tensor, "windows 22 3"],
    joints: tuple[int, int],
    children: tuple[int, int],
) -> Float[Tensor, "windows times 2 3"]:
    """Directions of bones, left and right, in the frames of their joints' parents.

    The right ones are mirrored, as if all were of the left side.
    """
    local = rotations[:, :, list(joints)]
    bone = rest[:, list(children)] - rest[:, list(joints)]
    bone = bone / bone.norm(dim=-1, keepdim=True)
    turned = (local @ bone[:, None, ..., None])[..., 0]
    return turned * turned.new_tensor([[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])


def is_plausible(old: Moments, new: Moments) -> Bool[Tensor, " windows"]:
    """Mask of edited windows whose joint angles are in range and joints above the ground."""
    before, after = (joint_angles(at_frames(m.rotations), m.rest) for m in (old, new))
    low, high = after.new_tensor(LOWEST), after.new_tensor(HIGHEST)
    inside = (after > torch.minimum(low, before) - _SLACK) & (
        after < torch.maximum(high, before) + _SLACK
    )
    return inside.flatten(1).all(1) & stays_above_ground(old, new)


def stays_above_ground(old: Moments, new: Moments) -> Bool[Tensor, " windows"]:
    """Mask of windows whose joints keep their least height above z = 0, or the recorded one."""
    before, after = (_joints_at_frames(m)[..., 2] for m in (old, new))
    least = [_SOLE if j in FEET else _CLEARANCE for j in range(len(JOINTS))]
    allowed = torch.minimum(after.new_tensor(least), before.amin(1) - 1e-3)
    return (after > allowed[:, None]).flatten(1).all(1)


def _joints_at_frames(moments: Moments) -> Float[Tensor, "windows frames 22 3"]:
    placed = forward_kinematics(at_frames(moments.rotations), moments.rest)[1]
    return placed + at_frames(moments.translation)[:, :, None]


@dataclass(frozen=True)
class RandomDraws:
    """Draws random numbers for each window of a batch, on the windows' device."""

    random: torch.Generator
    like: Tensor
    """A tensor of the kind and device wanted; its first axis counts the windows."""

    def uniform(self, low: float, high: float) -> Float[Tensor, " windows"]:
        """Draw a uniform random number from `low` to `high` for every window."""
        drawn = torch.rand(len(self.like), generator=self.random).to(self.like)
        return low + (high - low) * drawn

    def log_uniform(self, low: float, high: float) -> Float[Tensor, " windows"]:
        """Draw a log-uniform random number from `low` to `high` for every window."""
        drawn = torch.rand(len(self.like), generator=self.random).to(self.like)
        return low * (high / low) ** drawn

    def sign(self) -> Float[Tensor, " windows"]:
        """Draw 1 or -1 with equal probability for every window."""
        drawn = torch.rand(len(self.like), generator=self.random).to(self.like)
        return torch.where(drawn < 0.5, -1.0, 1.0)

    def waves(
        self, seconds: Float[Tensor, "windows times"], shortest: float, longest: float
    ) -> Float[Tensor, "windows times"]:
        """Raised cosines between zero and one, of random period (seconds) and phase."""
        period, phase = self.log_uniform(shortest, longest), self.uniform(0.0, 2 * torch.pi)
        angle = 2 * torch.pi * seconds / period[:, None] + phase[:, None]
        return 0.5 - 0.5 * angle.cos()


def minimum_jerk(
    seconds: Float[Tensor, "windows times"],
    start: Float[Tensor, " windows"],
    lasts: Float[Tensor, " windows"],
) -> Float[Tensor, "windows times"]:
    """A minimum-jerk movement from zero to one: 10 x³ - 15 x⁴ + 6 x⁵, at rest at both ends."""
    x = ((seconds - start[:, None]) / lasts[:, None]).clamp(0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)
