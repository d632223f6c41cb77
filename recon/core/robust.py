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
    """The median of the present values, the lower of two middle ones; zero without values."""
    if values.shape[-1] == 0:
        return values.sum(-1)
    count = present.sum(-1, keepdim=True)
    ordered = torch.where(present, values, torch.inf).sort(-1).values
    middle = ordered.gather(-1, (count - 1).clamp(min=0) // 2)
    return torch.where(count > 0, middle, 0.0)[..., 0]
