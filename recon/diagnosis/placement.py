"""Where and how large the body is: a floor at another height, everything scaled by one factor."""

import numpy as np
from jaxtyping import Float

from recon.body import BodyModel
from recon.diagnosis.named_points import NamedPoints
from recon.findings import Finding
from recon.motion import Motion
from recon.skeleton import FEET, PARENTS
from recon.upright import sole_heights

_FLOOR_JOINTS, _FLOOR_MARKERS = 0.04, 0.07
"""Metres by which standing soles may miss the ground of a recording that knows it: carpets, what a
body's soles differ from a person's, and, for markers, shoes and where on them they sit."""
_FLOOR_NOISE = 1.0
"""Times the noise of a coordinate, likewise."""
_SMALLEST, _LARGEST = 0.72, 1.25
"""Sizes against the average body, about 1.70 m tall, that grown people and older children have."""
_FEWEST_FEET = 0.3
"""Share of moments at which a foot must be seen for its height to count."""


def floor_height(points: NamedPoints, motion: Motion, body: BodyModel, noise: float) -> float:
    """Height of the ground below a quick fit, metres; zero where it is at z = 0 or feet hid."""
    feet = [k for k, bone in enumerate(points.bones) if bone in FEET]
    if not feet or points.visible[:, feet].any(1).mean() < _FEWEST_FEET:
        return 0.0
    height = float(sole_heights(motion, body)[0])
    least = _FLOOR_JOINTS if points.are_joints else _FLOOR_MARKERS
    return height if abs(height) > max(least, _FLOOR_NOISE * noise) else 0.0


def floor_finding(height: float) -> Finding:
    """What is said where the ground was moved."""
    return Finding(
        "floor",
        f"the soles stand {100 * abs(height):.0f} cm {'above' if height > 0 else 'below'} the "
        "recording's ground at z = 0; the height of the ground was estimated instead. If the "
        "person stands on something, give --no-repair",
        value=height,
    )


def size(points: NamedPoints) -> float | None:
    """Size of the body against the average one: median ratio of distances along bones.

    None where too few such distances are seen.
    """
    ratios: list[float] = []
    for a, b in _spans(points):
        both = points.visible[:, a] & points.visible[:, b]
        if both.sum() < 3:
            continue
        length = np.linalg.norm(points.positions[both, a] - points.positions[both, b], axis=-1)
        ratios.append(float(np.median(length) / _length(points.rest, a, b)))
    return float(np.median(ratios)) if len(ratios) >= 4 else None


def scale_findings(points: NamedPoints) -> list[Finding]:
    """Whether everything is larger or smaller than people are by one factor."""
    ratio = size(points)
    if ratio is None or _SMALLEST < ratio < _LARGEST:
        return []
    return [
        Finding(
            "scale",
            f"the body is {ratio:.2f} times as large as an average person ({1.7 * ratio:.2f} m "
            "tall); check the unit and the scale of the recording (--unit)",
            value=ratio,
        )
    ]


def _spans(points: NamedPoints) -> list[tuple[int, int]]:
    """Pairs of points on neighbouring bones that are at least 10 cm apart at rest."""
    bones = points.bones
    count = range(len(bones))
    return [
        (a, b)
        for a in count
        for b in count
        if (PARENTS[bones[b]] == bones[a] or (bones[a] == bones[b] and a < b))
        and _length(points.rest, a, b) > 0.1
    ]


def _length(rest: Float[np.ndarray, "points 3"], a: int, b: int) -> float:
    return float(np.linalg.norm(rest[a] - rest[b]))
