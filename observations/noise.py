"""Noise of observations, estimated from the data alone, and the weights that follow from it."""

import math
from collections.abc import Sequence

from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.residuals import Noise

LIMITS = (0.01, 0.1)
"""Metres. Below the first the model errs more than the sensor; above the second it is outliers."""

_THIRD_DIFFERENCE = math.sqrt(1 + 9 + 9 + 1)
"""Standard deviation of x3 - 3 x2 + 3 x1 - x0 for unit white noise."""
_NORMAL_MEDIAN = 0.67449
"""Median of |x| for unit normal x."""
_MIN_CORRELATION = 0.1
"""Correlations in time below this, and all of longer lags, are taken for none."""
_MAX_REPETITION = 16.0
"""Longer errors are those of the model, such as a wrong lens, rather than of a detector."""
_FOLLOWED = 3.0
"""Excess of the errors' repetition over that of residuals, as a fitted motion follows errors that
last; chosen on simulated errors of BlazePose's size and duration, validation people."""
_OUTLIER_STDS = 3.0


def weights_of(noises: Sequence[Noise]) -> list[float]:
    """Weights of the energies of several observations, by the inverse of their variances.

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
    """Standard deviation of every coordinate, in its unit, within limits.

    Bodies move smoothly and white noise does not: third differences in time hold little but
    noise, and their median does not see outliers. Where no point is visible four frames in a row,
    the frames that show something are taken one after the other; where that does not help either,
    the upper limit is assumed.
    """
    bends = _third_differences(positions, visible)
    if bends.numel() == 0:
        shown = visible.flatten(0, -3).any(-1).any(0) if visible.ndim > 2 else visible.any(-1)
        bends = _third_differences(positions[..., shown, :, :], visible[..., shown, :])
    if bends.numel() == 0:
        return limits[1]
    noise = float(bends.median()) / _NORMAL_MEDIAN / _THIRD_DIFFERENCE
    return min(max(noise, limits[0]), limits[1])


def error_repetition(
    errors: Float[Tensor, "*batch time points dims"],
    visible: Bool[Tensor, "*batch time points"],
    noise: float,
    rate: float = 1.0,
) -> float:
    """Number of frames that tell as much as one would if its errors were new in every frame.

    The mean of N frames of errors with standard deviation s and correlations ρ_k at lags of k
    frames has the variance s² (1 + 2 Σ ρ_k) / N, that of white noise σ² / N. The quotient of these
    follows, from 1 to 16: one plus three times the excess of the residuals over one, as a motion
    follows a part of the errors. `estimate_noise` does not see errors that last, because bodies
    move as slowly: detectors of keypoints err by 1 to 2 cm for a sixth of a second. Constant
    errors of a point are left out.

    Args:
        errors: residuals of every coordinate, measured minus fitted.
        visible: which count.
        noise: σ, the standard deviation of white noise.
        rate: frames that the energy counts for each of the data, such as 0.5 of data at 60 Hz.
    """
    shown = visible[..., None].to(errors)
    count = shown.sum(-3, keepdim=True).clamp(min=1)
    away = (errors - (errors * shown).sum(-3, keepdim=True) / count) * shown
    if not bool(visible.any()):
        return 1.0
    limit = _OUTLIER_STDS * away.abs()[visible].median() / _NORMAL_MEDIAN
    away = away.clamp(-limit, limit)
    variance = float(away.square().sum() / (shown.sum() * away.shape[-1]))
    if not variance > 0:
        return 1.0
    repeated = 1.0
    for lag in range(1, away.shape[-3] // 2):
        both = shown[..., lag:, :, :] * shown[..., :-lag, :, :]
        product = away[..., lag:, :, :] * away[..., :-lag, :, :]
        correlation = float(product.sum() / (both.sum() * away.shape[-1]).clamp(min=1)) / variance
        if correlation < _MIN_CORRELATION:
            break
        repeated += 2 * correlation
    excess = variance / noise**2 * repeated * rate - 1
    return min(1 + _FOLLOWED * max(excess, 0.0), _MAX_REPETITION)


def _third_differences(
    positions: Float[Tensor, "*batch time points dims"],
    visible: Bool[Tensor, "*batch time points"],
) -> Float[Tensor, "runs dims"]:
    """Absolute third differences in time of points that are visible in four frames in a row."""
    run = visible
    for _ in range(3):
        run = run[..., 1:, :] & run[..., :-1, :]
    return positions.diff(n=3, dim=-3)[run].abs()
