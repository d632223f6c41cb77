"""Finds gait cycles, from one strike of a foot to its next, and joint angles over each cycle."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.angles import ISB_ANGLES, isb_angles
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.gait.feet import SIDES, Feet, GaitStance, Side, find_stances

MAX_STRIDE_S = 3.0
"""Seconds between two strikes of one foot, at most; longer ones are pauses."""
PERCENT = 101
"""Moments of a normalised cycle: 0 %, 1 %, ... 100 %."""
_SETTLED = (0.1, 0.3)
"""Part of a stride, from the strike on, in which the heel stands where it was placed."""


@dataclass(frozen=True)
class GaitCycle:
    """A stride, from one strike of a foot to its next, with the times of its events in seconds."""

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
        """Duration of the cycle, seconds."""
        return self.next_strike - self.strike

    @property
    def speed(self) -> float:
        """Walking speed over the cycle, metres per second."""
        return self.length / self.seconds

    @property
    def stance(self) -> float:
        """Share of the cycle in which the foot is on the ground."""
        return (self.off - self.strike) / self.seconds

    @property
    def step_time(self) -> float | None:
        """Seconds from the other foot's strike to this foot's next strike."""
        return None if self.opposite_strike is None else self.next_strike - self.opposite_strike

    @property
    def double_support(self) -> float | None:
        """Share of the cycle with both feet on the ground; negative if both are in the air."""
        if self.opposite_off is None or self.opposite_strike is None:
            return None
        both = (self.opposite_off - self.strike) + (self.off - self.opposite_strike)
        return both / self.seconds


def find_gait_cycles(feet: Feet, stances: Sequence[GaitStance]) -> tuple[GaitCycle, ...]:
    """Return all complete gait cycles of a clip, in the order of the strikes that begin them.

    Args:
        feet: of one clip.
        stances: of both its feet, as `find_stances` returns them.
    """
    found: list[GaitCycle] = []
    for side, name in enumerate(SIDES):
        other = [one for one in stances if one.side != name]
        for one, after in pairwise([one for one in stances if one.side == name]):
            if one.strike is None or one.off is None or after.strike is None:
                continue
            if one.off < after.strike <= one.strike + MAX_STRIDE_S * feet.fps:
                found.append(
                    _cycle_of_strikes(feet, side, one.strike, one.off, after.strike, other)
                )
    return tuple(sorted(found, key=lambda cycle: cycle.strike))


def percent_curve(
    values: Float[np.ndarray, " time"], times: Float[np.ndarray, " time"], cycle: GaitCycle
) -> Float[np.ndarray, " percent"]:
    """Resample a curve at 0 %, 1 %, ... 100 % of one gait cycle, linearly between frames."""
    moments = np.linspace(cycle.strike, cycle.next_strike, PERCENT)
    return np.interp(moments, times, values)


def _cycle_of_strikes(
    feet: Feet,
    side: int,
    strike: int,
    toe_off: int,
    next_strike: int,
    other_stances: Sequence[GaitStance],
) -> GaitCycle:
    period = next_strike - strike
    opposite_off = [
        s.off for s in other_stances if s.off is not None and strike <= s.off < toe_off
    ]
    opposite = [
        s.strike
        for s in other_stances
        if s.strike is not None and strike < s.strike <= next_strike
    ]
    begin, end = (
        _place_of_heel(feet, side, strike, period),
        _place_of_heel(feet, side, next_strike, period),
    )
    stride = end - begin
    length = float(np.linalg.norm(stride))
    along = stride / max(length, 1e-9)
    step = width = None
    if opposite:
        between = _place_of_heel(feet, 1 - side, opposite[0], period) - begin
        step = length - float(between @ along)
        width = abs(float(between[0] * along[1] - between[1] * along[0]))
    angles = np.unwrap(
        np.arctan2(feet.forward[:, 1], feet.forward[:, 0])[strike : next_strike + 1]
    )
    return GaitCycle(
        side=SIDES[side],
        strike=float(feet.times[strike]),
        opposite_off=float(feet.times[opposite_off[0]]) if opposite_off else None,
        opposite_strike=float(feet.times[opposite[0]]) if opposite else None,
        off=float(feet.times[toe_off]),
        next_strike=float(feet.times[next_strike]),
        length=length,
        step_length=step,
        step_width=width,
        heading=float(np.arctan2(stride[1], stride[0])),
        turn=float(angles[-1] - angles[0]),
    )


def _place_of_heel(feet: Feet, side: int, strike: int, period: int) -> Float[np.ndarray, " 2"]:
    """Return the median horizontal position of a heel over the early stance after a strike."""
    first = strike + round(_SETTLED[0] * period)
    last = max(strike + round(_SETTLED[1] * period), first + 1)
    first = min(first, len(feet.times) - 1)
    return np.median(feet.heels[first:last, side, :2], axis=0)


@dataclass(frozen=True)
class GaitFigure:
    """A gait parameter, such as cadence, with mean and standard deviation over cycles."""

    name: str
    unit: str
    side: Literal["left", "right", "both"]
    mean: float
    std: float | None
    """Standard deviation over the cycles; None of a single one."""
    count: int
    """Cycles that it was told from."""


FIGURES: tuple[tuple[str, str, float, Callable[[GaitCycle], float | None]], ...] = (
    ("cadence", "steps/min", 120, lambda cycle: 1 / cycle.seconds),
    ("speed", "m/s", 1, lambda cycle: cycle.speed),
    ("stride time", "s", 1, lambda cycle: cycle.seconds),
    ("stride length", "m", 1, lambda cycle: cycle.length),
    ("step time", "s", 1, lambda cycle: cycle.step_time),
    ("step length", "m", 1, lambda cycle: cycle.step_length),
    ("step width", "m", 1, lambda cycle: cycle.step_width),
    ("stance", "% of cycle", 100, lambda cycle: cycle.stance),
    ("double support", "% of cycle", 100, lambda cycle: cycle.double_support),
)
"""Name, unit, factor to that unit, and value of a cycle."""


def gait_figures(cycles: Sequence[GaitCycle]) -> tuple[GaitFigure, ...]:
    """Means and standard deviations of all gait parameters, over both sides and each side."""
    found: list[GaitFigure] = []
    for name, unit, factor, value in FIGURES:
        for side in ("both", *SIDES):
            own = [value(one) for one in cycles if side in ("both", one.side)]
            finite = [one for one in own if one is not None and math.isfinite(one)]
            known = factor * np.array(finite)
            if len(known) > 0:
                std = float(known.std(ddof=1)) if len(known) > 1 else None
                found.append(GaitFigure(name, unit, side, float(known.mean()), std, len(known)))
    return tuple(found)


@dataclass(frozen=True)
class GaitCurve:
    """A joint angle that a gait report plots over the gait cycle, one curve per side."""

    name: str
    """Its name among the angles; `_l` and `_r` follow where it belongs to a side."""
    title: str
    """What it is, and what a positive angle means."""
    sided: bool = True
    """Whether each side has its own."""
    mirrored: Side | None = None
    """Side whose cycles have the opposite sign."""
    from_heading: bool = False
    """Whether it is a direction in the world, told from the direction of the stride here."""
    joints: tuple[str, ...] = ()
    """Joints of the side that must be seen for the angle to be seen."""

    def angle(self, side: Side) -> str:
        """Return the name of this angle in `Gait.angles` for one side of the body."""
        return f"{self.name}_{side[0]}" if self.sided else self.name

    def seen_joints(self, side: Side) -> list[int]:
        """Return the indices of the joints that must be seen for this angle of one side."""
        return [joint_index(f"{side}_{name}") for name in self.joints]


CURVES: tuple[GaitCurve, ...] = (
    GaitCurve("pelvis_anterior_tilt", "Pelvic tilt, anterior +", False, joints=("hip",)),
    GaitCurve("pelvis_left_up_obliquity", "Pelvic obliquity, own side up +", False, "right",
              joints=("hip",)),
    GaitCurve("pelvis_left_rotation", "Pelvic rotation, own side forward +", False, "left", True,
              joints=("hip",)),
    GaitCurve("hip_flexion", "Hip flexion +", joints=("hip", "knee")),
    GaitCurve("hip_adduction", "Hip adduction +", joints=("hip", "knee")),
    GaitCurve("hip_internal_rotation", "Hip internal rotation +",
              joints=("hip", "knee", "ankle")),
    GaitCurve("knee_flexion", "Knee flexion +", joints=("hip", "knee", "ankle")),
    GaitCurve("ankle_dorsiflexion", "Ankle dorsiflexion +", joints=("knee", "ankle", "foot")),
    GaitCurve("ankle_internal_rotation", "Foot internal rotation +",
              joints=("knee", "ankle", "foot")),
    GaitCurve("trunk_flexion", "Trunk flexion to pelvis +", False, joints=("hip", "shoulder")),
    GaitCurve("trunk_right_bending", "Trunk bending to own side +", False, "left",
              joints=("hip", "shoulder")),
    GaitCurve("trunk_left_rotation", "Trunk rotation, own side forward +", False, "left",
              joints=("hip", "shoulder")),
)  # fmt: skip
"""What the page shows, row by row: pelvis, hip, knee and ankle, trunk."""


@dataclass(frozen=True)
class Gait:
    """Gait events, cycles, parameters and joint angles of one clip."""

    times: Float[np.ndarray, " time"]
    """Seconds of the recording's clock."""
    stances: tuple[GaitStance, ...]
    """Stances of both feet in the order of time."""
    cycles: tuple[GaitCycle, ...]
    """Complete strides of both feet in the order of their strikes."""
    figures: tuple[GaitFigure, ...]
    """Spatio-temporal figures: cadence, lengths, speed, shares of the cycle."""
    angles: Mapping[str, Float[np.ndarray, " time"]]
    """Joint angles after the ISB, degrees, as `recon.body.angles.isb_angles` names them."""
    angle_std: Mapping[str, Float[np.ndarray, " time"]]
    """Standard deviations of the angles, degrees; empty where they are not known."""
    unseen: Mapping[str, float]
    """Share of the frames in which an angle was inferred rather than seen, where there are any."""
    belt: float | None
    """Speed of the treadmill's belt, m/s; None where the ground rests."""

    def cycles_of(self, side: Side) -> tuple[GaitCycle, ...]:
        """Return the gait cycles that begin with a strike of the foot of the given side."""
        return tuple(cycle for cycle in self.cycles if cycle.side == side)

    def curves(self, curve: GaitCurve, side: Side) -> Float[np.ndarray, "cycles percent"]:
        """Return a joint angle at every percent of every gait cycle of one side, degrees."""
        found = [self._over_cycle(curve, cycle) for cycle in self.cycles_of(side)]
        return np.array(found).reshape(len(found), PERCENT)

    def _over_cycle(self, curve: GaitCurve, cycle: GaitCycle) -> Float[np.ndarray, " percent"]:
        """Return a joint angle at every percent of one gait cycle, degrees."""
        values = self.angles[curve.angle(cycle.side)]
        if curve.from_heading:
            values = values - np.rad2deg(cycle.heading)
        found = percent_curve(values, self.times, cycle)
        if curve.from_heading:
            found = found - 360 * np.round(found.mean() / 360)
        return -found if cycle.side == curve.mirrored else found

    def curve_std(
        self, curve: GaitCurve, side: Side
    ) -> Float[np.ndarray, "cycles percent"] | None:
        """Standard deviation of a fitted angle over every cycle of one side, degrees."""
        known = self.angle_std.get(curve.angle(side))
        if known is None or len(self.cycles_of(side)) == 0:
            return None
        return np.array([percent_curve(known, self.times, one) for one in self.cycles_of(side)])


def analyse(
    motion: Motion,
    body: BodyModel,
    *,
    ground: float | None = 0.0,
    belt: Float[Tensor, " 2"] | None = None,
    angle_std: Float[Tensor, "time 42"] | None = None,
    observed: Bool[Tensor, "time 22"] | None = None,
) -> Gait:
    """Find events, cycles, parameters and joint angles of one clip.

    Args:
        motion: one clip without a batch axis, z up.
        body: whose motion it is; the bundled one, whose landmarks are known.
        ground: height of the ground, metres; None where there is none.
        belt: velocity of a treadmill's belt, m/s; None where the ground rests.
        angle_std: standard deviations of the ISB's angles, degrees; None where unknown.
        observed: false where a joint was inferred; None means that all were seen.

    Raises:
        ReconError: when the body is another one, or the clip a single frame.
    """
    feet = Feet.of(motion, body, ground, belt)
    stances = find_stances(feet)
    cycles = find_gait_cycles(feet, stances)
    deviations: dict[str, np.ndarray] = {}
    if angle_std is not None:
        deviations = dict(zip(ISB_ANGLES, angle_std.double().cpu().numpy().T, strict=True))
    return Gait(
        times=feet.times,
        stances=stances,
        cycles=cycles,
        figures=gait_figures(cycles),
        angles=isb_angles(motion, body),
        angle_std=deviations,
        unseen={} if observed is None else _unseen_shares_by_angle(observed),
        belt=None if belt is None else float(belt.norm()),
    )


def _unseen_shares_by_angle(observed: Bool[Tensor, "time 22"]) -> dict[str, float]:
    seen = observed.cpu().numpy()
    shares: dict[str, float] = {}
    for curve in CURVES:
        for side in SIDES:
            share = float(1 - seen[:, curve.seen_joints(side)].all(-1).mean())
            angle = curve.angle(side)
            shares[angle] = max(share, shares.get(angle, 0.0))
    return {name: share for name, share in shares.items() if share > 0}
