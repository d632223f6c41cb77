"""Positions that no body could have, left out of the quick fit that judges the others."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.points.named_points import NamedPoints

_REACH = 1.4
"""Metres from the middle of a body within which all of its points lie, arms stretched."""
_SPIKE = 0.5
"""Metres by which a point may be away from its own median over a quarter of a second; hands that
punch and feet that kick turn around within less."""
_HALF_WINDOW = 0.12
"""Seconds to either side over which that median is taken."""


def plausible(points: NamedPoints) -> NamedPoints:
    """The points without those far from all others and those that leap out of their own path."""
    return points.without(_far(points) | _spikes(points))


def _far(points: NamedPoints) -> Bool[np.ndarray, "moments points"]:
    away = np.linalg.norm(points.positions - points.centre[:, None], axis=-1)
    return points.visible & (np.nan_to_num(away) > _REACH)


def smoothed(points: NamedPoints) -> NamedPoints:
    """The points' medians over a quarter of a second: a first guess that outliers do not move.

    They have no standard deviations: medians exist where points were not seen as well.
    """
    kept = points.without(_far(points))
    median = _running_median(kept)
    known = np.isfinite(median[..., 0])
    return replace(
        kept, positions=np.where(known[..., None], median, 0.0), visible=known, std=None
    )


def _spikes(points: NamedPoints) -> Bool[np.ndarray, "moments points"]:
    away = np.linalg.norm(points.positions - _running_median(points), axis=-1)
    return points.visible & (np.nan_to_num(away) > _SPIKE)


def _running_median(points: NamedPoints) -> Float[np.ndarray, "moments points 3"]:
    """Median of every coordinate about every moment; NaN where nothing is visible about it."""
    half = max(int(_HALF_WINDOW * points.fps), 1)
    shown = np.where(points.visible[..., None], points.positions, np.nan)
    padded = np.pad(shown, ((half, half), (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), -1)
    count = np.isfinite(windows).sum(-1)  # NaN is sorted last
    middle = np.stack(((count - 1) // 2, count // 2), -1).clip(min=0)
    return np.take_along_axis(windows, middle, -1).mean(-1)
