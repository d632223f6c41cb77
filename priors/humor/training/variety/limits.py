"""What bodies can do: ranges of joints, and no limb below the ground.

Whatever was recorded is allowed: an edit is refused where it leaves a range further than the
recording itself did.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humor.training.variety.moments import Moments, at_frames
from recon.body.kinematics import forward_kinematics
from recon.core.skeleton import FEET, JOINTS

NAMES = ("hip flexion", "hip abduction", "knee flexion", "ankle dorsiflexion", "elbow flexion")
"""Angles of `angles`, for the left and the right side each."""

LOWEST = tuple(math.radians(a) for a in (-35, -40, -8, -65, -10))
HIGHEST = tuple(math.radians(a) for a in (135, 85, 150, 45, 150))
"""Radians. Dancers raise a straight leg sideways to about 85 degrees."""

_SLACK = math.radians(1)
_CLEARANCE = 0.10
"""Metres that joints other than feet stay above the ground; their flesh is that thick."""
_SOLE = 0.02


def angles(
    rotations: Float[Tensor, "windows times 22 3 3"], rest: Float[Tensor, "windows 22 3"]
) -> Float[Tensor, "windows times 2 5"]:
    """Angles named in `NAMES`, left and right, radians; zero with legs and arms straight at rest.

    The rest pose has y up, z forward and x to the left; bones of the right side are mirrored.
    """
    thigh = bones(rotations, rest, (1, 2), (4, 5))
    shank = bones(rotations, rest, (4, 5), (7, 8))
    foot = bones(rotations, rest, (7, 8), (10, 11))
    forearm = bones(rotations, rest, (18, 19), (20, 21))
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


def bones(
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


def possible(old: Moments, new: Moments) -> Bool[Tensor, " windows"]:
    """Whether edited windows are within the ranges of their joints and above the ground."""
    before, after = (angles(at_frames(m.rotations), m.rest) for m in (old, new))
    low, high = after.new_tensor(LOWEST), after.new_tensor(HIGHEST)
    inside = (after > torch.minimum(low, before) - _SLACK) & (
        after < torch.maximum(high, before) + _SLACK
    )
    return inside.flatten(1).all(1) & above_ground(old, new)


def above_ground(old: Moments, new: Moments) -> Bool[Tensor, " windows"]:
    """Whether no joint is nearer to the ground z = 0 than flesh allows, or than it ever was."""
    before, after = (_joints(m)[..., 2] for m in (old, new))
    least = [_SOLE if j in FEET else _CLEARANCE for j in range(len(JOINTS))]
    allowed = torch.minimum(after.new_tensor(least), before.amin(1) - 1e-3)
    return (after > allowed[:, None]).flatten(1).all(1)


def _joints(moments: Moments) -> Float[Tensor, "windows frames 22 3"]:
    placed = forward_kinematics(at_frames(moments.rotations), moments.rest)[1]
    return placed + at_frames(moments.translation)[:, :, None]
