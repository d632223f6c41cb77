"""Finds tracks in a recording of points: cuts trajectories where they jump, and joins others.

A track is the path of one marker while it is seen without a break: a part of one column, or parts
of several columns where a file has a cloud of points in no order.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

_JUMP, _ACCELERATION = 0.012, 60.0
"""Largest distance of a marker from the position that its velocity predicts: a constant (m), plus
the way between two frames at an acceleration (m/s²)."""


def track_numbers(
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    fps: float,
) -> Int[np.ndarray, "time points"]:
    """Return the number of every visible point's track, from 0; -1 where it is not visible."""
    reach = _JUMP + _ACCELERATION / fps**2
    before, after = _displacements(positions, visible)
    steps = positions[1:] - positions[:-1]
    error = np.linalg.norm(steps - (before[:-1] + after[1:]) / 2, axis=-1)
    joined = visible[1:] & visible[:-1] & (error < reach)
    begins = visible.copy()
    begins[1:] &= ~joined
    numbers = np.where(begins, np.cumsum(begins).reshape(begins.shape), 0)
    track = np.where(visible, np.maximum.accumulate(numbers, axis=0) - 1, -1)
    ends = visible.copy()
    ends[:-1] &= ~joined
    return _joined_tracks(track, positions, begins, ends, before, reach)


def _displacements(
    x: Float[np.ndarray, "time points 3"], visible: Bool[np.ndarray, "time points"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements from the previous frame and to the next; 0 where either is hidden."""
    steps = np.where((visible[1:] & visible[:-1])[..., None], np.diff(x, axis=0), 0.0)
    none = np.zeros_like(x[:1])
    return np.concatenate((none, steps)), np.concatenate((steps, none))


def _joined_tracks(
    track: Int[np.ndarray, "time points"],
    x: Float[np.ndarray, "time points 3"],
    begins: Bool[np.ndarray, "time points"],
    ends: Bool[np.ndarray, "time points"],
    velocity: Float[np.ndarray, "time points 3"],
    reach: float,
) -> Int[np.ndarray, "time points"]:
    """Join each track to one that begins in the next frame near its predicted position."""
    from scipy.optimize import linear_sum_assignment

    former = np.arange(track.max() + 1)
    velocity = velocity.copy()
    for frame in np.flatnonzero(begins[1:].any(1) & ends[:-1].any(1)):
        old, new = np.flatnonzero(ends[frame]), np.flatnonzero(begins[frame + 1])
        ahead = x[frame, old] + velocity[frame, old]
        away = np.linalg.norm(ahead[:, None] - x[frame + 1, new], axis=-1)
        for k, p in zip(*linear_sum_assignment(np.minimum(away, 2 * reach)), strict=True):
            if away[k, p] < reach:
                former[track[frame + 1, new[p]]] = former[track[frame, old[k]]]
                velocity[frame + 1, new[p]] = x[frame + 1, new[p]] - x[frame, old[k]]
    _, compact = np.unique(former, return_inverse=True)
    return np.where(track >= 0, compact[track], -1)
