"""`recon.Stream`: takes one frame at a time, returns the body `lag` frames earlier."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import torch

from observations.moments import Tracker
from priors.pose.prior import PosePrior
from recon.api.given import BodyLike, ShapeLike, body_given, shape_given
from recon.api.preview import loaded_look
from recon.core.arrays import positive_number
from recon.core.errors import ObservationError, ReconError, WeightsError
from recon.core.plugins import LOOKS, registered_places
from recon.diagnosis.findings import Finding
from recon.fitting.methods import loaded_prior
from recon.live.beginning import KnownShape
from recon.live.moments import Moment, MomentLike, StreamSensors
from recon.live.preview import PreviewTracking
from recon.live.tracking import LiveEstimate, Tracking
from recon.method.looks import Look
from recon.method.priors import USUAL_NOISE, Prior, is_prior
from recon.method.protocols import REFERENCE_FPS

GONE_S = 0.5
"""Seconds without points after which the person has left, and by which a clock may jump."""


_RATE_TOLERANCE = 0.1
"""Share by which a rate may differ from that of a prior over steps."""


class Stream:
    """Estimates the motion of a person live, by fixed-lag smoothing of pushed frames.

    Every push moves the newest frames a little towards the likeliest motion, given the frames
    that are final. An estimate is final when `lag` moments after it have been seen; it is never
    changed, and later estimates continue the motion smoothly.

    A stream survives bad input. What cannot be used raises `ObservationError` and changes nothing:
    push the next moment as if the bad one had been dropped. What can be used with a caveat (late
    and dropped moments, jumps of the clock, points in impossible places, the person leaving and
    returning) is reported in `LiveEstimate.findings`.
    """

    def __init__(
        self,
        prior: str | Prior[Any] | Look = "pose",
        lag: int = 15,
        *,
        template: Tracker | Sequence[Tracker] | None = None,
        noise: float | Sequence[float | None] | None = None,
        shape: ShapeLike | None = None,
        body: BodyLike = None,
    ) -> None:
        """Create a stream without data.

        Args:
            prior: `pose`, or `humor`, which needs 30 moments a second, takes about four times as
                long and is more accurate except for the fastest motions; or a loaded prior. With
                `look`, or a `recon.method.Look`, nothing is fitted: estimates are a network's
                proposals, for named points in space and calibrated views at any rate.
            lag: frames after which an estimate is final; 0 gives the newest.
            template: an observation, or one per sensor, that says what pushed arrays mean; its
                data are not used. None where observations are pushed.
            noise: standard deviation of every coordinate, metres or, of keypoints, pixels; None
                estimates it from the first moments.
            shape: shape coefficients that are held, or a motion that has them; None learns them
                from the first seconds and holds them then.
            body: a body, a SMPL-family file, or None for the bundled body.

        Raises:
            ReconError: for what is no lag, prior, shape or sensor of a stream.
            FileNotFoundError: when there is no such body.
        """
        if not isinstance(lag, int) or not 0 <= lag <= 120:
            raise ReconError(f"lag: expected 0 to 120 frames, got {lag!r}")
        self._lag = lag
        self._body = body_given(body).to(dtype=torch.float32, device="cpu")
        self._set_prior(prior)
        rows = noise if isinstance(noise, Sequence) else (noise,)
        known = tuple(None if one is None else positive_number(one, "noise") for one in rows)
        self._noise = known if isinstance(noise, Sequence) else known[0]
        held = None if shape is None else shape_given(shape, self._body)
        self._person = KnownShape(held)
        self._sensors = (
            None if template is None else self._checked_sensors(StreamSensors.of(template))
        )
        self._tracking: Tracking | PreviewTracking | None = None
        self._last: float | None = None
        self._only_first_pushed = False  # true while only the first moment was pushed
        self._jumped_to: float | None = None
        self._last_returned: float | None = None
        self._findings: list[Finding] = []

    def _set_prior(self, prior: str | Prior[Any] | Look) -> None:
        """Load the prior of the fit, or the network whose proposals are the estimates."""
        self._look: Look | None = None
        self._prior: Prior[Any] | None = None
        named = prior in registered_places(LOOKS) if isinstance(prior, str) else callable(prior)
        if named and not is_prior(prior):
            self._look = loaded_look(cast(Any, prior), "open", self._body)
            return
        found: Any = loaded_prior(prior, "open", self._body) if isinstance(prior, str) else prior
        live = getattr(found, "live", None)
        if not isinstance(found, PosePrior) and (live is None or live(USUAL_NOISE) is None):
            raise WeightsError(
                "prior: expected 'pose', 'humor', 'look' or a prior with live(noise), got "
                f"{prior if isinstance(prior, str) else type(prior).__name__!r}"
            )
        poses = found if isinstance(found, PosePrior) else PosePrior.load()
        self._poses = poses.to(dtype=torch.float32)
        self._prior = None if isinstance(found, PosePrior) else found

    @property
    def lag(self) -> int:
        """Frames after which an estimate is final."""
        return self._lag

    def push(self, seen: MomentLike, time: float | None = None) -> LiveEstimate | None:
        """Add a moment; return the newest estimate that is now final, or None if there is none.

        Args:
            seen: one moment: an observation, or one per sensor; or arrays, where the stream has a
                template: (points, 3) metres, or u, v, confidence; NaN where nothing was seen.
            time: seconds; None takes the observation's `start_time`, or, where that is zero, one
                frame after the last moment.

        Raises:
            ObservationError: when the data do not match the sensors of earlier moments. They are
                not used, and the next moment can be pushed.
        """
        with torch.no_grad():
            return self._push_moment(seen, time)

    def finish(self) -> tuple[LiveEstimate, ...]:
        """Return the estimates that are not final yet, and reset the stream for new data."""
        with torch.no_grad():
            newest = self._newest_with_findings(self._end_tracking())
            self._last = self._last_returned = None
            return () if newest is None else (*newest.earlier, replace(newest, earlier=()))

    def _push_moment(self, seen: Any, time: float | None) -> LiveEstimate | None:
        if self._sensors is None and not _is_observation(seen):
            raise ObservationError(
                "arrays do not name their points: give Stream(template=...), an observation that "
                "names them, or push observations"
            )
        last = self._last
        try:
            sensors = self._sensors or self._checked_sensors(StreamSensors.of(seen))
            moment = sensors.moment(seen, time, 0.0 if last is None else last + 1 / sensors.fps)
        except ObservationError:
            raise
        except Exception as error:  # after bad input the stream continues with the next moment
            raise ObservationError(
                f"the data do not fit the sensors of this stream: {error!s:.300}"
            ) from error
        self._sensors = sensors
        if last is None:
            steps = 1
        elif abs(moment.time - last) > GONE_S:
            return self._after_clock_jump(moment, last, sensors)
        else:
            steps = math.floor((moment.time - last) * sensors.fps + 0.5)
        self._jumped_to = None
        if steps < 1 and self._only_first_pushed:
            # if the first time is wrong, all later moments would seem late: begin with the second
            self._end_tracking()
            self._last = None
            self._add_finding(
                "frame order",
                f"the first moment, at {last:.3f} s, was left out: the second is at "
                f"{moment.time:.3f} s",
            )
            return self._push_in_sequence([moment], sensors)
        if steps < 1:
            self._insert_late(moment, -steps)
            return None
        before = moment.time if last is None else last
        gap = moment.time - before
        between = [Moment(before + gap * k / steps, sensors.empty_moment) for k in range(1, steps)]
        if between:
            self._add_finding(
                "gap", f"{len(between)} moments before {moment.time:.3f} s are missing"
            )
        return self._push_in_sequence([*between, moment], sensors)

    def _push_in_sequence(
        self, moments: list[Moment], sensors: StreamSensors
    ) -> LiveEstimate | None:
        """Add moments that follow the last; return the newest estimate that becomes final."""
        self._only_first_pushed = self._last is None
        self._last = moments[-1].time
        tracking = self._tracking
        if tracking is None:
            if moments[-1].empty:
                return None
            tracking = self._tracking = self._new_tracking(sensors)
            moments = moments[-1:]
        done = tracking.push(moments, self._findings)
        if tracking.unseen > GONE_S * sensors.fps:
            self._add_finding(
                "gap", f"at {self._last:.3f} s, nobody has been seen for {GONE_S:g} s"
            )
            done += self._end_tracking()
        return self._newest_with_findings(done)

    def _insert_late(self, moment: Moment, frames_back: int) -> None:
        """Store a late moment `frames_back` frames before the last, unless that frame has data."""
        inserted = self._tracking is not None and self._tracking.insert(moment, frames_back)
        late = "late and was put in" if inserted else f"after {self._last:.3f} s and was left out"
        self._add_finding("frame order", f"the moment {moment.time:.3f} s came {late}")

    def _after_clock_jump(
        self, moment: Moment, last: float, sensors: StreamSensors
    ) -> LiveEstimate | None:
        """Handle a jump of the clock: skip one such moment, start anew if the next confirms it.

        Raises:
            ObservationError: when the clock jumps from every moment to the next.
        """
        jumped_to = self._jumped_to
        self._jumped_to = moment.time
        if jumped_to is not None and abs(moment.time - jumped_to) > GONE_S:
            raise ObservationError(
                f"expected times in seconds, {1 / sensors.fps:.3f} apart, got {last:.6g}, "
                f"{jumped_to:.6g} and {moment.time:.6g}; divide milliseconds by 1000"
            )
        if jumped_to is None:
            self._add_finding(
                "jump",
                f"the clock jumped from {last:.3f} s to {moment.time:.3f} s; the moment was left "
                "out, and the next one tells whether time goes on there",
            )
            return None
        newest = self._newest_with_findings(self._end_tracking())
        self._last = self._jumped_to = self._last_returned = None
        self._add_finding("jump", f"time goes on at {moment.time:.3f} s, after {last:.3f} s")
        after = self._push_in_sequence([moment], sensors)
        assert after is None, "a first motion takes several moments"
        return newest

    def _checked_sensors(self, sensors: StreamSensors) -> StreamSensors:
        """Return the sensors after checking that their rate and number suit prior and noise.

        Raises:
            ObservationError: when the prior needs another rate, or `noise` another number.
        """
        if self._prior is not None and abs(sensors.fps / REFERENCE_FPS - 1) > _RATE_TOLERANCE:
            raise ObservationError(
                f"this prior knows steps of 1/30 s: expected 30 moments a second, got "
                f"{sensors.fps:g}; push moments of that rate, or take prior='pose'"
            )
        count = len(sensors.trackers)
        if isinstance(self._noise, tuple) and len(self._noise) != count:
            raise ObservationError(
                f"noise: expected one number for each of {count} sensors, got {len(self._noise)}"
            )
        return sensors

    def _new_tracking(self, sensors: StreamSensors) -> Tracking | PreviewTracking:
        noise = self._noise
        rows = noise if isinstance(noise, tuple) else (noise,) * len(sensors.trackers)
        if self._look is not None:
            return PreviewTracking(sensors, self._lag, rows, self._person, self._body, self._look)
        return Tracking(
            sensors, self._lag, rows, self._person, self._body, self._poses, self._prior
        )

    def _end_tracking(self) -> list[LiveEstimate]:
        """End the person's tracking, keep their shape, and return estimates not yet returned."""
        tracking, self._tracking = self._tracking, None
        if tracking is None:
            return []
        done = tracking.finish(self._findings)
        self._person = tracking.known_shape()
        return done

    def _newest_with_findings(self, done: list[LiveEstimate]) -> LiveEstimate | None:
        """Return the newest estimate, with the earlier ones and the findings in its fields."""
        last = self._last_returned
        done = [one for one in done if last is None or one.time > last]
        if not done:
            return None
        self._last_returned = done[-1].time
        findings, self._findings = tuple(self._findings), []
        return replace(done[-1], earlier=tuple(done[:-1]), findings=findings)

    def _add_finding(self, code: Any, message: str) -> None:
        self._findings.append(Finding(code, message))


def _is_observation(given: Any) -> bool:
    """Return whether pushed data are observations rather than arrays."""
    first = given[0] if isinstance(given, list | tuple) and given else given
    return hasattr(first, "start_time")
