"""Gait events: the moments at which a foot strikes the ground and leaves it.

Steps are found as Zeni, Richards and Higginson 2008 do (doi 10.1016/j.gaitpost.2007.07.007): the
heel is farthest ahead of the pelvis about when it strikes, the toes are farthest behind it about
when they leave. "Ahead" is the direction that the pelvis faces at that moment, so that turning
changes nothing. The strike itself is the moment at which the middle of the foot falls fastest,
just before the ground stops it (O'Connor et al. 2007, doi 10.1016/j.gaitpost.2006.05.016), and the
toes leave when they begin to move faster than toes on the ground do. Between the two the foot must
be in contact with the ground.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from recon.metrics.gait.feet import SIDES, Feet

Side = Literal["left", "right"]

SHORTEST = 0.3
"""Seconds between two strikes of one foot, at least."""
LEAST_SWING = 0.12
"""Metres that a foot goes back and forth below the pelvis in a step, at least."""
LEAVING = 0.8
"""Metres per second from which on toes have left the ground: of the events that five people's
laboratory marked in C3D files, this speed is nearest (0 ± 14 ms)."""
_PROMINENCE = 0.35
"""Share of its largest swing that a foot must make in each."""
_SWING = 0.4
"""Seconds before a strike, or after the toes left, in which the foot swings."""
_BEFORE, _AFTER = 0.03, 0.12
"""Seconds around the moment of the heel farthest ahead in which the foot strikes."""


@dataclass(frozen=True)
class GaitStance:
    """A foot on the ground from its strike to the moment at which it leaves."""

    side: Side
    strike: int | None
    """Frame of the strike; None where the recording begins later."""
    off: int | None
    """Frame at which the toes leave; None where the recording ends before."""


def find_stances(feet: Feet) -> tuple[GaitStance, ...]:
    """All stances of both feet in the order of time; those at the ends may lack an event."""
    found = [stance for side in range(2) for stance in _stances(feet, side)]
    return tuple(sorted(found, key=lambda one: (_middle(one, feet), one.side)))


def _middle(stance: GaitStance, feet: Feet) -> float:
    strike = 0 if stance.strike is None else stance.strike
    off = len(feet.times) - 1 if stance.off is None else stance.off
    return (strike + off) / 2


def _stances(feet: Feet, side: int) -> list[GaitStance]:
    heel = _ahead(feet, feet.heels[:, side])
    toe = _ahead(feet, feet.toes[:, side])
    strikes = _struck(feet, side, _peaks(heel, feet.fps))
    offs = _left(feet, side, _peaks(-toe, feet.fps))
    kinds = sorted([(int(k), "strike") for k in strikes] + [(int(k), "off") for k in offs])
    name: Side = "left" if SIDES[side] == "left" else "right"
    found: list[GaitStance] = []
    opened: int | None = None
    for index, (frame, kind) in enumerate(kinds):
        if kind == "strike":
            if opened is not None:
                found.append(GaitStance(name, opened, None))
            opened = frame
        elif opened is not None or index == 0:
            found.append(GaitStance(name, opened, frame))
            opened = None
    if opened is not None:
        found.append(GaitStance(name, opened, None))
    return [one for one in found if _bears(feet, side, one)]


def _ahead(feet: Feet, points: Float[np.ndarray, "time 3"]) -> Float[np.ndarray, " time"]:
    return ((points - feet.pelvis)[:, :2] * feet.forward).sum(-1)


def _peaks(values: Float[np.ndarray, " time"], fps: float) -> Int[np.ndarray, " peaks"]:
    """Frames at which values are largest nearby; near the ends one flank is enough."""
    from scipy.signal import find_peaks

    swing = float(np.quantile(values, 0.98) - np.quantile(values, 0.02))
    least = max(LEAST_SWING, _PROMINENCE * swing)
    padded = np.pad(values, 1, constant_values=float(values.min()) - 2 * least)
    found = find_peaks(padded, prominence=least, distance=max(1, round(SHORTEST * fps)))[0] - 1
    # where the values still rise at an end, their largest is outside
    return found[(found > 0) & (found < len(values) - 1)]


def _struck(feet: Feet, side: int, ahead: Int[np.ndarray, " steps"]) -> list[int]:
    """Frames of strikes: the foot falls fastest near the moment of the heel farthest ahead.

    The foot must have swung before: a heel may be farthest ahead while the person still stands.
    """
    swings = _speeds(feet, side) > LEAVING
    middle = (feet.heels[:, side, 2] + feet.toes[:, side, 2]) / 2
    rise = np.gradient(middle) * feet.fps
    found: list[int] = []
    for frame in ahead.tolist():
        first = max(0, frame - round(_BEFORE * feet.fps))
        last = min(len(rise), frame + round(_AFTER * feet.fps) + 1)
        strike = first + int(np.argmin(rise[first:last]))
        if swings[max(0, strike - round(_SWING * feet.fps)) : strike + 1].any():
            found.append(strike)
    return found


def _left(feet: Feet, side: int, behind: Int[np.ndarray, " steps"]) -> list[int]:
    """Frames of toes that leave: the last moment before they are behind at which they rest.

    The foot must swing then: toes may be farthest behind while the person goes on standing.
    """
    rests = _speeds(feet, side) < LEAVING
    found: list[int] = []
    for frame in behind.tolist():
        # where toes rest at their farthest, they leave later
        after = np.flatnonzero(~rests[frame : frame + round(_SWING * feet.fps)])
        if len(after) == 0:
            continue
        first = frame + int(after[0])
        before = np.flatnonzero(rests[:first])
        found.append(int(before[-1]) + 1 if len(before) > 0 else first)
    return found


def _speeds(feet: Feet, side: int) -> Float[np.ndarray, " time"]:
    """Speed of the toes over the ground, m/s."""
    velocity = np.gradient(feet.toes[:, side], axis=0) * feet.fps
    return np.linalg.norm(velocity, axis=-1)


def _bears(feet: Feet, side: int, stance: GaitStance) -> bool:
    """Whether the foot is in contact with the ground at some moment of the stance."""
    if feet.bearing is None:
        return True
    first = 0 if stance.strike is None else stance.strike
    last = len(feet.times) if stance.off is None else stance.off + 1
    return bool(feet.bearing[first:last, side].any())
