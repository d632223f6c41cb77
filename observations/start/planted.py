"""A path for bodies that are relative to their pelvis: the foot that stands does not move."""

import numpy as np
from jaxtyping import Bool, Float

from recon.core.layouts import JOINT

_PARTS = ("heel", "big_toe", f"foot{JOINT}", "ankle")
_SMOOTH = 0.15
"""Seconds over which heights of feet and the path are averaged."""
_LOWER = 0.02
"""Metres by which the other foot must be lower to take the weight over."""
_ANKLE, _SOLE = 0.08, 0.015
"""Metres above the ground of a standing ankle, and of the lowest points of a standing foot."""


def planted_path(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    fps: float,
) -> Float[np.ndarray, "time 3"]:
    """Translations, metres, that keep the lower foot where it stands, and on z = 0.

    It is only where to begin from: a prior that knows how feet touch the ground says more.

    Args:
        names: of the keypoints.
        positions: relative to the pelvis, metres, z up.
        visible: where they were seen.
        fps: frames per second.
    """
    feet, lifts = _feet(names, positions, visible)
    if feet is None:
        return np.zeros((len(positions), 3))
    width = max(round(_SMOOTH * fps) // 2 * 2 + 1, 1)
    feet = np.stack([_averaged(_filled(one), width) for one in feet])
    lowest = feet[..., 2] - lifts[:, None]
    path = np.zeros((len(positions), 3))
    stance = int(lowest[:, 0].argmin())
    anchor = feet[stance, 0, :2].copy()
    for t in range(len(path)):
        other = 1 - stance
        if len(feet) > 1 and lowest[other, t] < lowest[stance, t] - _LOWER:
            here = anchor - feet[stance, t, :2]
            stance, anchor = other, here + feet[other, t, :2]
        path[t, :2] = anchor - feet[stance, t, :2]
        path[t, 2] = -lowest[:, t].min()
    return _averaged(path, width)


def _feet(
    names: tuple[str, ...], positions: np.ndarray, visible: np.ndarray
) -> tuple[Float[np.ndarray, "feet time 3"] | None, Float[np.ndarray, " feet"]]:
    """Mean of the lowest points of both feet, NaN where not seen, and how high they stand."""
    for parts in (("heel", "big_toe"), ("ankle", f"foot{JOINT}"), ("ankle",)):
        found = []
        for side in ("left", "right"):
            rows = [names.index(f"{side}_{part}") for part in parts if f"{side}_{part}" in names]
            if len(rows) == len(parts):
                seen = np.all(visible[:, rows], axis=1)
                place = positions[:, rows].mean(1)
                place[:, 2] = positions[:, rows, 2].min(1)
                found.append(np.where(seen[:, None], place, np.nan))
        if found and np.isfinite(np.stack(found)).any(1).all():
            lift = _SOLE if "ankle" not in parts else _ANKLE if parts == ("ankle",) else _SOLE
            return np.stack(found), np.full(len(found), lift)
    return None, np.zeros(0)


def _filled(path: Float[np.ndarray, "time 3"]) -> Float[np.ndarray, "time 3"]:
    """Gaps bridged by straight lines, ends held."""
    seen = np.all(np.isfinite(path), axis=-1)
    moments = np.arange(len(path))
    return np.stack([np.interp(moments, moments[seen], path[seen, k]) for k in range(3)], 1)


def _averaged(path: Float[np.ndarray, "time 3"], width: int) -> Float[np.ndarray, "time 3"]:
    """A moving mean of odd width; the ends are held."""
    half = width // 2
    padded = np.pad(path, ((half, half), (0, 0)), mode="edge")
    kernel = np.full(width, 1 / width)
    return np.stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(3)], 1)
