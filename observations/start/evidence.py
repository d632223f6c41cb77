"""How well a posed body agrees with what a sensor saw of it, without labels; for choosing.

Points ought to lie on the surface that faces the sensor, and a surface that faces the sensor ought
to have points: where it sticks out of their outline, or stands before them, the sensor looked
through it. Minimised, the second part would shrink the body; compared, it tells postures apart.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.surfels import Surfels
from priors.labels.neighbours import squared_distances
from recon.body.model import BodyModel
from recon.core.geometry.visible import facing
from recon.core.motion import Motion

_REACH = 0.1
"""Scale in metres of the distance of a point from the surface: at this one, half counts."""
_BESIDE = 0.08
"""Metres at the body within which a point stands for a line of sight."""
_BEFORE = 0.12
"""Metres that a surface may be nearer to the sensor than the points along its line of sight."""


@dataclass(frozen=True)
class Evidence:
    """What speaks against poses: shares from 0 to 1, one of every row."""

    misfit: Float[Tensor, " rows"]
    """Mean of d² / (d² + 0.1²) over the distances d of points from the facing surface, metres."""
    contradicted: Float[Tensor, " rows"]
    """Share of the facing surface where the sensor saw past it or through it; 0 without one."""


def evidence(
    motion: Motion,
    body: BodyModel,
    surfels: Surfels,
    points: Float[Tensor, "rows points 3"],
    present: Bool[Tensor, "rows points"],
    eye: Float[Tensor, "rows 3"] | None,
) -> Evidence:
    """Evidence against every frame of a motion.

    Args:
        motion: one clip, whose frames are the rows.
        body: whose motion it is.
        surfels: a sparse cover of its surface.
        points: seen in every row, metres.
        present: which of them exist.
        eye: the sensor's place in every row; None where points come from all sides.
    """
    middles, normals = surfels.posed(body.pose(motion))
    shown = torch.ones_like(present[:, :1]).expand(middles.shape[:2])
    if eye is not None:
        shown = facing(middles, normals, eye)
    centre = points.mean(1, keepdim=True)  # far from the origin, products of places lose digits
    squared = squared_distances(points - centre, middles - centre)
    nearest = squared.masked_fill(~shown[:, None], torch.inf).amin(-1)
    share = (nearest / (nearest + _REACH**2)).nan_to_num(1.0).where(present, 0.0)
    misfit = share.sum(-1) / present.sum(-1).clamp(min=1)
    if eye is None:
        return Evidence(misfit, torch.zeros_like(misfit))
    away = torch.where(present[..., None], points - eye[:, None], 0.0)
    far = away.norm(dim=-1)
    ray = away / far.clamp(min=1e-6)[..., None]
    towards = middles - eye[:, None]
    depth = towards.norm(dim=-1)
    cosine = (towards / depth.clamp(min=1e-6)[..., None]) @ ray.mT
    cosine = cosine.masked_fill(~present[:, None], -1.0)
    best = cosine.max(-1)
    lateral = (2 - 2 * best.values.clamp(max=1)).sqrt() * depth
    before = far.gather(-1, best.indices) - depth > _BEFORE
    against = shown & ((lateral > _BESIDE) | before)
    share = against.sum(-1) / shown.sum(-1).clamp(min=1)
    return Evidence(misfit, share.to(misfit))
