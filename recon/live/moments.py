"""Checks the frames pushed into a stream: one frame per sensor, always with the same points."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from observations.moments import (
    Tracker,
    checked_for_stream,
    frame_from_array,
    frames_between,
    with_points_hidden,
)
from recon.core.arrays import Numbers, finite_number
from recon.core.errors import ObservationError
from recon.core.struct import TensorStruct

MomentLike = Tracker | Sequence[Tracker] | Numbers | Sequence[Numbers]
"""One moment: an observation of one moment or one per sensor; or their arrays, (points, 3) metres
of points in space, or u, v and confidence of keypoints, NaN where nothing was seen."""


@dataclass(frozen=True)
class Moment:
    """The data of all sensors of a stream at one time, without an axis of clips."""

    time: float
    seen: tuple[Tracker, ...]

    @property
    def empty(self) -> bool:
        """Whether no sensor saw any point."""
        return not any(bool(one.shown.any()) for one in self.seen)


@dataclass(frozen=True)
class StreamSensors:
    """The sensors of a stream, each with one frame that later frames must match in form."""

    trackers: tuple[Tracker, ...]

    @classmethod
    def of(cls, given: Any) -> "StreamSensors":
        """Return the sensors of a stream, made from one observation per sensor, of any length.

        Raises:
            ObservationError: when there is none, one is no named points or no calibrated camera,
                or their rates differ.
        """
        seen = _as_tuple(given)
        if len(seen) == 0:
            raise ObservationError("expected at least one observation, got none")
        sensors = tuple(checked_for_stream(one) for one in seen)
        if len(rates := sorted({one.fps for one in sensors})) > 1:
            raise ObservationError(
                f"the sensors of a stream need one rate, got {', '.join(f'{r:g}' for r in rates)} "
                "Hz; give each its own stream, or bring them to one clock first"
            )
        return cls(tuple(frames_between(one, 0, 1) for one in sensors))

    @property
    def fps(self) -> float:
        """Moments per second."""
        return self.trackers[0].fps

    @property
    def empty_moment(self) -> tuple[Tracker, ...]:
        """One frame per sensor in which no point is visible."""
        return tuple(with_points_hidden(one) for one in self.trackers)

    def moment(self, given: Any, time: float | None, next_time: float) -> Moment:
        """Check the data of one push and return them as one moment of all sensors.

        Args:
            given: a `MomentLike`.
            time: seconds; None takes the observation's, or `next_time` if that is zero.
            next_time: seconds, used if neither `time` nor the data state a time.

        Raises:
            ObservationError: when the data do not match the sensors.
        """
        are_arrays = isinstance(given, Tensor) or not (
            isinstance(given, TensorStruct)
            or (isinstance(given, Sequence) and all(isinstance(g, TensorStruct) for g in given))
        )
        if are_arrays:
            several = len(self.trackers) > 1
            rows: Any = given if several else [given]
            self._check_count(rows)
            seen = tuple(
                frame_from_array(s, row) for s, row in zip(self.trackers, rows, strict=True)
            )
            return Moment(next_time if time is None else finite_number(time, "time"), seen)
        rows = _as_tuple(given)
        self._check_count(rows)
        seen = tuple(_checked_like(s, row) for s, row in zip(self.trackers, rows, strict=True))
        starts = [one.start_time for one in seen]
        if max(starts) - min(starts) > 0.5 / self.fps:
            raise ObservationError(
                f"the observations of one push are {max(starts) - min(starts):.3f} s apart, more "
                "than half a frame; push the moments of all sensors together"
            )
        if time is None:
            time = starts[0] if starts[0] != 0 else next_time
        return Moment(finite_number(time, "time"), seen)

    def _check_count(self, rows: Any) -> None:
        if len(rows) != len(self.trackers):
            raise ObservationError(
                f"expected one moment of each of {len(self.trackers)} sensors, got {len(rows)}"
            )


def _as_tuple(given: Any) -> tuple[Any, ...]:
    return (given,) if isinstance(given, TensorStruct) else tuple(given)


def _checked_like(sensor: Tracker, given: Any) -> Tracker:
    """Return one frame of data after checking that its kind, rate and points are the sensor's."""
    if type(given) is not type(sensor):
        raise ObservationError(
            f"expected {type(sensor).__name__} as before, got {type(given).__name__}"
        )
    one = checked_for_stream(given)
    if one.moments != 1:
        raise ObservationError(f"expected one moment, got {one.moments}; push them one by one")
    if one.fps != sensor.fps:
        raise ObservationError(f"expected {sensor.fps:g} Hz as before, got {one.fps:g}")
    before, after = sensor.point_ids, one.point_ids
    if before != after:
        raise ObservationError(
            f"the points changed: expected the {len(before)} former points in their order, got "
            f"{len(after)}; mark points that are not seen as missing, or begin another stream"
        )
    return sensor.derived(start_time=one.start_time, **one.map_frames(lambda tensor: tensor))
