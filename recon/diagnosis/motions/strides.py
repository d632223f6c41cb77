"""Gait: how long steps last for their width, by which a wrong frame rate shows.

A leg swings like a pendulum, so a step of a length (in leg lengths) lasts as long as it must (in
units of sqrt(leg length / g)), and people who walk keep the product of the two, the walk ratio,
whatever their speed (Sekiya et al. 1996). A frame rate that is wrong by a factor stretches every
step by it.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.diagnosis.motions.movement import Movement
from recon.physics.zmp import GRAVITY

_TURN = 0.35
"""Leg lengths by which the separation of the feet must fall back for an extreme to count."""
_LEAST_STEPS = 2
_IRREGULAR = 0.35
"""Relative standard deviation of durations and of widths above which this is no gait."""
_WIDE = 0.6
"""Leg lengths: steps less wide may be as slow as one likes."""
_WALK, _RUN = -0.35, 0.5
"""Correlation of the pelvis' height with the separation of the feet: who walks vaults over the
standing leg and is highest where the feet pass each other, who runs is lowest there."""


@dataclass(frozen=True)
class Strides:
    """Alternating steps of two legs, by the declared rate."""

    count: int
    duration: float
    """Median time between two extremes of the feet's separation, in sqrt(leg length / g)."""
    width: float
    """Median separation of the ankles at the extremes, along the pelvis' facing, leg lengths."""
    phase: float
    """Correlation of the pelvis' height with the separation of the feet, -1 to 1."""


def strides(movement: Movement) -> Strides | None:
    """The steps of a stretch of motion, or None where legs do not alternate regularly."""
    if movement.frames < 3:
        return None
    between = (movement.ankles[:, 0] - movement.ankles[:, 1])[:, :2]
    apart = (between * movement.forward).sum(-1) / movement.leg
    turns = _extremes(apart)
    steps = [(a, b) for a, b in itertools.pairwise(turns) if apart[a] * apart[b] < 0]
    if len(steps) < _LEAST_STEPS:
        return None
    durations = np.array([(b - a) / movement.fps for a, b in steps])
    widths = np.array([abs(apart[a] - apart[b]) / 2 for a, b in steps])
    if max(durations.std() / durations.mean(), widths.std() / widths.mean()) > _IRREGULAR:
        return None
    inside = slice(steps[0][0], steps[-1][1] + 1)
    return Strides(
        count=len(steps),
        duration=float(np.median(durations)) * math.sqrt(GRAVITY / movement.leg),
        width=float(np.median(widths)),
        phase=_correlation(_detrended(movement.joints[inside, 0, 2]), np.abs(apart[inside])),
    )


_WALK_RATIO = (0.9, 2.6)
"""Product of width and duration of a walk's steps. CMU: 1.0 to 2.3, median 1.4."""
_WALK_SLOWNESS = (1.35, 4.1)
"""Duration over width of a walk's steps: the inverse of their speed. Above a speed of
sqrt(g leg length) no foot stays on the ground; people change to a run at 0.7 of it."""
_RUN_RATIO = (0.7, 1.6)
"""Product of width and duration of a run's steps. CMU: 0.9 to 1.25."""


def rates_by_strides(found: Strides) -> tuple[float, float]:
    """Factors between which the true rate over the declared one lies; (0, inf) if all may be."""
    low, high = 0.0, math.inf
    if found.width < _WIDE:
        return low, high
    ratio, slowness = found.width * found.duration, found.duration / found.width
    if found.phase < _WALK:
        low = max(ratio / _WALK_RATIO[1], slowness / _WALK_SLOWNESS[1])
        high = min(ratio / _WALK_RATIO[0], slowness / _WALK_SLOWNESS[0])
    elif found.phase > _RUN and found.count > _LEAST_STEPS:
        low, high = ratio / _RUN_RATIO[1], ratio / _RUN_RATIO[0]
    return low, high


def _extremes(values: Float[np.ndarray, " time"]) -> list[int]:
    """Frames of maxima and minima between which the values turn back by `_TURN`."""
    found: list[int] = []
    high = low = direction = 0
    for index, value in enumerate(values):
        high = index if value > values[high] else high
        low = index if value < values[low] else low
        if direction >= 0 and values[high] - value > _TURN:
            found.append(high)
            direction, high, low = -1, index, index
        elif direction <= 0 and value - values[low] > _TURN:
            found.append(low)
            direction, high, low = 1, index, index
    return found


def _detrended(values: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    time = np.arange(len(values))
    return values - np.polyval(np.polyfit(time, values, 1), time)


def _correlation(a: Float[np.ndarray, " time"], b: Float[np.ndarray, " time"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0
