"""What carries a body: feet on one level, on several, or something else, as in sitting."""

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding, spans, stretches
from recon.diagnosis.motions.gravity import outside
from recon.diagnosis.motions.movement import Movement

_MAX_STANDING_SPEED_M_S = 0.2
"""Metres per second below which a foot or the centre of mass stands."""
_LEVELS = 0.08
"""Metres between two levels; soles of one floor differ less."""
_MIN_LEVEL_S = 0.3
"""Seconds for which a foot must stand on another level."""
_MIN_LEVEL_SHARE = 0.1
"""Share of the time of all standing feet for which feet must stand on another level."""
_MAX_BESIDE_M = 0.12
"""Metres by which the centre of mass may lie beside the feet while a body stands still."""
_LEAST_REST = 0.8
"""Seconds of rest beside the feet that make it sitting, lying or leaning."""
_BELOW = 0.3
"""Lengths of a leg by which a standing sole is below the pelvis."""
_SEATED, _INVERTED = 0.75, -0.2
"""Heights of the pelvis over the lower sole, in lengths of a leg, between which a body is not on
its feet alone: 1.2 for who stands, 0.7 for who sits on crossed legs, negative on the hands."""
_LEAST_FRAMES = 10


def support_findings(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> list[Finding]:
    """Feet that stand at several heights, and rests that feet alone cannot carry or hardly do.

    Args:
        motion: one clip, z up, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows; None means all.
    """
    movement = Movement.of(motion, body, observed)
    if movement.frames < _LEAST_FRAMES:
        return []
    return [*_uneven(movement), *(_carried(movement) or _low(movement))]


def standing_heights(movement: Movement) -> Float[np.ndarray, " time"]:
    """Height of the lower sole where it stands below the body, metres; NaN elsewhere."""
    lower = movement.sole_heights.argmin(1)
    rows = np.arange(movement.frames)
    speed = np.linalg.norm(np.gradient(movement.toes, axis=0), axis=-1) * movement.fps
    ankle = np.linalg.norm(np.gradient(movement.ankles, axis=0), axis=-1) * movement.fps
    height = movement.sole_heights[rows, lower]
    still = np.minimum(speed, ankle)[rows, lower] < _MAX_STANDING_SPEED_M_S
    below = movement.joints[:, 0, 2] > height + _BELOW * movement.leg
    return np.where(still & below, height, np.nan)


def _uneven(movement: Movement) -> list[Finding]:
    heights = standing_heights(movement)
    known = np.isfinite(heights)
    if known.sum() < _LEAST_FRAMES:
        return []
    floor = float(np.quantile(heights[known], 0.1))
    above = known & (np.nan_to_num(heights, nan=-np.inf) > floor + _LEVELS)
    long = max((last - first + 1 for first, last in stretches(above)), default=0)
    if above.sum() < _MIN_LEVEL_SHARE * known.sum() or long < _MIN_LEVEL_S * movement.fps:
        return []
    most = float(np.quantile(heights[above], 0.9)) - floor
    return [
        Finding(
            "uneven ground",
            f"feet stand at several heights, up to {most:.2f} m above the lowest: contacts are "
            "told on the level z = 0 only",
            value=most,
        )
    ]


def _carried(movement: Movement) -> list[Finding]:
    """Rests in which the centre of mass lies beside the feet: something else carries the body."""
    speed = np.linalg.norm(np.gradient(movement.centre, axis=0), axis=-1) * movement.fps
    corners = movement.soles[..., :2].reshape(movement.frames, 4, 2)
    beside = outside(movement.centre[:, :2], corners) > _MAX_BESIDE_M
    resting = beside & (speed < _MAX_STANDING_SPEED_M_S)
    return _rests(
        resting, movement, "rests beside its feet", "sitting, lying or leaning on something"
    )


def _low(movement: Movement) -> list[Finding]:
    """Stretches with the pelvis low over the soles, as of people who sit on crossed legs."""
    above = (movement.joints[:, 0, 2] - movement.sole_heights.min(1)) / movement.leg
    low = (above > _INVERTED) & (above < _SEATED)
    how = "sitting, kneeling, squatting or lying"
    return _rests(low, movement, "has its pelvis low over its feet", how)


def _rests(
    resting: Bool[np.ndarray, " time"], movement: Movement, what: str, how: str
) -> list[Finding]:
    frames = tuple(
        (first, last)
        for first, last in stretches(resting)
        if last - first + 1 > _LEAST_REST * movement.fps
    )
    if not frames:
        return []
    seconds = sum(last - first + 1 for first, last in frames) / movement.fps
    return [
        Finding(
            "uneven ground",
            f"for {seconds:.1f} s the body {what} ({spans(frames)}), {how}: contacts are told of "
            "feet, knees and hands with z = 0 only",
            (),
            frames,
            seconds,
        )
    ]
