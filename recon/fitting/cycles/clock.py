"""Observations of few moments a second on a clock that is fast enough to show a motion."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from observations.together.kinds import InSpace

RATES = (30.0, 60.0)
"""Frames per second at which cycles and recordings are completed, at least and at most."""


def completion_rate(fps: float) -> float:
    """A rate between `RATES`, of which an observation's is a multiple or part."""
    if fps < RATES[0]:
        return fps * math.ceil(RATES[0] / fps)
    return fps / math.ceil(fps / RATES[1] - 1e-6)


def on_fast_clock(one: InSpace) -> InSpace:
    """The observation on a clock of at least 30 Hz; moments in between show nothing.

    Motions have the clock of their data, and energies are taken at 30 Hz: on a slow clock, a
    motion is too coarse to move as people do, and a moment counts for several. A sensor that moves
    keeps its clock, since nobody knows where it is in between.
    """
    times = math.ceil(RATES[0] / one.fps - 1e-6)
    return one if times <= 1 else one.on_faster_clock(times)


def moments_per_second(observations: Sequence[InSpace]) -> float:
    """Moments that show anything, per second of the time in which they lie: of all sensors."""
    times = torch.cat([seen_times(one) for one in observations]).unique()
    if len(times) < 2:
        return 0.0
    return (len(times) - 1) / float(times[-1] - times[0])


def seen_times(one: InSpace) -> Float[Tensor, " moments"]:
    """Times of the moments that show anything in any clip, seconds, to the millisecond."""
    there = one.shown.any(-1).flatten(0, -2).any(0).nonzero()[:, 0].cpu()
    return (one.start_time + there.double() / one.fps).mul(1000).round().div(1000)
