"""Gravity: nothing falls faster, nothing in the air falls slower, and who stands is balanced.

Accelerations grow with the square of the frame rate, so that a rate wrong by a factor shows as a
fall at another acceleration than g, or as a body that the ground under its feet could not hold.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import Finding, stretches
from recon.diagnosis.motions.movement import Movement, rates_by_strides, strides
from recon.physics.mass import GRAVITY

_FALL_SECONDS = 0.2
_PARABOLA = 0.01
"""Metres, root mean square, by which the centre of mass of a fall may leave its parabola."""
_FASTEST_FALL = 2.0
"""Largest plausible acceleration of a fall, in g; the centre of mass of our body falls at up to
1.8 g in jumps of CMU, whose people have other masses."""
_FALLS = 1.3
"""Acceleration, in g, that a fall may have once the rate is put right."""
_FALL_EVERY = 10.0
"""Seconds of a recording for which one fall too fast is needed; more is no glitch."""
_OFF_GROUND = 0.08
"""Metres above the ground of both soles in the air."""
_FLIGHT_FRAMES = 5
_FREE_FALL = 0.75
"""Least acceleration, in g, of a free fall as seen on our body, whose mass is not that of the
person."""
_WITH = 0.5
"""Share of the rise of the centre of mass by which the lower foot rises too, at least; who stands
on something higher leaves it where it is."""
_WRISTS = tuple(joint_index(f"{side}_wrist") for side in ("left", "right"))
_NECK, _PELVIS = joint_index("neck"), joint_index("pelvis")


def fastest_fall(movement: Movement) -> float:
    """Largest downward acceleration of the centre of mass, times g, that is not a single glitch.

    Parabolas are laid through a fifth of a second each; those that the centre does not follow are
    left out. Of a longer recording it is that which is exceeded once in ten seconds.
    """
    count = max(5, round(_FALL_SECONDS * movement.fps))
    height = movement.centre[:, 2]
    if len(height) < count:
        return 0.0
    pieces = np.lib.stride_tricks.sliding_window_view(height, count)
    falls = _parabolas(pieces, movement.fps)
    for _ in range(max(1, math.ceil(movement.seconds / _FALL_EVERY)) - 1):
        worst = int(np.argmax(falls))
        falls[max(0, worst - 2 * count) : worst + 2 * count] = 0.0
    return max(float(falls.max()), 0.0)


def _parabolas(pieces: Float[np.ndarray, "pieces frames"], fps: float) -> np.ndarray:
    """Downward acceleration over g of every piece, zero where it is no parabola."""
    time = (np.arange(pieces.shape[1]) - (pieces.shape[1] - 1) / 2) / fps
    basis = np.stack((np.ones_like(time), time, time**2), -1)
    solution = pieces @ np.linalg.pinv(basis).T
    deviation = np.sqrt(np.square(pieces - solution @ basis.T).mean(-1))
    return np.where(deviation < _PARABOLA, -2 * solution[:, 2] / GRAVITY, 0.0)


def rates_by_falls(movement: Movement) -> tuple[float, float]:
    """Lower and upper bound of true over declared frame rate, from falls and flights."""
    fall, flights = fastest_fall(movement), _flights(movement)
    flight = float(np.median(flights)) if flights else _FREE_FALL
    low = math.sqrt(_FREE_FALL / flight) if flight < _FREE_FALL else 0.0
    return low, math.sqrt(_FALLS / fall) if fall > _FASTEST_FALL else math.inf


def _flights(movement: Movement) -> list[float]:
    """Accelerations, times g, of the centre of mass of an upright body in the air."""
    height = movement.centre[:, 2]
    joints, ground = movement.joints, movement.ground
    trunk = joints[:, _NECK] - joints[:, _PELVIS]
    upright = trunk[:, 2] > 0.7 * np.linalg.norm(trunk, axis=-1)
    hands = joints[:, list(_WRISTS), 2].max(1) < joints[:, _NECK, 2]
    air = (movement.sole_heights > ground + _OFF_GROUND).all(1) & upright & hands
    found = []
    for first, last in stretches(air):
        inner = height[first : last + 1]
        whole = first > 0 and last < len(air) - 1 and 0 < int(inner.argmax()) < len(inner) - 1
        if len(inner) < _FLIGHT_FRAMES or not whole:
            continue
        fall = float(_parabolas(inner[None], movement.fps)[0])
        lower = movement.sole_heights[first : last + 1].min(1)
        if fall > 0 and _rise(lower) > _WITH * _rise(inner):
            found.append(fall)
    return found


def _rise(heights: Float[np.ndarray, " time"]) -> float:
    """Metres from the higher end to the top."""
    return float(heights.max() - max(heights[0], heights[-1]))


_SPAN = 0.1
"""Seconds between the samples of a second difference."""
_CARRIES = 0.05
"""Metres above the ground of a sole that may carry weight."""
_LOADED = 0.4
"""Share of the weight that the ground must carry; below, the point of its force is ill-defined."""
_LEAST_FRAMES = 10
_UNBALANCED = 0.18
"""Metres, on average, by which the ground's force may lie beside the feet. CMU's walks 0.06 and
dances 0.17 (98th percentiles)."""
_EXPLAINED = 0.45
"""A slower rate must bring that distance below this share."""
_SLOWER = (0.84, 0.71, 0.5, 0.35, 0.25)


def rates_by_balance(movement: Movement) -> tuple[float, float]:
    """Lower and upper bound of true over declared frame rate, from the body's balance."""
    asked = _imbalance(movement, 1.0)
    if asked is None or asked < _UNBALANCED:
        return 0.0, math.inf
    for factor in _SLOWER:
        slower = _imbalance(movement, factor)
        if slower is not None and slower < min(_UNBALANCED, _EXPLAINED * asked):
            return 0.0, factor
    return 0.0, math.inf


def _imbalance(movement: Movement, factor: float) -> float | None:
    """Mean distance of the zero moment point from the hull of the feet on the ground, metres.

    p = c_xy - h a_xy / (g + a_z) for a point mass at height h; None where too few frames show a
    loaded foot on the ground.

    Args:
        movement: what moves.
        factor: by which the declared rate is multiplied.
    """
    fps = movement.fps * factor
    step = max(1, round(_SPAN * fps))
    centre, ground = movement.centre, movement.ground
    if len(centre) < 2 * step + _LEAST_FRAMES:
        return None
    before, here, after = centre[: -2 * step], centre[step:-step], centre[2 * step :]
    acceleration = (after - 2 * here + before) * (fps / step) ** 2
    smoothed = (before + 2 * here + after) / 4
    load = GRAVITY + acceleration[:, 2]
    standing = (movement.sole_heights < ground + _CARRIES)[step:-step]
    asked = standing.any(1) & (load > _LOADED * GRAVITY)
    if asked.sum() < _LEAST_FRAMES:
        return None
    arm = (smoothed[asked, 2] - ground) / load[asked]
    point = smoothed[asked, :2] - arm[:, None] * acceleration[asked, :2]
    soles = movement.soles[step:-step][asked][..., :2]
    # a foot in the air lends its corners to the other one, which then stand for it twice
    soles = np.where(standing[asked][..., None, None], soles, soles[:, ::-1])
    return float(outside(point, soles.reshape(len(soles), 4, 2)).mean())


def outside(
    points: Float[np.ndarray, "frames 2"], corners: Float[np.ndarray, "frames corners 2"]
) -> Float[np.ndarray, " frames"]:
    """Distance of a point from the convex hull of its corners, zero inside."""
    count = corners.shape[1]
    distance = np.full(len(points), np.inf)
    for a in range(count):
        for b in range(a + 1, count):
            side = corners[:, b] - corners[:, a]
            arm = points - corners[:, a]
            along = (arm * side).sum(-1) / np.square(side).sum(-1).clip(min=1e-9)
            nearest = corners[:, a] + along.clip(0, 1)[:, None] * side
            distance = np.minimum(distance, np.linalg.norm(points - nearest, axis=-1))
    arms = corners - points[:, None]
    angles = np.sort(np.arctan2(arms[..., 1], arms[..., 0]), axis=1)
    around = np.diff(np.concatenate((angles, angles[:, :1] + 2 * np.pi), 1), axis=1)
    return np.where(around.max(1) < np.pi, 0.0, distance)


_LEAST_SECONDS = 0.4
_USUAL = (0.25, 0.5, 2.0, 4.0)
"""Factors by which rates are wrong in practice: every second or fourth frame was left out."""


@dataclass(frozen=True)
class RateRange:
    """The range of the true frame rate, as multiples of the declared one."""

    low: float
    high: float
    evidence: tuple[str, ...]
    """What the bounds follow from, in words."""

    @property
    def holds(self) -> bool:
        """Whether the declared rate is among those that are possible."""
        return self.low <= 1 <= self.high

    @property
    def likeliest(self) -> float:
        """The factor in the range that is usual in practice and nearest to one, or its middle."""
        inside = [f for f in _USUAL if self.low <= f <= self.high]
        if self.holds or not inside:
            near = self.high if self.high < 1 else self.low
            return 1.0 if self.holds else near
        return min(inside, key=lambda factor: abs(math.log(factor)))


def rate_range(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> RateRange | None:
    """What a motion's gait, falls and balance say of its frame rate; None where they say nothing.

    Args:
        motion: one clip on the ground z = 0 or any other level one, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows; what is inferred obeys the rate that was declared.
    """
    movement = Movement.of(motion, body, observed)
    if movement.seconds < _LEAST_SECONDS:
        return None
    found = strides(movement)
    bounds = {
        "the length of its steps for their duration": (0.0, math.inf)
        if found is None
        else rates_by_strides(found),
        "the acceleration of its falls against gravity": rates_by_falls(movement),
        "the balance of its centre of mass over its feet": rates_by_balance(movement),
    }
    told = {why: bound for why, bound in bounds.items() if bound != (0.0, math.inf)}
    if not told:
        return None
    low = max(bound[0] for bound in told.values())
    high = min(bound[1] for bound in told.values())
    if low > high:
        # the laws contradict each other: what was found is no error of the rate alone
        return None
    against = tuple(why for why, bound in told.items() if not bound[0] <= 1 <= bound[1])
    return RateRange(low, high, against or tuple(told))


def rate_finding(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> Finding | None:
    """A warning that the frame rate is wrong by a factor, or None where it can be true."""
    found = rate_range(motion, body, observed)
    if found is None or found.holds:
        return None
    factor = found.likeliest
    way = "fast" if found.high < 1 else "slow"
    bounds = f"at most {found.high:.2g}" if found.high < 1 else f"at least {found.low:.2g}"
    return Finding(
        "rate",
        f"at {motion.fps:g} frames per second the person moves too {way}: "
        f"{' and '.join(found.evidence)} asks for {bounds} times that rate. Check the frame rate; "
        f"it is likely about {motion.fps * factor:.3g}",
        value=factor,
    )
