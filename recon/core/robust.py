"""Robust kernels and weights of squared residuals, as pure functions.

Residuals come in physical units (metres or pixels); so do the scales.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

TUNING = 4.6851
"""Bisquare cut-off in robust standard deviations: 95 % efficiency on Gaussian residuals."""

NORMAL_MAD = 0.67449
"""Median absolute deviation of a standard normal variable."""


def squared(residual_squared: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """rho(e) = e²: ordinary least squares."""
    return residual_squared


def geman_mcclure(
    residual_squared: Float[Tensor, "*shape"], sigma: float
) -> Float[Tensor, "*shape"]:
    """rho(e) = sigma² e² / (sigma² + e²): e² near zero, at most sigma².

    Geman and McClure 1987; HuMoR uses it on image coordinates with sigma = 100 pixels.
    """
    return sigma**2 * residual_squared / (sigma**2 + residual_squared)


def lower_median(
    values: Float[Tensor, "*batch samples"], present: Bool[Tensor, "*batch samples"]
) -> Float[Tensor, "*batch"]:
    """The middle value of those present, the lower one of two; zero where there is none."""
    count = present.sum(-1, keepdim=True)
    ordered = torch.where(present, values, torch.inf).sort(-1).values
    middle = ordered.gather(-1, (count - 1).clamp(min=0) // 2)
    return torch.where(count > 0, middle, 0.0)[..., 0]


def mad_scale(
    residual: Float[Tensor, "*batch samples"],
    present: Bool[Tensor, "*batch samples"] | None = None,
) -> Float[Tensor, "*batch"]:
    """Robust standard deviation: median |e - median(e)| / 0.67449, both medians the lower ones.

    Samples that are not `present` are left out; the scale of no sample is zero. No gradient.
    """
    residual = residual.detach()
    if present is None:
        present = torch.ones_like(residual, dtype=torch.bool)
    centre = lower_median(residual, present)
    return lower_median((residual - centre[..., None]).abs(), present) / NORMAL_MAD


def bisquare_weights(
    residual: Float[Tensor, "*batch samples"], scale: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch samples"]:
    """Tukey's weights (1 - u²)² for u = |e| / (4.6851 scale) < 1, else 0. No gradient.

    A scale of zero tells nothing about outliers: every weight is then one. The cut-off is
    measured from zero, not from the median: residuals that are all large and alike are all
    cut off, so bring the two surfaces near each other first (HuMoR's RGB-D term does the same).
    """
    cutoff = TUNING * scale.detach()[..., None]
    known = cutoff > 0
    ratio = residual.detach() / torch.where(known, cutoff, 1.0)
    weights = (1 - ratio.square()).clamp(min=0).square()
    return torch.where(known, weights, 1.0)
