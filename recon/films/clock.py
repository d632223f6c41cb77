"""Finds evenly spaced frames for a film whose pictures may have been taken unevenly."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.detections.records import Row

_EVEN = 0.2
"""Largest distance (frames) of pictures from an even clock; phones round their times by less."""
_GAP = 2.5
"""Largest distance (frames) of two pictures between which keypoints are interpolated."""


@dataclass(frozen=True)
class FilmClock:
    """Evenly spaced frames, numbered from 0, that stand for the pictures of a film."""

    rate: float
    """Frames per second of the recording."""
    frames: int
    """Number of frames from the first picture to the last."""
    speed: float
    """Seconds of the film's time stamps per second of the recording; 8 for 240 Hz shown at 30."""
    largest_offset: float
    """The largest distance of a picture from the nearest frame of the clock, in frames."""

    @property
    def is_even(self) -> bool:
        """Whether pictures were taken at the clock's frames, apart from dropped frames."""
        return self.largest_offset <= _EVEN

    def time(self, stamp: float) -> float:
        """Convert a time stamp to seconds of the recording, both since the first picture."""
        return stamp / self.speed

    def number(self, time: float) -> int:
        """Return the number of the frame nearest to a time (s) of the recording."""
        return round(time * self.rate)


def clock_of_stamps(
    stamps: Float[np.ndarray, " pictures"], recorded_rate: float | None = None
) -> FilmClock:
    """Find the even clock of pictures from their rising time stamps (s).

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
    shown_rate = count / span
    frame_numbers = (stamps - stamps[0]) * shown_rate
    offset = float(np.abs(frame_numbers - np.rint(frame_numbers)).max())
    rate = shown_rate if recorded_rate is None else recorded_rate
    return FilmClock(rate, count + 1, speed=rate / shown_rate, largest_offset=offset)


def resampled_at_even_times(rows: list[Row], times: Mapping[int, float], rate: float) -> list[Row]:
    """Interpolate one person's keypoints from the times of pictures to frames of an even clock.

    Args:
        rows: keypoints of the person in pictures, by frame.
        times: when the picture of every frame was taken, seconds.
        rate: frames of the clock per second.
    """
    if len(rows) < 2:
        return rows
    taken = np.array([times[number] for number, _, _ in rows]) * rate
    points = np.stack([keypoints for _, keypoints, _ in rows])
    numbers = np.arange(np.ceil(taken[0] - _EVEN), np.floor(taken[-1] + _EVEN) + 1)
    after = np.clip(np.searchsorted(taken, numbers), 1, len(taken) - 1)
    step = taken[after] - taken[after - 1]
    share = np.clip((numbers - taken[after - 1]) / step, 0.0, 1.0)
    joined = step <= _GAP
    kept = joined | (np.minimum(share, 1 - share) * step <= _EVEN)
    numbers, after, share = (
        numbers[kept],
        after[kept],
        np.where(joined, share, share.round())[kept],
    )
    weight = share[:, None, None]
    mixed = (1 - weight) * points[after - 1] + weight * points[after]
    sure = np.stack([points[after - 1, :, 2], points[after, :, 2]])
    mixed[..., 2] = np.where(
        weight[..., 0] == 0, sure[0], np.where(weight[..., 0] == 1, sure[1], sure.min(0))
    )
    person = rows[0][2]
    return [
        (int(number), keypoints, person) for number, keypoints in zip(numbers, mixed, strict=True)
    ]
