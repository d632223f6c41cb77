"""Tracks a person by a network alone, which proposes the motion of the latest frames anew."""

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from observations.moments import (
    Tracker,
    append_frames,
    frames_between,
    points_coincide,
    replace_frame,
    with_points_hidden,
)
from recon.api.preview import likeliest_motion, with_shape, with_triangulated_views
from recon.body.contacts import contact_probabilities, rest_heights
from recon.diagnosis.findings import Finding
from recon.live.beginning import KnownShape
from recon.live.moments import Moment
from recon.live.tracking import LiveEstimate, TrackedPerson
from recon.method.looks import Look

_BEFORE_S = 1.0
"""Seconds of moments before the newest final one that the network is shown."""
_LEARNED = 300
"""Windows whose shapes are averaged; the shape is held then."""


@dataclass
class PreviewTracking(TrackedPerson):
    """Tracks the visible person of a stream by a network alone; `Tracking` does so by fits.

    Nothing is fitted. The estimate of a moment is the network's proposal made from the window
    that ends `lag` moments later.
    """

    look: Look
    seen: tuple[Tracker, ...] = ()
    """The data of the window."""
    times: list[float] = field(default_factory=list)
    """Seconds of every moment of the window."""
    final: int = 0
    """Number of leading moments of the window whose estimates were returned."""
    unseen: int = 0
    """Moments since points were seen."""
    windows: int = 0
    """Number of windows that the shape was learned from."""
    shape: Float[Tensor, " shape"] | None = None
    """Mean shape of these windows."""
    doubted: bool | None = None
    """Whether the last window was far from what the network knows; None before the first."""

    def push(self, moments: list[Moment], findings: list[Finding]) -> list[LiveEstimate]:
        """Add consecutive moments; return the estimates that become final.

        Raises:
            ObservationError: when the network cannot use such sensors.
        """
        for moment in moments:
            new = [with_points_hidden(o) if points_coincide(o) else o for o in moment.seen]
            joined = zip(self.seen, new, strict=True) if self.seen else ()
            self.seen = tuple(append_frames(a, b) for a, b in joined) or tuple(new)
            self.times.append(moment.time)
            self.unseen = 0 if any(bool(one.shown.any()) for one in new) else self.unseen + 1
        return self._final_estimates(self.lag, findings)

    def insert(self, moment: Moment, back: int) -> bool:
        """Store late data `back` frames before the last; return False if that frame has data."""
        row = len(self.times) - 1 - back
        if row < self.final or any(bool(one.shown[row].any()) for one in self.seen):
            return False
        pairs = zip(self.seen, moment.seen, strict=True)
        self.seen = tuple(replace_frame(a, row, b) for a, b in pairs)
        self.times[row] = moment.time
        return True

    def finish(self, findings: list[Finding]) -> list[LiveEstimate]:
        """Return the estimates that are not final yet, up to the last moment with points."""
        stop = len(self.times) - self.unseen
        self.times = self.times[:stop]
        self.seen = tuple(frames_between(one, 0, stop) for one in self.seen)
        return self._final_estimates(0, findings)

    def known_shape(self) -> KnownShape:
        """Return the shape of the person as estimated so far."""
        held = self.person.shape if self.shape is None else self.shape
        return KnownShape(held)

    def _final_estimates(self, lag: int, findings: list[Finding]) -> list[LiveEstimate]:
        stop = len(self.times) - lag
        rows = range(self.final, stop)
        if len(rows) == 0:
            return []
        fps = self.sensors.fps
        given = [one.derived(start_time=0.0) for one in self.seen]
        told = zip(given, self.noise, strict=True)
        given = [o if n is None or o.view else o.derived(rms_std=n) for o, n in told]
        motion, found = likeliest_motion(
            self.look, with_triangulated_views(one[None] for one in given), self.body
        )
        self._add_findings(found.doubt, findings)
        motion = with_shape(motion, self._mean_shape(motion.shape[0]), self.body)[0]
        # include one more frame on either side, to compute speeds
        first, last = max(rows[0] - 1, 0), min(stop, len(self.times) - 1)
        times = torch.arange(first, last + 1, dtype=torch.float64) / fps
        motion = motion.at(times.clamp(max=motion.stop_time), fps)
        joints = self.body.pose(motion).joints
        contacts = contact_probabilities(joints, rest_heights(self.body, motion.shape), fps)
        estimates = [
            LiveEstimate(
                time=self.times[row],
                translation=motion.translation[row - first],
                rotations=motion.rotations[row - first],
                joints=joints[row - first],
                shape=motion.shape,
                observed=torch.from_numpy(self.joints_seen(self.seen, row)),
                contacts=contacts[row - first],
            )
            for row in rows
        ]
        self.final = stop
        self._drop_oldest(stop - 1 - round(_BEFORE_S * fps))
        return estimates

    def _add_findings(self, doubt: str | None, findings: list[Finding]) -> None:
        if self.doubted is None:
            said = "a preview: what a network proposes at first sight, not refined by a fit"
            findings.append(Finding("preview", said))
        if doubt is not None and not self.doubted:
            findings.append(Finding("unfamiliar", doubt))
        self.doubted = doubt is not None

    def _mean_shape(self, proposed: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
        """Return the shape that the caller gave, or the mean of the shapes proposed so far."""
        if self.person.shape is not None:
            return self.person.shape
        if self.windows < _LEARNED:
            self.windows += 1
            before = torch.zeros_like(proposed) if self.shape is None else self.shape
            self.shape = before + (proposed - before) / self.windows
        assert self.shape is not None
        return self.shape

    def _drop_oldest(self, count: int) -> None:
        """Remove the oldest `count` frames from the network's input window."""
        if count > 0:
            self.seen = tuple(frames_between(one, count, one.moments) for one in self.seen)
            self.times, self.final = self.times[count:], self.final - count
