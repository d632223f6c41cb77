"""Checks the frame rate by gravity: falls, flights, balance and steps of a motion.

Accelerations grow with the square of the frame rate, so that a rate wrong by a factor shows as a
fall at another acceleration than g, or as a body that the ground under its feet could not hold.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.body.parts import GRAVITY
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import Finding, stretches
from recon.diagnosis.movement import Movement, distance_outside_hull

_FALL_SECONDS = 0.2
_MAX_PARABOLA_RMS_M = 0.01
"""Root mean square distance (m) of the centre of mass of a falling body from a parabola."""
_MAX_FALL_G = 2.0
"""Largest plausible downward acceleration, in g; the body model's centre of mass reaches 1.8 g in
jumps of CMU, whose people have other mass distributions."""
_CORRECTED_FALL_G = 1.3
"""Acceleration, in g, that a fall may have once the rate is put right."""
_IGNORED_FALL_S = 10.0
"""Seconds of a recording per one fall that may be too fast and is ignored as a glitch."""
_FLIGHT_HEIGHT_M = 0.08
"""Height (m) of both soles above the ground from which on a body is in the air."""
_FLIGHT_FRAMES = 5
_MIN_FLIGHT_G = 0.75
"""Least plausible acceleration, in g, in free flight, as the body model's mass distribution is not
the person's."""
_MIN_FOOT_RISE_SHARE = 0.5
"""Least rise of the lower foot in flight, as a share of that of the centre of mass; a foot that
stands on something higher does not rise."""
_WRISTS = tuple(joint_index(f"{side}_wrist") for side in ("left", "right"))
_NECK, _PELVIS = joint_index("neck"), joint_index("pelvis")


Bounds = tuple[float, float]
"""Lower and upper bound of the true frame rate over the declared one; (0, inf): unknown."""


def rates_by_falls(movement: Movement) -> Bounds:
    """Bound the frame rate by the centre of mass's acceleration in falls and flights.

    Parabolas are fitted to every fifth of a second; those that fit badly are left out. For every
    further ten seconds of a recording, one largest acceleration is ignored as a glitch.
    """
    count, height = max(5, round(_FALL_SECONDS * movement.fps)), movement.centre[:, 2]
    if len(height) < count:
        return 0.0, math.inf
    pieces = np.lib.stride_tricks.sliding_window_view(height, count)
    falls = _accelerations_of_parabolas(pieces, movement.fps)
    for _ in range(max(1, math.ceil(movement.frames / movement.fps / _IGNORED_FALL_S)) - 1):
        worst = int(np.argmax(falls))
        falls[max(0, worst - 2 * count) : worst + 2 * count] = 0.0
    fall, flight = (
        float(falls.max()),
        float(np.median(_accelerations_in_flight(movement) or _MIN_FLIGHT_G)),
    )
    low = math.sqrt(_MIN_FLIGHT_G / flight) if flight < _MIN_FLIGHT_G else 0.0
    return low, math.sqrt(_CORRECTED_FALL_G / fall) if fall > _MAX_FALL_G else math.inf


def _accelerations_of_parabolas(
    pieces: Float[np.ndarray, "pieces frames"], fps: float
) -> np.ndarray:
    """Return the downward acceleration (g) of every piece; zero if it is no parabola."""
    time = (np.arange(pieces.shape[1]) - (pieces.shape[1] - 1) / 2) / fps
    basis = np.stack((np.ones_like(time), time, time**2), -1)
    solution = pieces @ np.linalg.pinv(basis).T
    deviation = np.sqrt(np.square(pieces - solution @ basis.T).mean(-1))
    return np.where(deviation < _MAX_PARABOLA_RMS_M, -2 * solution[:, 2] / GRAVITY, 0.0)


def _accelerations_in_flight(movement: Movement) -> list[float]:
    """Return downward accelerations (g) of the centre of mass of an upright body in flight.

    In a flight the lower foot rises with the centre of mass, which is highest in between.
    """
    joints, centre, soles = movement.joints, movement.centre[:, 2], movement.sole_heights
    trunk = joints[:, _NECK] - joints[:, _PELVIS]
    upright = trunk[:, 2] > 0.7 * np.linalg.norm(trunk, axis=-1)
    hands = joints[:, list(_WRISTS), 2].max(1) < joints[:, _NECK, 2]
    air = (soles > movement.ground + _FLIGHT_HEIGHT_M).all(1) & upright & hands
    found: list[float] = []
    for first, last in stretches(air):
        inner, lower = centre[first : last + 1], soles[first : last + 1].min(1)
        rise, lift = (h.max() - max(h[0], h[-1]) for h in (inner, lower))
        whole = first > 0 and last < len(air) - 1 and rise > 0 and len(inner) >= _FLIGHT_FRAMES
        fall = float(_accelerations_of_parabolas(inner[None], movement.fps)[0]) if whole else 0.0
        if fall > 0 and lift > _MIN_FOOT_RISE_SHARE * rise:
            found.append(fall)
    return found


_SPAN_S = 0.1
"""Time (s) between the samples of a second difference."""
_CONTACT_HEIGHT_M = 0.05
"""Height (m) above the ground up to which a sole may carry weight."""
_MIN_LOAD = 0.4
"""Share of the weight that the ground must carry; below, the zero moment point is ill-defined."""
_LEAST_FRAMES = 10
_MAX_IMBALANCE_M = 0.18
"""Largest plausible mean distance (m) of the zero moment point from the feet. CMU's walks have
0.06 and dances 0.17 (98th percentiles)."""
_MAX_IMBALANCE_SHARE = 0.45
"""Ratio to which a lower frame rate must reduce the zero moment point's distance from the feet."""
_RATE_FACTORS = (0.84, 0.71, 0.5, 0.35, 0.25)


def rates_by_balance(movement: Movement) -> Bounds:
    """Bound the frame rate from above where only a lower one makes the motion balanced."""
    given = _imbalance(movement, 1.0)
    if given >= _MAX_IMBALANCE_M:
        for factor in _RATE_FACTORS:
            if _imbalance(movement, factor) < min(_MAX_IMBALANCE_M, _MAX_IMBALANCE_SHARE * given):
                return 0.0, factor
    return 0.0, math.inf


def _imbalance(movement: Movement, rate_factor: float) -> float:
    """Return the mean distance (m) of the zero moment point from the hull of the standing feet.

    p = c_xy - h a_xy / (g + a_z) for a point mass at height h; NaN where too few frames show a
    loaded foot on the ground.

    Args:
        movement: centre of mass and feet over time.
        rate_factor: factor by which the declared frame rate is multiplied.
    """
    fps = movement.fps * rate_factor
    step = max(1, round(_SPAN_S * fps))
    centre, ground = movement.centre, movement.ground
    if len(centre) < 2 * step + _LEAST_FRAMES:
        return math.nan
    before, here, after = centre[: -2 * step], centre[step:-step], centre[2 * step :]
    acceleration = (after - 2 * here + before) * (fps / step) ** 2
    smoothed = (before + 2 * here + after) / 4
    load = GRAVITY + acceleration[:, 2]
    standing = (movement.sole_heights < ground + _CONTACT_HEIGHT_M)[step:-step]
    loaded = standing.any(1) & (load > _MIN_LOAD * GRAVITY)
    if loaded.sum() < _LEAST_FRAMES:
        return math.nan
    arm = (smoothed[loaded, 2] - ground) / load[loaded]
    point = smoothed[loaded, :2] - arm[:, None] * acceleration[loaded, :2]
    soles = movement.soles[step:-step][loaded][..., :2]
    # a raised sole gets the corners of the standing one, which leaves the convex hull unchanged
    soles = np.where(standing[loaded][..., None, None], soles, soles[:, ::-1])
    return float(distance_outside_hull(point, soles.reshape(len(soles), 4, 2)).mean())


_MIN_SWING_LEGS = 0.35
"""Change of the feet's separation (leg lengths) after an extreme for it to count as one."""
_LEAST_STEPS = 2
_MAX_VARIATION = 0.35
"""Relative standard deviation of durations and of widths above which this is no gait."""
_MAX_SLOW_STEP_LEGS = 0.6
"""Width (leg lengths) of steps below which they may have any duration."""
_WALK_CORRELATION, _RUN_CORRELATION = -0.35, 0.5
"""Correlation of the pelvis' height with the separation of the feet: below the first in a walk, in
which the body vaults over the standing leg and is highest as the feet pass each other; above the
second in a run, in which it is lowest there."""
_WALK_RATIO = (0.9, 2.6)
"""Product of width and duration of a walk's steps. CMU: 1.0 to 2.3, median 1.4."""
_WALK_SLOWNESS = (1.35, 4.1)
"""Duration over width of a walk's steps: the inverse of their speed. Above a speed of sqrt(g leg
length) no foot stays on the ground; people change to a run at 0.7 of it."""
_RUN_RATIO = (0.7, 1.6)
"""Product of width and duration of a run's steps. CMU: 0.9 to 1.25."""


def rates_by_strides(movement: Movement) -> Bounds:
    """Bound the frame rate by lengths and durations of steps, if legs alternate regularly.

    Widths are in lengths of a leg, durations in sqrt(leg length / g).
    """
    step_vectors = (movement.ankles[:, 0] - movement.ankles[:, 1])[:, :2]
    apart = (step_vectors * movement.forward).sum(-1) / movement.leg
    turns = itertools.pairwise(_turning_points(apart))
    steps = np.array([(a, b) for a, b in turns if apart[a] * apart[b] < 0])
    if len(steps) < _LEAST_STEPS:
        return 0.0, math.inf
    durations = (steps[:, 1] - steps[:, 0]) / movement.fps * math.sqrt(GRAVITY / movement.leg)
    widths = np.abs(apart[steps[:, 0]] - apart[steps[:, 1]]) / 2
    duration, width = float(np.median(durations)), float(np.median(widths))
    irregular = max(durations.std() / durations.mean(), widths.std() / widths.mean())
    if irregular > _MAX_VARIATION or width < _MAX_SLOW_STEP_LEGS:
        return 0.0, math.inf
    inside = slice(steps[0, 0], steps[-1, 1] + 1)
    height, time = movement.joints[inside, 0, 2], np.arange(steps[-1, 1] + 1 - steps[0, 0])
    detrended = height - np.polyval(np.polyfit(time, height, 1), time)
    phase = np.corrcoef(detrended, np.abs(apart[inside]))[0, 1]
    ratio, slowness = width * duration, duration / width
    if phase < _WALK_CORRELATION:
        low = max(ratio / _WALK_RATIO[1], slowness / _WALK_SLOWNESS[1])
        return low, min(ratio / _WALK_RATIO[0], slowness / _WALK_SLOWNESS[0])
    if phase > _RUN_CORRELATION and len(steps) > _LEAST_STEPS:
        return ratio / _RUN_RATIO[1], ratio / _RUN_RATIO[0]
    return 0.0, math.inf


def _turning_points(values: Float[np.ndarray, " time"]) -> list[int]:
    """Return frames of alternating maxima and minima that differ by `_MIN_SWING_LEGS` or more."""
    found: list[int] = []
    high = low = direction = 0
    for index, value in enumerate(values):
        high = index if value > values[high] else high
        low = index if value < values[low] else low
        if direction >= 0 and values[high] - value > _MIN_SWING_LEGS:
            found.append(high)
            direction, high, low = -1, index, index
        elif direction <= 0 and value - values[low] > _MIN_SWING_LEGS:
            found.append(low)
            direction, high, low = 1, index, index
    return found


_LEAST_SECONDS = 0.4
_USUAL_FACTORS = (0.25, 0.5, 2.0, 4.0)
"""Factors by which frame rates are wrong in practice: every second or fourth frame left out."""


@dataclass(frozen=True)
class RateRange:
    """The range of the true frame rate, as multiples of the declared one."""

    low: float
    high: float
    evidence: tuple[str, ...]
    """Descriptions of the tests that the bounds follow from."""

    @property
    def holds_one(self) -> bool:
        """Whether the declared rate is within the range."""
        return self.low <= 1 <= self.high

    @property
    def likeliest(self) -> float:
        """Likeliest factor: 1 if in range, else a usual one in range, else the nearest bound."""
        near = 1.0 if self.holds_one else self.high if self.high < 1 else self.low
        inside = [f for f in _USUAL_FACTORS if self.low <= f <= self.high and not self.holds_one]
        return min(inside, key=lambda factor: abs(math.log(factor)), default=near)


def rate_range(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> RateRange | None:
    """Return the range of frame rates that a motion's gait, falls and balance allow.

    None where they give no bound, or contradict each other.

    Args:
        motion: one clip on level ground, without a batch axis.
        body: body model of the motion.
        observed: joints that the data shows; inferred ones obey the declared rate anyway.
    """
    movement = Movement.of(motion, body, observed)
    if movement.frames < _LEAST_SECONDS * movement.fps:
        return None
    bounds = {
        "the length of its steps for their duration": rates_by_strides(movement),
        "the acceleration of its falls against gravity": rates_by_falls(movement),
        "the balance of its centre of mass over its feet": rates_by_balance(movement),
    }
    limits = {why: bound for why, bound in bounds.items() if bound != (0.0, math.inf)}
    low = max((bound[0] for bound in limits.values()), default=math.inf)
    high = min((bound[1] for bound in limits.values()), default=0.0)
    if low > high:
        # no test gave a bound, or the bounds contradict each other, so that no rate suits all
        return None
    against = tuple(why for why, bound in limits.items() if not bound[0] <= 1 <= bound[1])
    return RateRange(low, high, against or tuple(limits))


def rate_finding(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> Finding | None:
    """Return a warning that the frame rate is wrong by a factor; None if it is plausible."""
    found = rate_range(motion, body, observed)
    if found is None or found.holds_one:
        return None
    factor = found.likeliest
    way = "fast" if found.high < 1 else "slow"
    bounds = f"at most {found.high:.2g}" if found.high < 1 else f"at least {found.low:.2g}"
    return Finding(
        "rate",
        f"the person moves too {way}: {' and '.join(found.evidence)} asks for {bounds} times the "
        f"frame rate that was given. Check it; the true one is likely about {factor:.2g} times "
        "as high",
        value=factor,
    )
