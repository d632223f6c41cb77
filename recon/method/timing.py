"""Frame times of observations, and estimates interpolated to them."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.core.motion import Motion
from recon.core.residuals import Residuals, Unit

SAME_MOMENT = 1e-4
"""Frames; moments closer than this, and clocks, are the same."""


def at_observation_times(
    values: Float[Tensor, "*batch time points dims"],
    motion: Motion,
    *,
    fps: float,
    start_time: float,
    moments: int,
) -> tuple[Float[Tensor, "*batch seen points dims"], slice]:
    """Interpolate values of a motion at an observation's frames; also return which it covers.

    Values are linear between the motion's frames. Frames of the observation before or after the
    motion are left out.
    """
    offset = (start_time - motion.start_time) * motion.fps
    ratio = motion.fps / fps
    if abs(ratio - 1) < 1e-9 and abs(offset - round(offset)) < SAME_MOMENT:
        shift = round(offset)
        first, last = max(0, -shift), min(moments, motion.frames - shift)
        last = max(first, last)
        return values[..., first + shift : last + shift, :, :], slice(first, last)
    place = offset + torch.arange(moments, dtype=torch.float64) * ratio
    inside = ((place >= -SAME_MOMENT) & (place <= motion.frames - 1 + SAME_MOMENT)).nonzero()
    if len(inside) == 0:
        return values[..., :0, :, :], slice(0, 0)
    seen = slice(int(inside[0]), int(inside[-1]) + 1)
    place = place[seen].clamp(0, motion.frames - 1)
    before = place.floor().long().clamp(max=max(motion.frames - 2, 0))
    after = (before + 1).clamp(max=motion.frames - 1)
    fraction = (place - before).to(values)[:, None, None]
    before, after = before.to(values.device), after.to(values.device)
    return values[..., before, :, :].lerp(values[..., after, :, :], fraction), seen


def moment_numbers(*, fps: float, start_time: float, start: float, stop: float) -> range:
    """Return a clock's frame numbers from `start` to `stop` seconds, even beyond the data."""
    first = math.ceil((start - start_time) * fps - SAME_MOMENT)
    return range(first, math.floor((stop - start_time) * fps + SAME_MOMENT) + 1)


def with_empty_frames_between(values: Tensor, axis: int, times: int) -> Tensor:
    """Insert frames of zeros between values, so that their rate is `times` times as high."""
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
    """Return residuals of the frames `seen`, with zeros in the observation's other frames."""
    weights = weights.to(values)
    if values.shape[-3] == moments:
        return Residuals(values.where(weights[..., None] > 0, 0.0), weights, unit)
    every = values.new_zeros(*values.shape[:-3], moments, *values.shape[-2:])
    counted = weights.new_zeros(*weights.shape[:-2], moments, weights.shape[-1])
    every[..., seen, :, :] = values.where(weights[..., None] > 0, 0.0)
    counted[..., seen, :] = weights
    return Residuals(every, counted, unit)


def first_to_last(located: Bool[Tensor, "*batch frames 22"]) -> Bool[Tensor, "*batch frames"]:
    """Return a mask of the frames from the first to the last in which any joint is located.

    Frames outside this range may be padding of a clip that is fitted beside longer ones.
    """
    anything = located.any(-1).long()
    return (anything.cumsum(-1) > 0) & (anything.flip(-1).cumsum(-1).flip(-1) > 0)


def share_of_frames(located: Bool[Tensor, "*batch frames 22"]) -> Float[Tensor, "*batch 22"]:
    """Return, for each joint, the share of the frames of `first_to_last` that locate it."""
    count = located.to(torch.get_default_dtype()).sum(-2)
    return count / first_to_last(located).sum(-1, keepdim=True).clamp(min=1)
