"""Finds a person's path from keypoints that are given relative to the body.

Feet on the ground do not slide.
"""

import numpy as np
from jaxtyping import Bool, Float

from recon.core.layouts import JOINT

_PARTS = {"heel": 0.015, "big_toe": 0.015, f"foot{JOINT}": 0.02, "ankle": 0.08}
"""Points of a foot, and metres above the ground of each where the foot stands."""
_SMOOTH = 0.15
"""Seconds over which points of feet and the path are averaged."""
_LOWER = 0.02
"""Metres by which the other foot must be lower to take the weight over."""


def planted_translations(
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    fps: float,
) -> Float[np.ndarray, "time 3"]:
    """Translations of the body, metres, that keep the lower foot at one place on z = 0.

    It is only where to begin from: a prior that knows how feet touch the ground says more.

    Args:
        names: of the keypoints.
        positions: relative to the pelvis, metres, z up.
        visible: where they were seen.
        fps: frames per second.
    """
    width = max(round(_SMOOTH * fps) // 2 * 2 + 1, 1)
    feet = [
        foot
        for side in ("left", "right")
        if (foot := _points_of_foot(side, names, positions, visible, width)) is not None
    ]
    path = np.zeros((len(positions), 3))
    if not feet:
        return path
    middle = np.stack([foot.mean(1) for foot in feet])
    path[:, 2] = -np.stack([foot[..., 2].min(1) for foot in feet]).min(0)
    stance = int(middle[:, 0, 2].argmin())
    anchor = middle[stance, 0, :2].copy()
    for t in range(len(path)):
        other = 1 - stance
        # which foot stands, whole feet tell: toes of a swinging foot pass close above the ground
        if len(feet) > 1 and middle[other, t, 2] < middle[stance, t, 2] - _LOWER:
            here = anchor - middle[stance, t, :2]
            stance, anchor = other, here + middle[other, t, :2]
        path[t, :2] = anchor - middle[stance, t, :2]
    return _moving_mean(path, width)


def _points_of_foot(
    side: str,
    names: tuple[str, ...],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    width: int,
) -> Float[np.ndarray, "time parts 3"] | None:
    """Smoothed paths of a foot's points at its sole, gaps filled; None if never seen."""
    found: list[np.ndarray] = []
    for part, lift in _PARTS.items():
        if f"{side}_{part}" not in names:
            continue
        row = names.index(f"{side}_{part}")
        if visible[:, row].any():
            seen = np.where(visible[:, row, None], positions[:, row], np.nan)
            found.append(_moving_mean(_gaps_interpolated(seen), width) - (0.0, 0.0, lift))
    return np.stack(found, 1) if found else None


def _gaps_interpolated(path: Float[np.ndarray, "time 3"]) -> Float[np.ndarray, "time 3"]:
    """Fill frames with NaN by linear interpolation in time, constant beyond the ends."""
    seen = np.all(np.isfinite(path), axis=-1)
    moments = np.arange(len(path))
    return np.stack([np.interp(moments, moments[seen], path[seen, k]) for k in range(3)], 1)


def _moving_mean(path: Float[np.ndarray, "time 3"], width: int) -> Float[np.ndarray, "time 3"]:
    """A moving mean of odd width; the first and last values are repeated at the ends."""
    half = width // 2
    padded = np.pad(path, ((half, half), (0, 0)), mode="edge")
    kernel = np.full(width, 1 / width)
    return np.stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(3)], 1)
