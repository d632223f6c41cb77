"""Distances of points from a surface of discs, and robust kernels over them."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.robust import (
    NORMAL_MAD,
    TUNING,
    bisquare_weights,
    geman_mcclure,
    lower_median,
    mad_scale,
)

LEAST_SCALE = 0.005
"""Metres; surfaces are not taken for nearer to each other than this."""


def to_vertices(
    offset: Float[Tensor, "*shape 3"],
    normal: Float[Tensor, "*shape 3"],
    radius: Float[Tensor, "*shape"],
) -> Float[Tensor, "*shape"]:
    """Squared distance from the vertex itself, as published (HuMoR section 6.5)."""
    del normal, radius
    return offset.square().sum(-1)


def to_discs(
    offset: Float[Tensor, "*shape 3"],
    normal: Float[Tensor, "*shape 3"],
    radius: Float[Tensor, "*shape"],
) -> Float[Tensor, "*shape"]:
    """Squared distance from a disc: (n·e)² + max(|e - (n·e) n| - radius, 0)².

    Points between vertices are then as near as the surface is; beyond the ends of the body,
    where a plane would go on, distances grow.
    """
    height = (offset * normal).sum(-1)
    across = (offset - height[..., None] * normal).square().sum(-1)
    outside = across > radius.square()
    # the root is taken of what lies outside only: its gradient at zero is infinite
    beyond = torch.where(outside, across, radius.square().clamp(min=1e-12)).sqrt() - radius
    return height.square() + torch.where(outside, beyond, 0.0).square()


def reweighted(
    squared: Float[Tensor, "*batch samples"], present: Bool[Tensor, "*batch samples"]
) -> Float[Tensor, "*batch samples"]:
    """Squares e² with bisquare weights, constant for gradients: the published energy of a point.

    Its value falls again where points move away beyond half the cut-off, so it suits a line
    search badly; `tukey` has the same gradient and a value that belongs to it.
    """
    residual = squared.detach().sqrt()
    return bisquare_weights(residual, mad_scale(residual, present)) * squared


def tukey(
    squared: Float[Tensor, "*batch samples"], present: Bool[Tensor, "*batch samples"]
) -> Float[Tensor, "*batch samples"]:
    """c²/3 (1 - (1 - e²/c²)³) up to the cut-off c = 4.6851 s, constant beyond; s has no gradient.

    The gradient is that of `reweighted` at equal scale. The scale is median(e) / 0.67449: of
    distances, which are zero at best, it is the deviation from zero that matters. At least half
    of the points always pull, also those of a body that is off as a whole, which deviations
    from the median cut off altogether.
    """
    return within(squared, tukey_scale(squared, present))


def tukey_scale(
    squared: Float[Tensor, "*batch samples"], present: Bool[Tensor, "*batch samples"]
) -> Float[Tensor, "*batch"]:
    """Robust standard deviation of distances about zero, metres; no gradient."""
    residual = squared.detach().sqrt()
    return (lower_median(residual, present) / NORMAL_MAD).clamp(min=LEAST_SCALE)


def within(
    squared: Float[Tensor, "*batch samples"], scale: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch samples"]:
    """Tukey's c²/3 (1 - (1 - e²/c²)³), constant beyond c = 4.6851 scale."""
    cutoff = (TUNING * scale).square()[..., None]
    return cutoff / 3 * (1 - (1 - (squared / cutoff).clamp(max=1)) ** 3)


def bounded(
    squared: Float[Tensor, "*batch samples"],
    present: Bool[Tensor, "*batch samples"],
    sigma: float = 0.1,
) -> Float[Tensor, "*batch samples"]:
    """Geman-McClure with a fixed scale in metres: a misfit that no scale moves."""
    del present
    return geman_mcclure(squared, sigma)
