"""Points that stay away from the body that most points agree on, and why."""

import numpy as np
from jaxtyping import Bool, Float

from recon.core.skeleton import ARMS
from recon.diagnosis.findings import Code, Finding, listed, stretches
from recon.diagnosis.points.named_points import NamedPoints, Predicted, least_away, out_of_reach
from recon.diagnosis.points.quick import plausible

_OUTLIER_M = 0.25
"""Metres from the body beyond which a single position is an outlier, whatever the noise."""
_NOISES = 6.0
"""Standard deviations of a coordinate beyond which a position is an outlier."""
_LEAP = 0.1
"""Metres between a position and the middle of its neighbours in time, by which points leap to
outliers and back; hands that punch turn around within 8 cm at 30 frames per second."""
_MANY = 0.02
"""Share of outliers that is worth a word."""
_AWAY = 0.08
"""Metres of median distance from which on a point may be away from its place throughout."""
_OTHERS = 3.0
"""Multiple of the other points' median distance from which on a point may be away throughout."""
_OFFSET_JOINTS, _OFFSET_MARKERS = 0.07, 0.15
"""Metres of a constant offset from which on a point is misplaced. Joints of other models are
within 4 cm of where the body has them; real markers of elbows and wrists are put up to 13 cm away
from the landmark that they are named after."""
_ONE_SIDED = 0.065
"""Metres by which a marker of the trunk or a leg may differ from the mirror image of its
counterpart: people put both in the same manner, so that a protocol of other places moves both.
Elbows and wrists, whose few markers leave the bone's twist open, differ by more."""
_MAX_LENGTH_SHARE, _MAX_LENGTH_STDS = 0.5, 2.0
"""Share of its length, and standard deviations of a coordinate, within which (the larger of both)
an offset stays the same in the frame of the bone."""
_MOSTLY = 0.8
"""Quantile of its distances that must be as large; limbs return to a point that stands still."""
_MAX_STILL_RADIUS_M = 0.08
"""Metres from its middle within which a point that stands still in the room remains."""
_ALWAYS = 0.9
"""Share of the moments at which it does."""
_MOVED = 0.2
"""Metres that the body moves a point meanwhile (largest from the middle)."""


def misplaced_points(predicted: Predicted, noise: float) -> tuple[NamedPoints, list[Finding]]:
    """The points without those that are away from their place throughout, and why they are."""
    points, typical = predicted.points, predicted.typical
    found: list[Finding] = []
    least, away = least_away(typical, _AWAY, _OTHERS), predicted.away
    offset, spread = predicted.offsets
    constant = np.linalg.norm(offset, axis=-1)
    if points.are_joints:
        displaced = constant > _OFFSET_JOINTS
    else:
        displaced = (constant > _OFFSET_MARKERS) | _one_sided(points, offset)
    unreached = out_of_reach(plausible(points), _OFFSET_JOINTS)
    steady = spread < np.maximum(_MAX_LENGTH_SHARE * constant, _MAX_LENGTH_STDS * noise)
    for point in np.flatnonzero(points.visible.any(0)):
        seen = points.visible[:, point]
        x, body = points.positions[seen, point], predicted.positions[seen, point]
        still = (
            np.quantile(np.linalg.norm(x - np.median(x, axis=0), axis=-1), _ALWAYS)
            < _MAX_STILL_RADIUS_M
        )
        moved = np.linalg.norm(body - np.median(body, axis=0), axis=-1).max() > _MOVED
        name = points.names[point]
        value = float(typical[point])
        if still and moved and np.quantile(away[seen, point], _MOSTLY) > least:
            found.append(_left_out("constant point", name, value, (
                f"{name} stays in one place in the room while the body moves away from it"
            )))  # fmt: skip
        elif unreached[point]:
            found.append(_left_out("offset point", name, value, (
                f"all bones that end at {name} have lengths that no person's have"
            )))  # fmt: skip
        elif steady[point] and displaced[point]:
            found.append(_left_out("offset point", name, value, (
                f"{name} is {100 * value:.0f} cm away from its place on the body throughout"
            )))  # fmt: skip
        else:
            continue
        hidden = np.zeros_like(points.visible)
        hidden[:, point] = True
        points = points.without(hidden)
    return points, found


def _one_sided(
    points: NamedPoints, offset: Float[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " points"]:
    """Markers of trunk and legs that are out of place while their counterparts are not."""
    mirrored = offset[list(points.counterparts)] * (-1.0, 1.0, 1.0)
    apart = np.linalg.norm(offset - mirrored, axis=-1)
    away, other = np.linalg.norm(offset, axis=-1), np.linalg.norm(mirrored, axis=-1)
    fixed = np.array([bone not in ARMS for bone in points.bones])
    return fixed & (apart > _ONE_SIDED) & (away > _ONE_SIDED) & (other < away / 2)


def outliers(predicted: Predicted, noise: float) -> tuple[NamedPoints, Finding | None]:
    """The points without single positions that are far from the body, and their share."""
    points = predicted.points
    limit = max(_OUTLIER_M, _NOISES * noise)
    far = points.visible & (np.nan_to_num(predicted.away) > limit)
    far = _entered_by_leaps(far, points, max(_LEAP, _NOISES * noise))
    share = float(far.sum() / max(points.visible.sum(), 1))
    if share == 0:
        return points, None
    kept = points.without(far)
    if share < _MANY:
        return kept, None
    joints = tuple(n for n, some in zip(points.names, np.any(far, axis=0), strict=True) if some)
    return kept, Finding(
        "outliers",
        f"{100 * share:.3g} % of the visible positions are more than {limit:.2f} m from the body "
        f"that the others agree on ({listed(joints)}); they were left out, and the others count "
        "robustly",
        joints,
        stretches(np.any(far, axis=1)),
        share,
    )


def _entered_by_leaps(
    far: Bool[np.ndarray, "moments points"], points: NamedPoints, leap: float
) -> Bool[np.ndarray, "moments points"]:
    """The stretches of far positions that a point leaps into and out of.

    A limb may be faster than the quick fit follows; it then leaves the body smoothly.
    """
    bend = np.zeros(far.shape)
    x = points.positions
    bend[1:-1] = np.linalg.norm(x[1:-1] - (x[:-2] + x[2:]) / 2, axis=-1)
    unknown = ~points.visible
    unknown[1:-1] |= ~points.visible[2:] | ~points.visible[:-2]
    bend[unknown] = np.inf
    kept = far.copy()
    for point in range(far.shape[1]):
        for first, last in stretches(far[:, point]):
            if min(bend[first, point], bend[last, point]) < leap:
                kept[first : last + 1, point] = False
    return kept


def _left_out(code: Code, name: str, value: float, what: str) -> Finding:
    said = f"{what}; it was left out. Look at its label and its tracking"
    return Finding(code, said, (name,), (), value)
