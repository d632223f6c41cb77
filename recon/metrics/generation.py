"""Measures of generated motions: distance to the truth, variety, and staying upright.

Displacements and diversity are those of HuMoR (ICCV 2021) section 5.3. `stays_on_its_feet` is our
own definition, by limits of heights and speeds that recorded people keep.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import LIMB_REACH
from recon.core.skeleton import FEET, joint_index
from recon.metrics import errors as metrics

LOWEST_HEAD = 0.6
"""Fraction of the standing height; when the head is lower, people sit on the floor, lie or
fall."""

LONGEST_FLIGHT = 0.7
"""Seconds; a standing jump of 60 cm."""

FASTEST = 15.0
"""Metres per second that no joint exceeds; a kicking foot reaches 14."""


def displacements(
    predicted: Float[Tensor, "*#batch time joints 3"],
    truth: Float[Tensor, "*#batch time joints 3"],
) -> Float[Tensor, "*batch time"]:
    """Mean distance of the joints to their true places in every frame, metres.

    Averaged over frames this is ADE, in the last frame FDE.
    """
    return (predicted - truth).norm(dim=-1).mean(-1)


def pairwise_distance(joints: Float[Tensor, "samples time joints 3"]) -> float | None:
    """Mean distance of the same joint in the same frame over all pairs of samples (APD), metres.

    None for fewer than two samples.
    """
    if len(joints) < 2:
        return None
    rows = [(joints[k + 1 :] - one).norm(dim=-1) for k, one in enumerate(joints[:-1])]
    return metrics.mean(torch.cat([row.mean((1, 2)) for row in rows]))


def lower_foot_height(
    joints: Float[Tensor, "*#batch time 22 3"], rest_height: Float[Tensor, "*#batch 22"]
) -> Float[Tensor, "*batch time"]:
    """Return the height of the lower foot above the ground z = 0, metres: zero while it stands.

    It is the least height of ankles and toes, each less its height in a standing body.
    """
    feet = list(FEET)
    return (joints[..., feet, 2] - rest_height[..., None, feet]).amin(-1)


def stays_upright(
    joints: Float[Tensor, "*#batch time 22 3"], rest_height: Float[Tensor, "*#batch 22"]
) -> Bool[Tensor, "*batch"]:
    """Whether the head is never below 0.6 of its standing height."""
    head = joint_index("head")
    return (joints[..., head, 2] >= LOWEST_HEAD * rest_height[..., None, head]).all(-1)


def stays_on_ground(
    joints: Float[Tensor, "*#batch time 22 3"],
    rest_height: Float[Tensor, "*#batch 22"],
    fps: float,
) -> Bool[Tensor, "*batch"]:
    """Whether the lower foot stays within 8 cm of the ground; it may be higher during jumps.

    Contacts reach up to 8 cm (`recon.body.contacts`); a jump lasts at most 0.7 s.
    """
    height = lower_foot_height(joints, rest_height)
    return (height >= -LIMB_REACH).all(-1) & ~_longer_than_a_jump(height > LIMB_REACH, fps)


def moves_as_people_do(
    joints: Float[Tensor, "*batch time 22 3"], fps: float
) -> Bool[Tensor, "*batch"]:
    """Whether all numbers are finite and no joint is faster than 15 m/s."""
    speed = joints.diff(dim=-3).norm(dim=-1) * fps
    return (speed <= FASTEST).flatten(-2).all(-1) & joints.isfinite().flatten(-3).all(-1)


def stays_on_its_feet(
    joints: Float[Tensor, "*#batch time 22 3"],
    rest_height: Float[Tensor, "*#batch 22"],
    fps: float,
) -> Bool[Tensor, "*batch"]:
    """Whether a motion is upright, on the ground and at human speed in every frame.

    Args:
        joints: world frame, z up, metres.
        rest_height: of every joint above the sole (`recon.body.contacts.rest_heights`), metres.
        fps: frames per second.
    """
    return (
        stays_upright(joints, rest_height)
        & stays_on_ground(joints, rest_height, fps)
        & moves_as_people_do(joints, fps)
    )


def _longer_than_a_jump(
    happens: Bool[Tensor, "*batch time"], fps: float
) -> Bool[Tensor, "*batch"]:
    """Whether a condition holds without a break for longer than a jump lasts."""
    frames = int(LONGEST_FLIGHT * fps) + 1
    if happens.shape[-1] < frames:
        return torch.zeros(happens.shape[:-1], dtype=torch.bool, device=happens.device)
    return happens.unfold(-1, frames, 1).all(-1).any(-1)
