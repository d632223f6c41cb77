"""Spatio-temporal figures of gait: cadence, lengths, speed and shares of the cycle."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from recon.metrics.gait.cycles import GaitCycle


@dataclass(frozen=True)
class GaitFigure:
    """One number of gait, over the cycles of one side or of both."""

    name: str
    unit: str
    side: Literal["left", "right", "both"]
    mean: float
    std: float | None
    """Standard deviation over the cycles; None of a single one."""
    count: int
    """Cycles that it was told from."""


_KINDS: tuple[tuple[str, str, Callable[[GaitCycle], float | None]], ...] = (
    ("cadence", "steps/min", lambda cycle: 120 / cycle.seconds),
    ("speed", "m/s", lambda cycle: cycle.speed),
    ("stride time", "s", lambda cycle: cycle.seconds),
    ("stride length", "m", lambda cycle: cycle.length),
    ("step time", "s", lambda cycle: _step_time(cycle)),
    ("step length", "m", lambda cycle: cycle.step_length),
    ("step width", "m", lambda cycle: cycle.step_width),
    ("stance", "% of cycle", lambda cycle: 100 * cycle.stance),
    ("double support", "% of cycle", lambda cycle: _percent(cycle.double_support)),
)


def spatio_temporal(cycles: Sequence[GaitCycle]) -> tuple[GaitFigure, ...]:
    """Means and standard deviations of every figure, over both sides and over each."""
    found: list[GaitFigure] = []
    for name, unit, value in _KINDS:
        for side in ("both", "left", "right"):
            own = [value(one) for one in cycles if side in ("both", one.side)]
            known = np.array([one for one in own if one is not None and math.isfinite(one)])
            if len(known) > 0:
                std = float(known.std(ddof=1)) if len(known) > 1 else None
                found.append(GaitFigure(name, unit, side, float(known.mean()), std, len(known)))
    return tuple(found)


def _step_time(cycle: GaitCycle) -> float | None:
    return None if cycle.opposite_strike is None else cycle.next_strike - cycle.opposite_strike


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share
