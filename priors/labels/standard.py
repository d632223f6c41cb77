"""The frame in which clouds are looked at: about their median, turned as far as is known how.

What a network is to say of a point does not depend on where the world's axes lie, and it need not
learn so where the cloud is turned before: upwards where gravity is known, towards the sensor where
there is one, and along the cloud's own long axes otherwise.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import normalize

from priors.labels.networks import SeenClouds
from recon.core.robust import lower_median

_STEEP = 1e-2
"""Horizontal share of a view from which on the sensor stands above the cloud."""


def standard(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    eyes: Float[Tensor, "moments 3"],
    has_eye: Bool[Tensor, " moments"],
    level: Bool[Tensor, " moments"],
) -> SeenClouds:
    """Clouds about their medians, turned by `standard_turns`.

    Args:
        points: positions, metres; zero where not present.
        present: whether a row holds a point.
        eyes: place of the sensor, metres; anything where there is none.
        has_eye: whether there is a sensor.
        level: whether z is known to point up.
    """
    middle = lower_median(points.mT, present[:, None].expand(points.mT.shape))
    about = (points - middle[:, None]).where(present[..., None], 0.0)
    views = (eyes - middle).where(has_eye[:, None], 0.0)
    turns = standard_turns(about, present, views, has_eye, level)
    return SeenClouds(
        points=about @ turns.mT,
        present=present,
        eyes=(turns @ views[..., None])[..., 0],
        has_eye=has_eye,
        level=level,
    )


def standard_turns(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    views: Float[Tensor, "moments 3"],
    has_eye: Bool[Tensor, " moments"],
    level: Bool[Tensor, " moments"],
) -> Float[Tensor, "moments 3 3"]:
    """Rotations to the frame in which z is up and x points to the sensor.

    One of both that is not known lies along the longest axis of the points across the other. Where
    there is no sensor, the longest axis of the points across z is y; where nothing is known, their
    longest axis of all is z. Axes point to where the points reach farther.
    """
    vertical = points.new_tensor([0.0, 0.0, 1.0]).expand(len(points), 3)
    view = normalize(views, dim=-1)
    first = torch.where(has_eye[:, None], view, longest(points, present, None))
    first = torch.where(level[:, None], vertical, first)
    across = view - (view * first).sum(-1, keepdim=True) * first
    seen = level & has_eye & (across.norm(dim=-1) > _STEEP)
    second = torch.where(seen[:, None], normalize(across, dim=-1), longest(points, present, first))
    third = torch.linalg.cross(first, second, dim=-1)
    towards = (has_eye & ~level)[:, None, None]
    turned = torch.where(
        towards,
        torch.stack((first, -third, second), -2),
        torch.stack((-third, second, first), -2),
    )
    return torch.where(seen[:, None, None], torch.stack((second, third, first), -2), turned)


def longest(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    across: Float[Tensor, "moments 3"] | None,
) -> Float[Tensor, "moments 3"]:
    """Unit vector along which points vary most, of all or of those across another unit vector."""
    count = present.sum(-1, keepdim=True).clamp(min=1)[..., None]
    away = (points - points.sum(-2, keepdim=True) / count).where(present[..., None], 0.0)
    if across is not None:
        away = away - (away * across[:, None]).sum(-1, keepdim=True) * across[:, None]
    axis = torch.linalg.eigh(away.mT @ away / count).eigenvectors[..., -1]
    if across is not None:
        # where all points lie on one line, any axis across it will do, but it must be across
        axis = axis - (axis * across).sum(-1, keepdim=True) * across
        other = torch.eye(3).to(points)[across.abs().argmin(-1)]
        other = other - (other * across).sum(-1, keepdim=True) * across
        axis = torch.where(axis.norm(dim=-1, keepdim=True) > 0.1, axis, other)
        axis = normalize(axis, dim=-1)
    reach = (away * axis[:, None]).sum(-1).pow(3).sum(-1, keepdim=True)
    return torch.where(reach < 0, -axis, axis)
