"""Clocks of observations: the times at which the estimate is compared with the data."""

import math
from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.motion import Motion
from recon.core.residuals import Residuals, Unit
from recon.method.protocols import REFERENCE_FPS

_SAME_MOMENT = 1e-4
"""Frames; clocks closer than this are the same clock."""


def at_observation_times(
    values: Float[Tensor, "*batch time points 3"],
    motion: Motion,
    *,
    fps: float,
    start_time: float,
    moments: int,
) -> tuple[Float[Tensor, "*batch seen points 3"], slice]:
    """Positions of the estimate at an observation's moments, and which moments those are.

    Linear between decoded frames; moments outside the motion are left out, so an estimate of
    the first frames of a clip meets the first moments of its data.
    """
    offset = (start_time - motion.start_time) * motion.fps
    ratio = motion.fps / fps
    if abs(ratio - 1) < 1e-9 and abs(offset - round(offset)) < _SAME_MOMENT:
        shift = round(offset)
        first, last = max(0, -shift), min(moments, motion.frames - shift)
        last = max(first, last)
        return values[..., first + shift : last + shift, :, :], slice(first, last)
    place = offset + torch.arange(moments, dtype=torch.float64) * ratio
    inside = ((place >= -_SAME_MOMENT) & (place <= motion.frames - 1 + _SAME_MOMENT)).nonzero()
    if len(inside) == 0:
        return values[..., :0, :, :], slice(0, 0)
    seen = slice(int(inside[0]), int(inside[-1]) + 1)
    place = place[seen].clamp(0, motion.frames - 1)
    before = place.floor().long().clamp(max=max(motion.frames - 2, 0))
    after = (before + 1).clamp(max=motion.frames - 1)
    fraction = (place - before).to(values)[:, None, None]
    before, after = before.to(values.device), after.to(values.device)
    return values[..., before, :, :].lerp(values[..., after, :, :], fraction), seen


def moments_between(
    values: Float[Tensor, "*batch moments points dims"],
    visible: Bool[Tensor, "*batch moments points"],
    *,
    fps: float,
    start_time: float,
    start: float,
    stop: float,
) -> tuple[Float[Tensor, "*batch some points dims"], Bool[Tensor, "*batch some points"], float]:
    """The moments from `start` to `stop`, both included, and the time of the first.

    The clock of the observation runs on where it has no data, nothing being visible then; so
    stretches of equal length that begin at equal phases of the clock have equally many moments.
    """
    numbers = moment_numbers(fps=fps, start_time=start_time, start=start, stop=stop)
    number = torch.tensor(numbers, device=values.device)
    exists = ((number >= 0) & (number < values.shape[-3]))[:, None]
    number = number.clamp(0, values.shape[-3] - 1)
    seen = visible[..., number, :] & exists
    first = start_time + numbers.start / fps
    return values[..., number, :, :].where(seen[..., None], 0.0), seen, first


def moment_numbers(*, fps: float, start_time: float, start: float, stop: float) -> range:
    """Numbers of a clock's moments from `start` to `stop`, both included; some may not exist."""
    first = math.ceil((start - start_time) * fps - _SAME_MOMENT)
    return range(first, math.floor((stop - start_time) * fps + _SAME_MOMENT) + 1)


def point_energy(
    predicted: Float[Tensor, "*batch time points 3"],
    motion: Motion,
    positions: Float[Tensor, "*batch moments points 3"],
    visible: Bool[Tensor, "*batch moments points"],
    *,
    fps: float,
    start_time: float,
    kernel: Callable[[Tensor], Tensor],
    weights: Float[Tensor, "*batch moments points"] | None = None,
    placed: bool = True,
) -> Float[Tensor, "*batch"]:
    """½ Σ kernel(w² |observed - predicted|²) over visible points, taken at 30 Hz; metres².

    Without weights, w is 1. Points that are not placed in the world are compared after the
    translation of every moment that brings them nearest.
    """
    moments = positions.shape[-3]
    points, seen = at_observation_times(
        predicted, motion, fps=fps, start_time=start_time, moments=moments
    )
    if not placed:
        counted = visible if weights is None else weights
        points = points + _shared(positions[..., seen, :, :] - points, counted[..., seen, :])
    distance = (points - positions[..., seen, :, :]).square().sum(-1)
    if weights is not None:
        distance = weights[..., seen, :].square() * distance
    counted = kernel(distance).where(visible[..., seen, :], 0.0)
    return 0.5 * counted.sum((-2, -1)) * (REFERENCE_FPS / fps)


def point_residuals(
    predicted: Float[Tensor, "*batch time points 3"],
    motion: Motion,
    positions: Float[Tensor, "*batch moments points 3"],
    visible: Bool[Tensor, "*batch moments points"],
    *,
    fps: float,
    start_time: float,
    weights: Float[Tensor, "*batch moments points"] | None = None,
    placed: bool = True,
) -> Residuals:
    """Observed minus predicted positions at every moment, metres; without weights these are 1.

    For `placed`, see `point_energy`.
    """
    moments = positions.shape[-3]
    points, seen = at_observation_times(
        predicted, motion, fps=fps, start_time=start_time, moments=moments
    )
    counted = visible if weights is None else weights
    away = positions[..., seen, :, :] - points
    if not placed:
        away = away - _shared(away, counted[..., seen, :])
    return padded(away, counted[..., seen, :], seen, moments)


def _shared(
    away: Float[Tensor, "*batch seen points 3"], weights: Tensor
) -> Float[Tensor, "*batch seen 1 3"]:
    """The translation of every moment that explains most of what its points are away."""
    counted = weights.to(away).square()[..., None]
    return (counted * away).sum(-2, keepdim=True) / counted.sum(-2, keepdim=True).clamp(min=1e-9)


def between_moments(values: Tensor, axis: int, times: int) -> Tensor:
    """Values of moments on a clock that is so many times as fast; zero at those in between."""
    shape = list(values.shape)
    shape[axis] = (shape[axis] - 1) * times + 1
    wide = values.new_zeros(shape)
    index = [slice(None)] * values.ndim
    index[axis] = slice(None, None, times)
    wide[tuple(index)] = values
    return wide


def padded(
    values: Float[Tensor, "*batch seen points dims"],
    weights: Tensor,
    seen: slice | Tensor,
    moments: int,
    unit: Unit = "metres",
) -> Residuals:
    """Residuals of some moments among all of the observation's; zero at the others."""
    weights = weights.to(values)
    every = values.new_zeros(*values.shape[:-3], moments, *values.shape[-2:])
    counted = weights.new_zeros(*weights.shape[:-2], moments, weights.shape[-1])
    every[..., seen, :, :] = values.where(weights[..., None] > 0, 0.0)
    counted[..., seen, :] = weights
    return Residuals(every, counted, unit)
