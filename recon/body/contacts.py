"""Contact labels: a joint that is slow and near the ground counts as in contact."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.arrays import cached_constant
from recon.core.skeleton import CONTACT_JOINTS, FEET, JOINTS, TOES

MAXIMUM_SPEED = 0.25
"""A joint in contact moves more slowly than this, m/s, at any frame rate."""

_HEIGHT_SCALE, _SPEED_SCALE = 0.005, 0.04
"""The scales of the logistic function for joints whose places are certain: the first is in metres
of height, the second in metres per second of speed."""
_TIME_SCALE = 0.3
"""The time in seconds over which the error of an uncertain position changes; it turns a standard
deviation of position into one of speed."""

TOE_REACH = 0.04
LIMB_REACH = 0.08
"""Metres a toe, or an ankle, knee or wrist, may be above the height at which it touches
(HuMoR's data processing)."""


def rest_heights(
    body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> Float[Tensor, "*batch 22"]:
    """Height of every joint above the sole when the body stands in its rest pose, metres."""
    sole = body.rest_vertices(shape)[..., 1].amin(-1)
    return body.rest_joints(shape)[..., 1] - sole[..., None]


def heights_in_contact(rest_height: Float[Tensor, "*batch 22"]) -> Float[Tensor, "*batch 22"]:
    """Height of each joint above the ground while its part of the body lies on it, metres.

    Ankles and toes touch at their rest height. Knees and wrists touch when the flesh around
    them does, not at standing height: they are measured from the level of the toe joints, as in
    HuMoR, and so is everything else.
    """
    toes = rest_height[..., cached_constant(TOES, rest_height.device)].mean(-1, keepdim=True)
    of_foot = tuple(j in FEET for j in range(len(JOINTS)))
    return torch.where(cached_constant(of_foot, rest_height.device, torch.bool), rest_height, toes)


def contact_labels(
    joints: Float[Tensor, "*batch time 22 3"],
    rest_height: Float[Tensor, "*batch 22"],
    fps: float,
) -> Bool[Tensor, "*batch time 22"]:
    """Joints in contact with the ground z = 0: slow (< 0.25 m/s) and within reach of it.

    Toes reach 4 cm, ankles, knees and wrists 8 cm above the height at which they touch; no other
    joint is ever in contact. Speeds are central differences at the motion's own rate (one-sided
    at the ends), so a motion played backwards has the same labels.

    Args:
        joints: World frame, z up, metres.
        rest_height: Of every joint above the sole (see `rest_heights`), metres.
        fps: Frames per second.
    """
    lower, slower, may_touch = _contact_margins(joints, rest_height, fps)
    return (lower > 0) & (slower > 0) & may_touch


def contact_probabilities(
    joints: Float[Tensor, "*batch time 22 3"],
    rest_height: Float[Tensor, "*batch 22"],
    fps: float,
    std: Float[Tensor, "*batch time 22"] | None = None,
) -> Float[Tensor, "*batch time 22"]:
    """Probability that a joint is in contact, from its height, its speed and their uncertainty.

    p = σ(min(lower / √(h² + std²), slower / √(v² + (std / t)²))), where lower and slower are
    what the joint is below the limits of `contact_labels`: p is above one half where the label is
    one, and near one half where a joint's height is not known. The constants were chosen by
    likelihood on validation people.

    Args:
        joints: World frame, z up, metres.
        rest_height: Of every joint above the sole (see `rest_heights`), metres.
        fps: Frames per second.
        std: Standard deviation of the height of every joint, metres; None takes all as seen.
    """
    lower, slower, may_touch = _contact_margins(joints, rest_height, fps)
    unsure = torch.zeros_like(lower) if std is None else std
    height = (_HEIGHT_SCALE**2 + unsure.square()).sqrt()
    speed = (_SPEED_SCALE**2 + (unsure / _TIME_SCALE).square()).sqrt()
    return torch.minimum(lower / height, slower / speed).sigmoid() * may_touch


def _contact_margins(
    joints: Float[Tensor, "*batch time 22 3"], rest_height: Float[Tensor, "*batch 22"], fps: float
) -> tuple[Tensor, Tensor, Bool[Tensor, "22"]]:
    """Return how far joints are below the limits of height (m) and speed (m/s) of a contact.

    Both margins are positive for a joint in contact. The third value is a mask of the joints that
    can be in contact at all.
    """
    limits = [TOE_REACH if j in TOES else LIMB_REACH for j in range(len(JOINTS))]
    may_touch = [j in CONTACT_JOINTS and JOINTS[j] != "pelvis" for j in range(len(JOINTS))]
    height = joints[..., 2] - heights_in_contact(rest_height)[..., None, :]
    lower = height.new_tensor(limits) - height
    slower = MAXIMUM_SPEED - speeds(joints, fps)
    return lower, slower, torch.tensor(may_touch, device=joints.device)


def speeds(joints: Tensor, fps: float) -> Tensor:
    """Speed of every joint in every frame, m/s; zero for a single frame."""
    if joints.shape[-3] < 2:
        return torch.zeros_like(joints[..., 0])
    (velocity,) = torch.gradient(joints, spacing=1 / fps, dim=-3)
    return velocity.norm(dim=-1)
