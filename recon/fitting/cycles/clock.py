"""Observations of few moments a second on a clock that is fast enough to show a motion."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from observations.depth import PointCloud
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
    if times <= 1 or (isinstance(one, PointCloud) and _moves(one)):
        return one

    def spread(tensor: Tensor) -> Tensor:
        shape = list(tensor.shape)
        shape[1] = (shape[1] - 1) * times + 1
        wide = tensor.new_zeros(shape)
        wide[:, ::times] = tensor
        return wide

    fields: dict[str, Any] = {"fps": one.fps * times}
    if isinstance(one, PointCloud):
        return one.derived(points=spread(one.points), present=spread(one.present), **fields)
    std = None if one.std is None else spread(one.std)
    fields |= {"positions": spread(one.positions), "visible": spread(one.visible), "std": std}
    return one.derived(**fields)


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


def _moves(cloud: PointCloud) -> bool:
    return cloud.camera is not None and cloud.camera.T_camera_world.shape[-3] > 1
