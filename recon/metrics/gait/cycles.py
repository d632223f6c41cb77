"""Cycles of gait from strike to strike of one foot, and curves over them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from recon.metrics.gait.events import GaitStance, Side
from recon.metrics.gait.feet import SIDES, Feet

LONGEST = 3.0
"""Seconds between two strikes of one foot, at most; longer ones are pauses."""
PERCENT = 101
"""Moments of a normalised cycle: 0 %, 1 %, ... 100 %."""
_SETTLED = (0.1, 0.3)
"""Part of a stride, from the strike on, in which the heel stands where it was placed."""


@dataclass(frozen=True)
class GaitCycle:
    """One stride: from the strike of a foot to its next; seconds of the recording's clock."""

    side: Side
    strike: float
    opposite_off: float | None
    """Moment at which the other foot leaves the ground; None where it was not found."""
    opposite_strike: float | None
    off: float
    next_strike: float
    length: float
    """Distance between two places of the heel, metres."""
    step_length: float | None
    """Distance of its last part, from the other heel to the next place of this one, along the
    line of the stride, metres."""
    step_width: float | None
    """Distance of the other heel from the line of the stride, metres."""
    heading: float
    """Direction of the stride on the ground, radians from x to y."""
    turn: float
    """How far the pelvis turns to the left meanwhile, radians."""

    @property
    def seconds(self) -> float:
        """Stride time."""
        return self.next_strike - self.strike

    @property
    def speed(self) -> float:
        """Metres per second."""
        return self.length / self.seconds

    @property
    def stance(self) -> float:
        """Share of the cycle in which the foot is on the ground."""
        return (self.off - self.strike) / self.seconds

    @property
    def double_support(self) -> float | None:
        """Share of the cycle in which both feet are on the ground; below zero both are off it."""
        if self.opposite_off is None or self.opposite_strike is None:
            return None
        both = (self.opposite_off - self.strike) + (self.off - self.opposite_strike)
        return both / self.seconds


def find_gait_cycles(feet: Feet, stances: Sequence[GaitStance]) -> tuple[GaitCycle, ...]:
    """All complete cycles in the order of their strikes.

    Args:
        feet: of one clip.
        stances: of both its feet, as `find_stances` tells them.
    """
    found: list[GaitCycle] = []
    for side, name in enumerate(SIDES):
        own = [one for one in stances if one.side == name]
        other = [one for one in stances if one.side != name]
        for one, after in pairwise(own):
            if one.strike is None or one.off is None or after.strike is None:
                continue
            if one.off < after.strike <= one.strike + LONGEST * feet.fps:
                found.append(_cycle(feet, side, one.strike, one.off, after.strike, other))
    return tuple(sorted(found, key=lambda cycle: cycle.strike))


def normalised(
    values: Float[np.ndarray, " time"], times: Float[np.ndarray, " time"], cycle: GaitCycle
) -> Float[np.ndarray, " percent"]:
    """A curve over one cycle at 0 %, 1 %, ... 100 % of it, linearly between frames."""
    moments = np.linspace(cycle.strike, cycle.next_strike, PERCENT)
    return np.interp(moments, times, values)


def _cycle(
    feet: Feet, side: int, strike: int, off: int, after: int, other: Sequence[GaitStance]
) -> GaitCycle:
    period = after - strike
    opposite_off = [s.off for s in other if s.off is not None and strike <= s.off < off]
    opposite = [s.strike for s in other if s.strike is not None and strike < s.strike <= after]
    begin, end = _place(feet, side, strike, period), _place(feet, side, after, period)
    stride = end - begin
    length = float(np.linalg.norm(stride))
    along = stride / max(length, 1e-9)
    step = width = None
    if opposite:
        between = _place(feet, 1 - side, opposite[0], period) - begin
        step = length - float(between @ along)
        width = abs(float(between[0] * along[1] - between[1] * along[0]))
    angles = np.unwrap(np.arctan2(feet.forward[:, 1], feet.forward[:, 0])[strike : after + 1])
    return GaitCycle(
        side="left" if SIDES[side] == "left" else "right",
        strike=float(feet.times[strike]),
        opposite_off=float(feet.times[opposite_off[0]]) if opposite_off else None,
        opposite_strike=float(feet.times[opposite[0]]) if opposite else None,
        off=float(feet.times[off]),
        next_strike=float(feet.times[after]),
        length=length,
        step_length=step,
        step_width=width,
        heading=float(np.arctan2(stride[1], stride[0])),
        turn=float(angles[-1] - angles[0]),
    )


def _place(feet: Feet, side: int, strike: int, period: int) -> Float[np.ndarray, " 2"]:
    """Place of a heel on the ground: the median of the first part of the stance."""
    first = strike + round(_SETTLED[0] * period)
    last = max(strike + round(_SETTLED[1] * period), first + 1)
    first = min(first, len(feet.times) - 1)
    return np.median(feet.heels[first:last, side, :2], axis=0)
