"""Residuals (observed minus predicted), robust kernels of them, and the noise of observations."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.struct import TensorStruct

Unit = Literal["metres", "pixels", "radians"]


@dataclass(frozen=True)
class Noise:
    """The noise of one observation: standard deviation in its unit, and in metres."""

    own: float
    """Standard deviation of every coordinate in the observation's own unit.

    Neighbouring points with a common error get a larger value, so that they count as one.
    """
    metres: float
    """Standard deviation at the body, metres."""


@dataclass(frozen=True)
class Residuals(TensorStruct):
    """Residuals of one observation, observed minus predicted, with weights; 0 where unseen.

    Energies, noise, diagnosis and warnings all follow from these.
    """

    values: Float[Tensor, "*batch moments points dims"]
    """Coordinates of every point's residual, in `unit`: three in the frame of the recording, two
    in an image, one of a distance."""
    weights: Float[Tensor, "*batch moments points"]
    """Weight of a point: 0 where it was not seen or the estimate does not cover its moment, else a
    detection's confidence; for a measured point 1 or, where every point has a standard deviation,
    the root mean square of these over the point's own."""
    unit: Unit

    @property
    def seen(self) -> Bool[Tensor, "*batch moments points"]:
        """Mask of residuals that count: the point was seen, and the estimate covers its time."""
        return self.weights > 0

    @property
    def distances(self) -> Float[Tensor, "*batch moments points"]:
        """Length of every residual, in `unit`; zero where nothing was seen."""
        return self.values.norm(dim=-1)


TUNING = 4.6851
"""Bisquare cut-off in robust standard deviations: 95 % efficiency on Gaussian residuals."""

NORMAL_MAD = 0.67449
"""Median absolute deviation of a standard normal variable."""


def squared(residual_squared: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Robust kernel of ordinary least squares: returns the squared residual unchanged."""
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
