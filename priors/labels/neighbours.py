"""Neighbourhoods of points, by products of matrices alone: spread centres, means, normals."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.struct import TensorStruct

_NOWHERE = -1e4
"""Logarithm of the weight of a point that is not present."""
_LEAST_VARIANCE = 4e-5
"""Variance across a patch beyond that along its normal, m², below which the normal means little:
points that lie alone or on a line have none, whatever rounding says."""


def squared_distances(
    a: Float[Tensor, "moments first 3"], b: Float[Tensor, "moments second 3"]
) -> Float[Tensor, "moments first second"]:
    """Squared distances of all points of two clouds, m²."""
    sums = a.square().sum(-1)[..., :, None] + b.square().sum(-1)[..., None, :]
    return torch.baddbmm(sums, a, b.mT, alpha=-2.0).clamp(min=0)


def kernel(
    squared: Float[Tensor, "moments first second"],
    width: float,
    present: Bool[Tensor, "moments second"] | None = None,
) -> Float[Tensor, "moments first second"]:
    """Weights exp(-d² / (2 width²)) of the second cloud's points, summing to one."""
    exponent = squared * (-0.5 / width**2)
    if present is not None:
        exponent = exponent.masked_fill(~present[..., None, :], _NOWHERE)
    return exponent.softmax(-1)


def spread_points(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    count: int,
) -> Int[Tensor, "moments count"]:
    """Numbers of points far from each other, one after the other (farthest point sampling).

    The first is the farthest from the origin, so that the order of points does not matter. Where
    fewer points are present than asked for, some come more than once.
    """
    rows = torch.arange(len(points), device=points.device)
    length = points.square().sum(-1)
    nearest = length.where(present, -1.0)
    chosen = nearest.argmax(-1)
    found = [chosen]
    nearest = torch.where(present, torch.inf, -1.0).to(points)
    for _ in range(count - 1):
        last = points[rows, chosen]
        away = torch.baddbmm(length[..., None], points, last[..., None], alpha=-2.0)[..., 0]
        nearest = torch.minimum(nearest, away + length[rows, chosen][:, None])
        chosen = nearest.argmax(-1)
        found.append(chosen)
    return torch.stack(found, -1)


@dataclass(frozen=True)
class Patch(TensorStruct):
    """The surface around some centres, as points weighted by a kernel show it."""

    mean: Float[Tensor, "moments centres 3"]
    """Mean of the points, metres."""
    covariance: Float[Tensor, "moments centres 6"]
    """Entries xx, xy, xz, yy, yz, zz of their covariance, m²."""
    normal: Float[Tensor, "moments centres 3"]
    """Direction in which they vary least, of no certain sign; shorter than one where they vary in
    other directions as little."""
    flatness: Float[Tensor, "moments centres"]
    """Least variance over the sum of variances: 0 for a plane, a line or a point, 1/3 for a ball,
    less where they lie close together."""


def patches(
    points: Float[Tensor, "moments points 3"], weights: Float[Tensor, "moments centres points"]
) -> Patch:
    """Means, covariances and normals of weighted points."""
    x, y, z = points.unbind(-1)
    products = torch.stack((x * x, x * y, x * z, y * y, y * z, z * z), -1)
    found = weights @ torch.cat((points, products), -1)
    mean, second = found.split((3, 6), -1)
    x, y, z = mean.unbind(-1)
    covariance = second - torch.stack((x * x, x * y, x * z, y * y, y * z, z * z), -1)
    normal, least, middle = smallest_axes(covariance)
    gap = (middle - least).clamp(min=0)
    trace = covariance[..., 0] + covariance[..., 3] + covariance[..., 5]
    flatness = least.clamp(min=0) / (trace.clamp(min=0) + _LEAST_VARIANCE)
    return Patch(mean, covariance, normal * (gap / (gap + _LEAST_VARIANCE))[..., None], flatness)


def smallest_axes(
    entries: Float[Tensor, "*shape 6"],
) -> tuple[Float[Tensor, "*shape 3"], Float[Tensor, "*shape"], Float[Tensor, "*shape"]]:
    """Unit eigenvector of the least eigenvalue of symmetric matrices, the least, the middle one.

    Eigenvalues by the trigonometric solution of the cubic (Smith 1961), the vector as the longest
    cross product of two rows of A - λI: thousands at once, where a library would take them one by
    one.
    """
    a, b, c, d, e, f = entries.unbind(-1)
    q = (a + d + f) / 3
    shifted = ((a - q).square() + (d - q).square() + (f - q).square()) / 6
    p = (shifted + (b.square() + c.square() + e.square()) / 3).clamp(min=1e-20).sqrt()
    x, y, z = (a - q) / p, (d - q) / p, (f - q) / p
    u, v, w = b / p, c / p, e / p
    half = (x * (y * z - w * w) - u * (u * z - w * v) + v * (u * w - y * v)) / 2
    angle = half.clamp(-1, 1).arccos() / 3
    least = q + 2 * p * torch.cos(angle + 2 * torch.pi / 3)
    middle = 3 * q - least - (q + 2 * p * torch.cos(angle))
    first = torch.stack((a - least, b, c), -1)
    second = torch.stack((b, d - least, e), -1)
    third = torch.stack((c, e, f - least), -1)
    crossed = torch.stack(
        (
            torch.linalg.cross(first, second, dim=-1),
            torch.linalg.cross(second, third, dim=-1),
            torch.linalg.cross(third, first, dim=-1),
        ),
        -2,
    )
    best = crossed.square().sum(-1).argmax(-1, keepdim=True)
    axis = crossed.take_along_dim(best[..., None], -2)[..., 0, :]
    length = axis.norm(dim=-1, keepdim=True).clamp(min=1e-30)
    return axis / length, least, middle
