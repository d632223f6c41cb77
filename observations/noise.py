"""Noise of observations, estimated from the data alone, and the weights that follow from it."""

import math
from collections.abc import Sequence

from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.residuals import NORMAL_MAD, Noise

LIMITS = (0.01, 0.1)
"""Metres. Below the first the model errs more than the sensor; above the second it is outliers."""

_THIRD_DIFFERENCE = math.sqrt(1 + 9 + 9 + 1)
"""Standard deviation of x3 - 3 x2 + 3 x1 - x0 for unit white noise."""


def weights_of(noises: Sequence[Noise]) -> list[float]:
    """Weights of several observations' energies, proportional to their inverse variances.

    The least noisy observation weighs one per metre², and an energy in pixels² is brought to
    metres² at the body: weight = (smallest standard deviation in metres / own one in own unit)².
    """
    least = min(noise.metres for noise in noises)
    return [(least / noise.own) ** 2 for noise in noises]


def estimate_noise(
    positions: Float[Tensor, "*batch time points dims"],
    visible: Bool[Tensor, "*batch time points"],
    limits: tuple[float, float] = LIMITS,
) -> float:
    """Estimate the standard deviation of a coordinate's noise from point paths, in their unit.

    Bodies move smoothly and white noise does not: third differences in time hold little but
    noise, and their median does not see outliers. Where no point is visible four frames in a row,
    the frames that show something are taken one after the other; where that does not help either,
    the upper limit is assumed.
    """
    differences = _third_differences(positions, visible)
    if differences.numel() == 0:
        shown = visible.flatten(0, -3).any(-1).any(0) if visible.ndim > 2 else visible.any(-1)
        differences = _third_differences(positions[..., shown, :, :], visible[..., shown, :])
    if differences.numel() == 0:
        return limits[1]
    noise = float(differences.median()) / NORMAL_MAD / _THIRD_DIFFERENCE
    return min(max(noise, limits[0]), limits[1])


def _third_differences(
    positions: Float[Tensor, "*batch time points dims"],
    visible: Bool[Tensor, "*batch time points"],
) -> Float[Tensor, "runs dims"]:
    """Absolute third differences in time of points that are visible in four frames in a row."""
    run = visible
    for _ in range(3):
        run = run[..., 1:, :] & run[..., :-1, :]
    return positions.diff(n=3, dim=-3)[run].abs()
