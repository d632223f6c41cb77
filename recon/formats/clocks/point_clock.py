"""Frame numbers of clouds that a clock gave: put on a clock of frames, so that few are empty.

Sensors that stamp their images with a running clock number frames honestly by its ticks: the
numbers begin anywhere and are far apart. Everything after the reader keeps one place per frame,
so ticks would take memory by the thousand; here they become frames before any is taken.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from recon.core.limits import FRAME_RATE
from recon.formats.clocks.scan_times import crowded, frames_of


@dataclass(frozen=True)
class PointClock:
    """Times at which points were seen."""

    frame: Int[np.ndarray, " points"]
    """The frame of each point, from 0."""
    fps: float
    start_time: float
    """Seconds, of frame 0."""
    decisions: tuple[str, ...] = ()
    """What was changed."""


def settled_clock(
    frame: Int[np.ndarray, " points"], fps: float, start_time: float, path: Path
) -> PointClock:
    """Frames of a clock on which not nearly all are empty.

    Numbers that are close to each other stay as they are. Others are counted from the first one
    and by their greatest common divisor, which changes no time; where that does not help, their
    times are put on an even clock as those of scans are (`frames_of`).

    Raises:
        ValueError: when they lie on no clock, because of a long gap or because two are closer
            than any camera's frames.
    """
    numbers, place = np.unique(frame, return_inverse=True)
    if crowded(int(numbers[-1]) + 1, len(numbers)):
        FRAME_RATE.check(fps, path, "fps")
        return PointClock(frame, fps, start_time)
    ticks = numbers - numbers[0]
    step = max(int(np.gcd.reduce(ticks)), 1)
    ticks, rate, start = ticks // step, fps / step, start_time + float(numbers[0]) / fps
    if not crowded(int(ticks[-1]) + 1, len(ticks)):
        ticks, rate, _ = frames_of(ticks / rate, path)
    FRAME_RATE.check(rate, path, "fps and frame")
    note = (
        f"frame numbers {numbers[0]} to {numbers[-1]} at {fps:g} Hz are those of a clock: "
        f"{len(numbers)} frames with points were put on one of {rate:.4g} Hz"
    )
    return PointClock(ticks[place.reshape(-1)], rate, start, (note,))
