"""3D keypoints as a file holds them: its own unit and axes, and its own names, if it has any."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import FRAME_RATE, FRAMES, JOINTS
from recon.core.units import snapped_rate

_LARGEST = 1e7
"""Coordinate of a point ten kilometres away, in millimetres."""


@dataclass(frozen=True)
class Points3D:
    """Points in space over time, before it is known what they measure."""

    name: str
    positions: Float[np.ndarray, "time points 3"]
    """Coordinates in the file's own unit and axes; NaN where a point was not seen."""
    names: tuple[str, ...] | None = None
    """Labels of the file; None where an array has none."""
    layout: str | None = None
    """Layout of the keypoints, where the format states it."""
    fps: float | None = None
    """Moments per second; None where the file does not state it."""
    start_time: float = 0.0
    """Time of the first moment, seconds."""
    unit: str | None = None
    """Unit that the file or its format states, one of `recon.core.units.METRES`."""
    decisions: tuple[str, ...] = ()
    """What was read or guessed, one sentence each."""


def checked(points: Points3D) -> Points3D:
    """The points, once there are any, and as NaN what stands for a missing one.

    Exact zeros in all three coordinates and infinity are missing points too, unless they are the
    same point in all moments: the origin of what is relative to it.

    Raises:
        ValueError: when there are too many, or none at all is seen.
    """
    moments, count = points.positions.shape[:2]
    JOINTS.check(count, points.name)
    if moments == 0 or count == 0:
        raise FormatError(f"{points.name}: expected at least one frame with keypoints, got none")
    FRAMES.check(moments, points.name)
    seen = np.isfinite(points.positions).all(-1)
    zero = (points.positions == 0).all(-1)
    seen &= ~zero | zero.all(0)
    if not seen.any() or zero.all():
        raise FormatError(f"{points.name}: expected keypoints, but none is seen in any frame")
    largest = float(np.abs(points.positions[seen]).max())
    if largest > _LARGEST:
        raise FormatError(
            f"{points.name}: expected coordinates of a person, of at most {_LARGEST:g} in any "
            f"unit, got {largest:.3g}"
        )
    positions = np.where(seen[..., None], points.positions, np.nan)
    return Points3D(**{**vars(points), "positions": positions})


def rate_of(times: Sequence[float] | np.ndarray, name: str) -> tuple[float, float, str] | None:
    """Frames per second and the first time of a column of seconds, and what is said about it.

    None where the column tells no rate: a single time, or times that do not rise.
    """
    values = np.asarray(times, dtype=np.float64)
    steps = np.diff(values)
    if len(steps) == 0 or not np.isfinite(values).all() or (steps <= 0).any():
        return None
    middle = float(np.median(steps))
    fps = snapped_rate((len(values) - 1) / float(values[-1] - values[0]))
    if not FRAME_RATE.holds(fps) or np.abs(steps - middle).max() > middle / 2:
        return None
    return fps, float(values[0]), f"{fps:g} frames per second: by the times in {name}"
