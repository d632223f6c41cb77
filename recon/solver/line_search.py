"""Strong-Wolfe line searches of many independent problems, advanced one trial at a time.

The searches know only the scalars along their own ray, phi(t) = f(x + t d): the caller evaluates
every element at its own `step`, hands the values back, and reads who is finished. An element may
begin a new search while its neighbours are still within theirs. The scalars live in NumPy on the
host, where a dozen element-wise operations cost microseconds rather than kernel launches.

Bracketing and zooming are Nocedal & Wright, Numerical Optimization (2nd ed.), algorithms 3.5 and
3.6, written as one rule: an unbracketed search is a bracket whose far end is at infinity.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float64, Int64

# Each extrapolated step is between these multiples of the step before it.
EXPAND_LEAST, EXPAND_MOST = 0.1, 9.0
# Trial steps inside a bracket keep this share of its width away from both ends.
MARGIN = 0.1
# A bracket that keeps more than this share of its width over two trials is bisected (Moré 1994).
SHRINK = 0.66
# After a trial with a non-finite value, the next trial is at this fraction of its step.
RETREAT = 0.25


@dataclass(frozen=True)
class WolfeConditions:
    """Strong Wolfe conditions for accepting a step, and the limits of a line search."""

    c1: float
    """Sufficient decrease: phi(t) <= phi(0) + c1 t phi'(0)."""
    c2: float
    """Curvature: |phi'(t)| <= c2 |phi'(0)|."""
    max_trials: int
    """Evaluations after which the lowest point so far is taken."""
    resolution: float
    """Relative precision of the objective's values. A bracket so narrow that the decrease along
    it, by the slope at the origin, would be smaller is given up."""


@dataclass(frozen=True)
class TrialOutcome:
    """What one trial step of the line searches led to: four masks over the elements."""

    improved: Bool[np.ndarray, " active"]
    """The trial decreases sufficiently and is the lowest point so far."""
    finished: Bool[np.ndarray, " active"]
    """The search is over; its lowest point is the step to take."""
    unmoved: Bool[np.ndarray, " active"]
    """The search is over and found no lower point."""
    unreachable: Bool[np.ndarray, " active"]
    """Whether the element is unmoved because the objective was not finite however short the
    step."""


@dataclass
class LineSearches:
    """The brackets of all active elements, one column per element.

    An end of a bracket is the three numbers t, phi(t), phi'(t). `low` is the lowest point so far,
    at first the origin; `high` is the other end: infinite until a minimiser is known to lie
    between, and on either side of `low` afterwards.
    """

    step: Float64[np.ndarray, " active"]
    origin: Float64[np.ndarray, " active"]
    low: Float64[np.ndarray, "3 active"]
    high: Float64[np.ndarray, "3 active"]
    width: Float64[np.ndarray, " active"]
    width_before: Float64[np.ndarray, " active"]
    trials: Int64[np.ndarray, " active"]

    @classmethod
    def create(cls, value: Float64[np.ndarray, " active"]) -> "LineSearches":
        """Start line searches at step 1, given the objective at every element's start."""
        count = len(value)
        searches = cls(
            step=np.empty(count),
            origin=np.empty(count),
            low=np.empty((3, count)),
            high=np.empty((3, count)),
            width=np.empty(count),
            width_before=np.empty(count),
            trials=np.empty(count, dtype=np.int64),
        )
        searches.restart(np.ones(count, dtype=bool), value)
        return searches

    def keep(self, rows: Bool[np.ndarray, " active"]) -> None:
        """Keep only the line searches of the elements in mask `rows`."""
        for field in fields(self):
            setattr(self, field.name, getattr(self, field.name)[..., rows])

    def restart(
        self, rows: Bool[np.ndarray, " active"], value: Float64[np.ndarray, " active"]
    ) -> None:
        """Restart the line searches of the elements in mask `rows` at step 1."""
        self.step[rows] = 1.0
        self.origin[rows] = value[rows]
        self.low[0, rows] = 0.0
        self.low[1, rows] = value[rows]
        self.low[2, rows] = np.nan  # slope at the origin, unknown before the first trial
        self.high[:, rows] = np.inf
        self.width[rows] = self.width_before[rows] = np.inf
        self.trials[rows] = 0

    def advance(
        self,
        value: Float64[np.ndarray, " active"],
        slope: Float64[np.ndarray, " active"],
        origin_slope: Float64[np.ndarray, " active"],
        wolfe: WolfeConditions,
    ) -> TrialOutcome:
        """Update the brackets with phi and phi' at `step`, and choose the next `step`.

        A trial that is not finite counts as too long.
        """
        self.trials += 1
        self.low[2] = np.where(self.trials == 1, origin_slope, self.low[2])
        finite = np.isfinite(value) & np.isfinite(slope)
        trial = np.stack((self.step, value, slope))
        trial[1:, ~finite] = np.inf

        before = self.low
        enough = trial[1] <= self.origin + wolfe.c1 * self.step * origin_slope
        improved = enough & (trial[1] < before[1])
        accepted = improved & (np.abs(trial[2]) <= -wolfe.c2 * origin_slope)
        # The trial is past the minimiser: the slope towards `high` is now positive.
        turned = improved & (np.sign(trial[2]) * np.sign(self.high[0] - before[0]) >= 0)
        self.high = np.where(turned, before, np.where(improved, self.high, trial))
        self.low = np.where(improved, trial, before)

        width = np.abs(self.high[0] - self.low[0])
        unseen = width * -origin_slope <= wolfe.resolution * np.abs(self.origin)
        narrow = np.isfinite(self.high[1]) & unseen
        finished = accepted | narrow | (self.trials >= wolfe.max_trials)
        unmoved = finished & (self.low[0] == 0.0)
        self.step = np.where(
            np.isfinite(width), self._trial_in_bracket(width), self._trial_farther_out(before)
        )
        self.width_before, self.width = self.width, width
        return TrialOutcome(improved, finished, unmoved, unmoved & ~np.isfinite(self.high[1]))

    def _trial_in_bracket(
        self, width: Float64[np.ndarray, " active"]
    ) -> Float64[np.ndarray, " active"]:
        """Return next steps inside the bracket: the cubic's minimum, or a fixed fraction."""
        with np.errstate(all="ignore"):  # the cubic is undefined when an end is not finite
            gap = self.high[0] - self.low[0]
            fraction = (cubic_minimiser(self.low, self.high) - self.low[0]) / gap
            slow = width >= SHRINK * self.width_before
            halve = np.where(np.isfinite(self.high[1]), 0.5, RETREAT)
            usable = np.isfinite(fraction) & ~slow
            return self.low[0] + gap * np.where(
                usable, np.clip(fraction, MARGIN, 1 - MARGIN), halve
            )

    def _trial_farther_out(
        self, before: Float64[np.ndarray, "3 active"]
    ) -> Float64[np.ndarray, " active"]:
        """Return next, longer steps for searches whose objective still falls at `low`."""
        with np.errstate(all="ignore"):  # divisions by 0 occur only where this result is unused
            advance = self.low[0] - before[0]
            reach = (cubic_minimiser(self.low, before) - self.low[0]) / advance
            return self.low[0] + advance * np.where(
                reach > 0, np.clip(reach, EXPAND_LEAST, EXPAND_MOST), EXPAND_MOST
            )


def cubic_minimiser(
    a: Float64[np.ndarray, "3 active"], b: Float64[np.ndarray, "3 active"]
) -> Float64[np.ndarray, " active"]:
    """Return where the cubic through two points with given slopes has its minimum; nan if none.

    a and b hold t, phi(t) and phi'(t). Nocedal & Wright, equation 3.59.
    """
    d1 = a[2] + b[2] - 3 * (a[1] - b[1]) / (a[0] - b[0])
    d2 = np.sign(b[0] - a[0]) * np.sqrt(d1 * d1 - a[2] * b[2])
    return b[0] - (b[0] - a[0]) * (b[2] + d2 - d1) / (b[2] - a[2] + 2 * d2)
