"""Brings views of one clip onto one clock, and a first guess to the time of all sensors."""

import math
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.method.sensor import Sensor

_LONGEST_PAUSE_S = 30.0
"""Seconds that may lie between the end of one sensor's data and the beginning of another's."""
_ONE_FRAME = 0.05
"""Largest difference, in frames, of moments of two views that count as one frame."""


def on_common_clock(observations: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Pad views of fixed cameras with empty frames, so that all begin and end at the same time.

    So films that begin or end at different moments are compared with each other. Views of another
    rate, or whose frames lie between those of the first, stay as they are.
    """
    out = list(observations)
    fixed = [k for k, one in enumerate(out)
             if one.view and one.view.camera.T_camera_world.shape[-3] == 1]  # fmt: skip
    start = min((out[k].start_time for k in fixed), default=0.0)
    latest = start + _LONGEST_PAUSE_S + max((out[k].duration for k in fixed), default=0.0)
    first = {k: (out[k].start_time - start) * out[k].fps for k in fixed}
    shared = [k for k in fixed if out[k].fps == out[fixed[0]].fps and out[k].start_time < latest
              and abs(first[k] - round(first[k])) < _ONE_FRAME]  # fmt: skip
    total = max((round(first[k]) + out[k].moments for k in shared), default=0)
    for k in shared:
        one, before = out[k], round(first[k])
        after = total - before - one.moments
        if before + after > 0:
            pad = partial(_padded, axis=len(one.clips), before=before, after=after)
            out[k] = one.derived(start_time=start, **one.map_frames(pad))
    return tuple(out)


def _padded(values: Tensor, *, axis: int, before: int, after: int) -> Tensor:
    """Return values with frames of zeros before and after."""
    return torch.nn.functional.pad(values, (*[0, 0] * (values.ndim - 1 - axis), before, after))


def over_all_data(motion: Motion, observations: Sequence[Sensor], body: BodyModel) -> Motion:
    """Return a motion that also lasts while only other sensors saw the person.

    At these times it is the guess of a sensor that measures the surface, or the nearest pose.

    Raises:
        ObservationError: when no sensor saw anything for longer than `_LONGEST_PAUSE_S`, as if
            their clocks did not begin at the same moment.
    """
    spans = sorted((one.start_time, one.start_time + one.duration) for one in observations)
    end = spans[0][1]
    for start, stop in spans:
        if start - end > _LONGEST_PAUSE_S:
            said = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in spans)
            raise ObservationError(
                f"expected observations of one recording on one clock, got times of {said}; give "
                "start times on one clock, or fit them one by one"
            )
        end = max(end, stop)
    early, late = motion.start_time - spans[0][0], end - motion.stop_time
    before, after = (max(0, math.ceil(x * motion.fps - 0.5)) for x in (early, late))
    if before + after == 0 or not bool(motion.valid.all()):
        return motion
    start = motion.start_time - before / motion.fps
    times = start + torch.arange(before + motion.frames + after, dtype=torch.float64) / motion.fps
    found = motion.at(times.clamp(motion.start_time, motion.stop_time), motion.fps)
    found = found.replace(start_time=start)
    for cloud in [one.cloud for one in observations if one.cloud]:
        guess = cloud.start(body)
        own = (times >= guess.start_time) & (times <= guess.stop_time)
        own &= (times < motion.start_time) | (times > motion.stop_time)
        part = guess.at(times[own], motion.fps)
        found.translation[..., own, :] = part.translation
        found.rotations[..., own, :, :, :] = part.rotations
    return found
