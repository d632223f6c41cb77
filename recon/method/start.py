"""The caller's first guess, checked and converted to the body's precision."""

from collections.abc import Sequence

import torch

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.limits import ORTHOGONALITY, POSITION, SHAPE
from recon.core.motion import Motion
from recon.method.sensor import Sensor

_SLACK = 1e-3
"""Frames by which clocks that agree may differ."""


def checked_start(start: Motion, seen: Sequence[Sensor], body: BodyModel) -> Motion:
    """The start with all shape coefficients of the body, in its precision and on its device.

    It covers the time of at least one observation, at any rate; shape coefficients that are
    missing at the end are zero.

    Raises:
        ValueError: when it has another number of clips, covers another time, has more shape
            coefficients than the body, or holds what is no motion of a person.
    """
    if start.translation.ndim != 3:
        raise ReconError(
            "start: expected one leading axis of clips, translation (clips, time, 3); got the "
            f"shape {tuple(start.translation.shape)}; add it by indexing with [None]"
        )
    counts = sorted({one.clips for one in seen})
    if counts and (len(start.translation),) not in counts:
        raise ReconError(
            f"start: expected a motion of {counts[0][0]} clips, as observed, got "
            f"{len(start.translation)}"
        )
    if seen and not any(_covers_observation(start, one) for one in seen):
        first = seen[0]
        frames = int((first.moments - 1) / first.fps * start.fps + _SLACK) + 1
        raise ReconError(
            f"start: expected the time of an observation, {_span(first)}: {frames} frames at "
            f"{start.fps:g} per second from {first.start_time:g} s on; got {start.frames} frames "
            f"at {start.fps:g} from {start.start_time:g} s on; cut or hold the motion first"
        )
    missing = body.shape_size - start.shape.shape[-1]
    if missing < 0:
        raise ReconError(
            f"start: expected at most {body.shape_size} shape coefficients, those of the body "
            f"{body.name!r}, got {start.shape.shape[-1]}: it is a motion of another body"
        )
    product = start.rotations @ start.rotations.mT
    away = product - torch.eye(3, dtype=product.dtype, device=product.device)
    POSITION.check(start.translation.detach().cpu(), "start", "translation")
    ORTHOGONALITY.check(away.detach().abs().cpu(), "start", "rotations")
    SHAPE.check(start.shape.detach().cpu(), "start", "shape")
    shape = torch.nn.functional.pad(start.shape, (0, missing))
    like = body.template
    return start.replace(shape=shape).to(device=like.device, dtype=like.dtype)


def _covers_observation(start: Motion, seen: Sensor) -> bool:
    """Whether a motion begins with an observation and lasts as long, to within one frame."""
    first = (start.start_time - seen.start_time) * start.fps
    length = (seen.moments - 1) / seen.fps * start.fps
    spare = length - (start.frames - 1)
    return abs(first) <= _SLACK and -_SLACK <= spare < 1 - _SLACK


def _span(seen: Sensor) -> str:
    stop = seen.start_time + (seen.moments - 1) / seen.fps
    return f"{seen.start_time:g} s to {stop:g} s"
