"""Legs brought to given ankles in closed form: the knee lies on a circle about hip-ankle."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.struct import TensorStruct

HIPS, KNEES, ANKLES = (1, 2), (4, 5), (7, 8)
"""Joints of the left and the right leg."""

_STRAIGHT = 0.998
"""Longest distance from hip to ankle, of the leg's length; further only where it was recorded."""

_FOLDED = 0.35
"""Shortest distance, of the leg's length."""


@dataclass(frozen=True)
class Aim(TensorStruct):
    """Places at which pelvis and ankles shall be; feet keep their orientations in the world."""

    root: Float[Tensor, "windows times 3 3"]
    pelvis: Float[Tensor, "windows times 3"]
    ankles: Float[Tensor, "windows times 2 3"]
    forward: Float[Tensor, " windows"]
    """Metres that count for the direction of the kneecap beside the knee's own distance from the
    line between hip and ankle. Zero gives recorded knees back exactly; straight knees need more to
    know where to bend."""


def brought(
    rotations: Float[Tensor, "windows times 22 3 3"],
    posed: tuple[Float[Tensor, "windows times 22 3 3"], Float[Tensor, "windows times 22 3"]],
    rest: Float[Tensor, "windows 22 3"],
    aim: Aim,
) -> tuple[Float[Tensor, "windows times 22 3 3"], Bool[Tensor, "windows 2"]]:
    """Rotations with which both legs reach their ankles from a moved pelvis.

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
    apart = _across(knee - hip, was / was.norm(dim=-1, keepdim=True))
    facing = orientations[:, :, list(HIPS), :, 2]
    pole = _across(apart + aim.forward[:, None, None, None] * facing, along)
    pole = pole / pole.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    bent = begin + x[..., None] * along + radius[..., None] * pole

    thigh = shortest(knee - hip, bent - begin) @ orientations[:, :, list(HIPS)]
    shank = shortest(ankle - knee, aim.ankles - bent) @ orientations[:, :, list(KNEES)]
    foot = orientations[:, :, list(ANKLES)]
    made = rotations.clone()
    made[:, :, 0] = aim.root
    made[:, :, list(HIPS)] = aim.root[:, :, None].mT @ thigh
    made[:, :, list(KNEES)] = thigh.mT @ shank
    made[:, :, list(ANKLES)] = shank.mT @ foot

    length = upper + lower
    far = (reach > _STRAIGHT * length) & (reach > was.norm(dim=-1) + 1e-4)
    return made, ~(far | (reach < _FOLDED * length)).any(1)


def shortest(
    start: Float[Tensor, "*shape 3"], end: Float[Tensor, "*shape 3"]
) -> Float[Tensor, "*shape 3 3"]:
    """The smallest rotation from one direction to another: I + K + K² / (1 + cos)."""
    a = start / start.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    b = end / end.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    skew = so3.hat(torch.linalg.cross(a, b))
    cosine = (a * b).sum(-1)[..., None, None].clamp(min=-0.99)
    return torch.eye(3).to(skew) + skew + skew @ skew / (1 + cosine)


def _across(vector: Tensor, unit: Tensor) -> Tensor:
    """The part of a vector that is perpendicular to a direction."""
    return vector - (vector * unit).sum(-1, keepdim=True) * unit
