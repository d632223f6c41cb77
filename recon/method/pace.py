"""Reduces the frame rate of data that were recorded much faster than a body moves.

A body moves at a few hertz, and priors of motion work at 30 Hz. Data at 300 Hz show the same
motion with less noise, so a fit takes means over neighbouring frames at about 60 Hz: its cost then
depends on the seconds that it covers and not on the number of frames.
"""

import math
from typing import Any, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from recon.method.sensor import Sensor

PACE = 60.0
"""Lowest frame rate to which a fit reduces fast data, frames per second."""
_FASTER = 1.5
"""Data with a frame rate of up to this multiple of the wanted one stay as they are."""

S = TypeVar("S", bound=Sensor)


def paced(sensor: S, pace: float = PACE) -> S:
    """Return a sensor's data averaged to about `pace` Hz, or unchanged where that is impossible.

    Named points are averaged over neighbouring frames, for moments at most `1 / pace` seconds
    apart that include the first and the last frame. Clouds keep every n-th frame, as their points
    have no names by which to average them. A sensor is returned unchanged if it is not clearly
    faster than `pace`, if most of its frames are empty, if its camera moves, or if it is a class
    of the user's own without named points.
    """
    filled = sensor.shown.any(-1)
    fast = sensor.fps > _FASTER * pace and sensor.moments > 2
    if not fast or 2 * int(filled.sum()) < filled.numel():
        return sensor
    if sensor.sees == "surface":
        step = int(sensor.fps / pace)
        fewer: dict[str, Any] = {"fps": sensor.fps / step}
        return sensor.derived(**fewer, **sensor.fields_at(range(0, sensor.moments, step)))
    view = sensor.view
    if sensor.named is None and (view is None or view.camera.T_camera_world.shape[-3] > 1):
        return sensor
    return _averaged_in_time(sensor, pace)


def _averaged_in_time(sensor: S, pace: float) -> S:
    """Return a sensor's named points averaged around evenly spaced times, both ends included.

    Each frame counts for the nearest of these times alone. If the frames of a time are not
    centred on it, as at the ends and beside gaps, a line fitted to the frames within one step
    gives the velocity by which their mean is moved to that time.
    """
    count = math.ceil((sensor.moments - 1) / sensor.fps * pace - 1e-6) + 1
    step = (sensor.moments - 1) / (count - 1)
    middle = torch.arange(count, dtype=torch.float64) * step
    near = torch.arange(-math.ceil(step), math.ceil(step) + 1)
    frame = middle.round().long()[:, None] + near
    away = frame - middle[:, None]
    exists = (frame >= 0) & (frame < sensor.moments) & (away.abs() <= step + 1e-6)
    device, axis = sensor.shown.device, len(sensor.clips)
    frame = frame.clamp(0, sensor.moments - 1).to(device)

    def in_neighbourhoods(values: Tensor) -> Tensor:
        """Gather the frames near each output time, (clips, moments, near, points, ...)."""
        return values.index_select(axis, frame.flatten()).unflatten(axis, frame.shape)

    # energies contain squared weights, so means are taken with squared weights, too
    weights, values = (
        in_neighbourhoods(sensor.weights.to(sensor.values).square()),
        in_neighbourhoods(sensor.values),
    )
    weights = weights * exists.to(weights)[:, :, None]
    own_share = (away > 1e-6 - step / 2) & (away < step / 2 + 1e-6)
    held = weights * own_share.to(weights)[:, :, None]
    late = away.to(values)[:, :, None, None].expand(*values.shape[:-1], 1)
    mean, when = _mean(values, held), _mean(late, held)
    apart = late - _mean(late, weights).unsqueeze(-3)
    risen = values - _mean(values, weights).unsqueeze(-3)
    spread, rise = _mean(apart.square(), weights), _mean(apart * risen, weights)
    # two adjacent frames have times of variance 1/4; one frame alone (variance 0) gives no speed
    speed = torch.where(spread > 0.1, rise / spread.clamp(min=0.1), 0.0)
    shown = held.sum(-2) > 0
    found = (mean - speed * when).where(shown[..., None], 0.0)
    own: dict[str, Any] = {sensor.timed[0]: found, "fps": sensor.fps / step}
    for name in sensor.timed[1:]:
        value = getattr(sensor, name)
        if value is None or value.ndim > shown.ndim:
            own[name] = None  # other points, such as those of fingers, are not fitted here
            continue
        if value.dtype == torch.bool:
            own[name] = shown
        else:  # confidences or standard deviations: means, since errors of near frames are alike
            own[name] = _mean(in_neighbourhoods(value)[..., None], (held > 0).to(value))[..., 0]
    return sensor.derived(**own)


def _mean(
    values: Float[Tensor, "*batch moments near points dims"],
    weights: Float[Tensor, "*batch moments near points"],
) -> Float[Tensor, "*batch moments points dims"]:
    """Return the weighted mean over the axis `near` of frames; zero where all weights are zero."""
    total = weights.sum(-2)[..., None].clamp(min=1e-9)
    return (weights[..., None] * values).sum(-3) / total
