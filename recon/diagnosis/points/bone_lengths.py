"""Distances of points along bones: the size of a body, and joints that its bones do not reach."""

import numpy as np
from jaxtyping import Bool, Float

from recon.core.skeleton import PARENTS
from recon.diagnosis.points.named_points import NamedPoints

_LONG = 0.1
"""Metres of distance at rest from which on a pair of points tells the size of a body."""
_FEWEST_PAIRS, _FEWEST_MOMENTS = 4, 3
_CONSTANT = 0.5
"""Share of its error up to which a length may vary where a joint is misplaced by a constant."""


def size(points: NamedPoints) -> float | None:
    """Size of the body against the average one: median ratio of distances along bones.

    None where too few such distances are seen.
    """
    pairs = [pair for pair in _along_bones(points) if rest_length(points, *pair) > _LONG]
    ratios = [
        float(np.median(seen)) / rest_length(points, a, b)
        for a, b in pairs
        if len(seen := distances(points, a, b)) >= _FEWEST_MOMENTS
    ]
    return float(np.median(ratios)) if len(ratios) >= _FEWEST_PAIRS else None


def out_of_reach(points: NamedPoints, limit: float) -> Bool[np.ndarray, " points"]:
    """Joints whose bones to all of their neighbours are longer or shorter than a person's.

    Args:
        points: joints; of markers none is told.
        limit: metres by which the median length of each bone differs from the average body's
            of the same size.
    """
    wrong: list[list[bool]] = [[] for _ in points.names]
    ratio = size(points)
    if ratio is None or not points.are_joints:
        return np.zeros(len(wrong), dtype=bool)
    for a, b in joint_pairs(points):
        seen = distances(points, a, b)
        if len(seen) < _FEWEST_MOMENTS:
            continue
        middle = float(np.median(seen))
        error = abs(middle - ratio * rest_length(points, a, b))
        spread = float(np.median(np.abs(seen - middle)))
        for one in (a, b):
            wrong[one].append(error > limit and spread < _CONSTANT * error)
    # the end of a wrong bone that has other, right bones is where it should be
    return np.array([len(bones) > 0 and all(bones) for bones in wrong])


def _along_bones(points: NamedPoints) -> list[tuple[int, int]]:
    """Numbers of points on one bone, and of joints at its two ends."""
    if points.rigid is not None:
        return list(points.rigid)
    bones, count = points.bones, range(len(points.bones))
    return [
        (a, b)
        for a in count
        for b in count
        if PARENTS[bones[b]] == bones[a] or (bones[a] == bones[b] and a < b)
    ]


def joint_pairs(points: NamedPoints) -> list[tuple[int, int]]:
    """Numbers of joints at the two ends of a bone, the parent first, or of rigid pairs."""
    if points.rigid is not None:
        return list(points.rigid)
    bones, count = points.bones, range(len(points.bones))
    return [(a, b) for b in count for a in count if PARENTS[bones[b]] == bones[a]]


def distances(points: NamedPoints, a: int, b: int) -> Float[np.ndarray, " moments"]:
    """Distances between two points, metres, wherever both are seen."""
    both = points.visible[:, a] & points.visible[:, b]
    return np.linalg.norm(points.positions[both, a] - points.positions[both, b], axis=-1)


def rest_length(points: NamedPoints, a: int, b: int) -> float:
    """Distance of two points on the average body in its rest pose, metres."""
    return float(np.linalg.norm(points.rest[a] - points.rest[b]))
