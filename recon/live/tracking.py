"""Tracking of one person: frames collected for a first motion, then smoothed one by one."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.moments import (
    Tracker,
    points_coincide,
    replace_frame,
    with_points_hidden,
)
from priors.pose.prior import PosePrior
from recon.body.contacts import contact_probabilities, rest_heights
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.diagnosis.findings import Finding
from recon.live.beginning import KnownShape, first_window
from recon.live.moments import Moment, StreamSensors
from recon.live.smoother import SmoothedWindow
from recon.method.priors import Prior


@dataclass(frozen=True)
class LiveEstimate:
    """The estimated body at one moment, which later pushes do not change."""

    time: float
    """Time of the moment, seconds on the clock of the observations."""
    translation: Float[Tensor, "3"]
    """SMPL translation, metres."""
    rotations: Float[Tensor, "22 3 3"]
    """Rotation of every joint relative to its parent; the first is the root in the world."""
    joints: Float[Tensor, "22 3"]
    """Places of the joints in the world, metres."""
    shape: Float[Tensor, " shape"]
    """Shape coefficients as they are known by now."""
    observed: Bool[Tensor, " 22"]
    """Joints whose place an observation of this moment tells."""
    contacts: Float[Tensor, " 22"] | None
    """Probability that a joint touches the ground, by its height and speed; None under the pose
    prior, which knows no ground."""
    earlier: tuple["LiveEstimate", ...] = ()
    """Estimates of moments before this one that became final at the same time: those of the
    beginning, and moments that the sensor dropped."""
    findings: tuple[Finding, ...] = ()
    """What was noticed in the data since the estimate before: late, dropped and unusable moments,
    jumps of the clock, points in impossible places, the person leaving and returning."""

    @property
    def every(self) -> tuple["LiveEstimate", ...]:
        """The earlier estimates and this one, in the order of time."""
        return (*self.earlier, self)


BEGINNING = 15
"""Moments from which a first motion is fitted, at least: they tell noise and posture."""
_BEYOND = 4
"""Frames older than the lag that are still moved: what is final later than a frame moves it."""
_MAX_DEVIATION_M, _MAX_SPEED_M_S = 0.5, 10.0
"""Metres, and metres per second since the last moment with points, that a point may lie from where
it is expected. Nobody moves so fast."""
_PERSISTS = 0.3
"""Seconds after which points in an impossible place are taken for the person."""
_UNDERGROUND_M, _FLOATS_M = -0.3, 0.6
"""Heights (m) of the lowest joint beyond which, in all first frames, axes or floor are wrong."""
_MIN_MOMENTS = 5
"""Moments with points of which a motion is made when no more come."""
_LEARNED = 300
"""Frames after which the shape is held."""


@dataclass
class TrackedPerson:
    """The settings of a stream's tracking: sensors, lag, noise, body, and known shape."""

    sensors: StreamSensors
    lag: int
    noise: tuple[float | None, ...]
    person: KnownShape
    body: BodyModel

    @cached_property
    def _located_joints(self) -> list[Bool[np.ndarray, "points 22"]]:
        return [one.located_joints(self.body) for one in self.sensors.trackers]

    def joints_seen(self, seen: Sequence[Tracker], row: int) -> Bool[np.ndarray, " 22"]:
        """Return a mask of the joints that the data of one frame locate."""
        found = np.zeros(22, dtype=bool)
        for one, shown in zip(seen, self._located_joints, strict=True):
            found |= one.shown[row].numpy() @ shown
        return found


@dataclass
class Tracking(TrackedPerson):
    """Tracks the visible person of a stream: collects frames, fits a first motion, smooths it."""

    poses: PosePrior
    prior: Prior[Any] | None = None
    """The prior over steps, beside the density of poses."""
    gathered: list[Moment] = field(default_factory=list)
    """Moments before the first motion, later those whose points were outliers."""
    smoothed: SmoothedWindow | None = None
    times: list[float] = field(default_factory=list)
    """Seconds of every frame of the window."""
    final: int = 0
    """Number of leading frames of the window whose estimates were returned."""
    since_seen: int = 0
    """Moments since points were seen, once there is a motion."""

    @property
    def _current_window(self) -> SmoothedWindow:
        """The smoothed window; asserts that the first motion was fitted."""
        assert self.smoothed is not None
        return self.smoothed

    def push(self, moments: list[Moment], findings: list[Finding]) -> list[LiveEstimate]:
        """Add consecutive moments; return the estimates that become final."""
        if self.smoothed is None:
            self.gathered += moments
            while self.gathered and self.gathered[0].empty:
                self.gathered.pop(0)
            if len(self.gathered) < max(BEGINNING, self.lag + 1) or self.gathered[-1].empty:
                return []
            return self._final_estimates(self.lag) if self._fit_first_motion(findings) else []
        for moment in moments:
            self._add_moment(moment, findings)
        if len(self.gathered) > max(_PERSISTS * self.sensors.fps, 2):
            return self._restart_at_rejected(findings)
        window = self._current_window
        if self.prior is not None:
            window = window.newest_refined_by_poses()
        self.smoothed = window.refined(1)
        return self._final_estimates(self.lag)

    def insert(self, moment: Moment, back: int) -> bool:
        """Store late data `back` frames before the last; return False if that frame has data."""
        if self.smoothed is None:
            row = len(self.gathered) - 1 - back
            if row < 0 or not self.gathered[row].empty:
                return False
            self.gathered[row] = moment
            return True
        row = self.smoothed.active_frames - 1 - back
        if row < 0 or self.joints_seen(self.smoothed.seen, row).any():
            return False
        seen = tuple(
            replace_frame(a, row, b) for a, b in zip(self.smoothed.seen, moment.seen, strict=True)
        )
        self.smoothed = replace(self.smoothed, seen=seen)
        self.times[len(self.times) - 1 - back] = moment.time
        return True

    @property
    def unseen(self) -> int:
        """Number of moments since any point was seen."""
        if self.smoothed is not None:
            return self.since_seen
        empty = [moment.empty for moment in reversed(self.gathered)]
        return empty.index(False) if False in empty else 0

    def finish(self, findings: list[Finding]) -> list[LiveEstimate]:
        """Return the estimates that are not final yet, up to the last frame with points."""
        if self.smoothed is None:
            several = sum(not moment.empty for moment in self.gathered) >= _MIN_MOMENTS
            if not several or not self._fit_first_motion(findings):
                return []
        while self.since_seen > 0 and len(self.times) > self.final:
            self.since_seen -= 1
            self.times.pop()
        return self._final_estimates(0)

    def known_shape(self) -> KnownShape:
        """Return what is known of the person's shape so far."""
        now = self.smoothed
        if now is None:
            return self.person
        return KnownShape(now.objective.shape, now.knowledge if now.learning else None)

    def _fit_first_motion(self, findings: list[Finding]) -> bool:
        """Fit a first motion to the collected moments; return whether that succeeded."""
        self.since_seen = self.unseen
        try:
            first = first_window(
                self.gathered, self.noise, self.person, self.body, self.poses, self.prior
            )
        except ReconError as error:
            times = f"{self.gathered[0].time:.3f} s to {self.gathered[-1].time:.3f} s"
            findings.append(
                Finding("unseen", f"no motion can be begun with the moments {times}: {error}")
            )
            self.gathered = []
            return False
        lowest = first.objective.posed(first.window)[2][..., 2].amin(-1)
        if float(lowest.max()) < _UNDERGROUND_M or float(lowest.min()) > _FLOATS_M:
            height = float(lowest.median())
            said = (
                f"the body's lowest joint is at z = {height:.2f} m; moments are in metres, with z "
                "up and the ground at z = 0"
            )
            findings.append(Finding("floor", said, value=height))
        self.smoothed = first
        self.times = [moment.time for moment in self.gathered]
        self.gathered = []
        return True

    def _add_moment(self, moment: Moment, findings: list[Finding]) -> None:
        most = self.lag + 1 + _BEYOND
        after = self._current_window.with_new_frame(self.sensors.empty_moment, most, _LEARNED)
        self.times.append(moment.time)
        dropped = len(self.times) - after.window.frames
        self.times, self.final = self.times[dropped:], max(self.final - dropped, 0)
        seen, share = self._without_outliers(after, moment)
        if share > 0.5:
            self.gathered.append(moment)
        elif any(bool(one.shown.any()) for one in seen):
            self.gathered = []
        if share > 0:
            findings.append(
                Finding(
                    "outliers",
                    f"at {moment.time:.3f} s, {share:.0%} of the points lie where the person "
                    "cannot be; they were left out",
                    value=share,
                )
            )
        self.since_seen = 0 if any(bool(s.shown.any()) for s in seen) else self.since_seen + 1
        rows = tuple(
            replace_frame(a, after.active_frames - 1, b)
            for a, b in zip(after.seen, seen, strict=True)
        )
        self.smoothed = replace(after, seen=rows)

    def _without_outliers(
        self, predicted: SmoothedWindow, moment: Moment
    ) -> tuple[tuple[Tracker, ...], float]:
        """Return a moment with outliers hidden, and the share of its points that are outliers."""
        if moment.empty:
            return moment.seen, 0.0
        _, orientations, joints = predicted.objective.posed(predicted.window[-1:])
        allowed = _MAX_DEVIATION_M + _MAX_SPEED_M_S * self.since_seen / self.sensors.fps
        kept: list[Tracker] = []
        seen = far = 0
        for points, one in zip(predicted.objective.points, moment.seen, strict=True):
            away = one.distances(points.positions(orientations, joints))
            bad = one.shown & ((away > allowed) | points_coincide(one))
            seen, far = seen + int(one.shown.sum()), far + int(bad.sum())
            kept.append(with_points_hidden(one, bad) if bool(bad.any()) else one)
        share = far / max(seen, 1)
        return (self.sensors.empty_moment if share > 0.5 else tuple(kept)), share

    def _restart_at_rejected(self, findings: list[Finding]) -> list[LiveEstimate]:
        """End this motion and restart tracking from points that were outliers for 0.3 s."""
        rejected = self.gathered
        self.since_seen = len(rejected)
        done = self.finish(findings)
        findings.append(
            Finding(
                "jump",
                f"from {rejected[0].time:.3f} s on, the person is somewhere else; the motion "
                "begins anew there",
            )
        )
        self.person, self.smoothed, self.times, self.final = self.known_shape(), None, [], 0
        self.since_seen, self.gathered = 0, rejected
        return done

    def _final_estimates(self, lag: int) -> list[LiveEstimate]:
        now, stop = self._current_window, len(self.times) - lag
        rows = range(self.final, stop)
        if len(rows) == 0:
            return []
        # include one more frame on either side, to compute speeds
        first = max(self.final - 1, 0)
        objective, own = now.objective, slice(self.final - first, stop - first)
        rotations, _, places = objective.posed(now.window[first : stop + 1])
        held, contacts = now.window.frames - now.active_frames, None
        if objective.steps is not None:
            heights = rest_heights(self.body, objective.shape)
            contacts = contact_probabilities(places, heights, objective.fps)[own]
        self.final = stop
        return [
            LiveEstimate(
                time=self.times[row],
                translation=now.window.translation[row],
                rotations=rotations[own][k],
                joints=places[own][k],
                shape=objective.shape,
                observed=torch.from_numpy(self.joints_seen(now.seen, row - held)),
                contacts=None if contacts is None else contacts[k],
            )
            for k, row in enumerate(rows)
        ]
