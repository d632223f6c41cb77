"""The even clock of a film whose pictures were taken at any times."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_EVEN = 0.2
"""Frames that the times of a film may be off an even clock; phones round theirs by less."""


@dataclass(frozen=True)
class FilmClock:
    """Evenly spaced times near those of the pictures."""

    rate: float
    """Frames per second of the recording."""
    frames: int
    """Number of frames from the first picture to the last."""
    speed: float
    """Seconds of the film's time stamps per second of the recording; 8 for 240 Hz shown at 30."""
    off: float
    """The largest distance of a picture from its frame of the clock, in frames."""

    @property
    def even(self) -> bool:
        """Whether the pictures were taken at the clock's frames, but for dropped ones."""
        return self.off <= _EVEN

    def time(self, stamp: float) -> float:
        """Seconds of the recording at a time stamp, both since the first picture."""
        return stamp / self.speed

    def number(self, time: float) -> int:
        """The nearest frame of the clock to a time of the recording."""
        return round(time * self.rate)


def clock_of_stamps(
    stamps: Float[np.ndarray, " pictures"], recorded_rate: float | None = None
) -> FilmClock:
    """The clock of pictures with these time stamps, seconds, rising.

    A step between two pictures counts as many frames as it has median steps, so that a dropped
    picture leaves a gap, and rounded stamps (33, 33, 34 ms) do not add up.

    Args:
        stamps: of two or more pictures.
        recorded_rate: pictures per second that the camera took, where the film is played at
            another rate; None where the stamps are true.
    """
    steps = np.diff(stamps)
    frames = np.rint(steps / np.median(steps))
    span, count = float(stamps[-1] - stamps[0]), max(int(frames.sum()), 1)
    played = count / span
    off = np.abs((stamps - stamps[0]) * played - np.append(0.0, np.cumsum(frames))).max()
    rate = played if recorded_rate is None else recorded_rate
    return FilmClock(rate=rate, frames=count + 1, speed=rate / played, off=float(off))
