"""Two points that carry each other's name, throughout or in a stretch."""

from functools import cache
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import stretches
from recon.diagnosis.points.named_points import (
    NamedPoints,
    Predicted,
    distances,
    joint_pairs,
    rest_length,
    size,
)

_MAX_REMAINING_SHARE = 0.5
"""Share of the distance that may remain when two points exchange their names."""
_SAVED = 0.08
"""Metres by which bones must become more like a person's by it."""
_NEARER = 0.15
"""Metres by which both points together must come nearer to their places in a frame."""
_NOISES = 6.0
"""Standard deviations of a coordinate by which both points together must come nearer."""
_GAP, _SHORTEST = 2, 2
"""Frames between exchanged frames that are exchanged, too; and frames of the shortest stretch."""


def exchanged_throughout(points: NamedPoints) -> tuple[int, int] | None:
    """The two joints whose exchange makes bones most like a person's, if it clearly does.

    A body may cross its legs to reach exchanged ankles, but it cannot change its bones.
    """
    if not points.are_joints:
        return None
    spans, ratio = joint_pairs(points), size(points) or 1.0

    @cache  # bones are compared again for every two joints that one of them touches
    def misfit(got: tuple[int, int], want: tuple[int, int]) -> float:
        return _misfit(points, got, want, ratio)

    best, pair = 0.0, None
    for a, b in combinations(range(len(points.bones)), 2):
        touched = [one for one in spans if a in one or b in one]
        if (a, b) in spans or (b, a) in spans or not touched:
            continue
        swap = {a: b, b: a}
        other = [(swap.get(k, k), swap.get(j, j)) for k, j in touched]
        own = sum(misfit(bone, bone) for bone in touched)
        new = sum(misfit(got, want) for got, want in zip(other, touched, strict=True))
        if own - new > max(best, _SAVED) and new < _MAX_REMAINING_SHARE * own:
            best, pair = own - new, (a, b)
    return pair


def exchanged_moments(
    predicted: Predicted, noise: float
) -> list[tuple[tuple[int, int], Bool[np.ndarray, " moments"]]]:
    """Pairs of points that lie in each other's place on the body, and when."""
    points = predicted.points
    away = np.linalg.norm(points.positions[:, :, None] - predicted.positions[:, None], axis=-1)
    nearer = max(_NEARER, _NOISES * noise)
    found: list[tuple[float, tuple[int, int], Bool[np.ndarray, " moments"]]] = []
    for a, b in combinations(range(len(points.names)), 2):
        own, other = away[:, a, a] + away[:, b, b], away[:, a, b] + away[:, b, a]
        both = points.visible[:, a] & points.visible[:, b]
        surely = both & (own - other > nearer) & (other < _MAX_REMAINING_SHARE * own)
        moments = _runs(_grown(surely, both & (own - other > noise)))
        if moments.any():
            found.append((float((own - other)[moments].sum()), (a, b), moments & both))
    taken: set[int] = set()
    kept: list[tuple[tuple[int, int], Bool[np.ndarray, " moments"]]] = []
    for _, pair, moments in sorted(found, key=lambda one: -one[0]):
        if not taken & set(pair):
            taken |= set(pair)
            kept.append((pair, moments))
    return kept


def _grown(
    surely: Bool[np.ndarray, " moments"], likely: Bool[np.ndarray, " moments"]
) -> Bool[np.ndarray, " moments"]:
    """The stretches of likely moments that hold a sure one.

    Limbs that pass each other come too near to tell for a moment within an exchanged stretch.
    """
    grown = surely.copy()
    for first, last in stretches(likely):
        grown[first : last + 1] |= surely[first : last + 1].any()
    return grown


def _runs(flags: Bool[np.ndarray, " moments"]) -> Bool[np.ndarray, " moments"]:
    """Flags with short gaps closed and short runs left out."""
    closed = flags.copy()
    for first, last in stretches(~flags):
        if first > 0 and last < len(flags) - 1 and last - first < _GAP:
            closed[first : last + 1] = True
    for first, last in stretches(closed):
        if last - first + 1 < _SHORTEST:
            closed[first : last + 1] = False
    return closed


def _misfit(
    points: NamedPoints, got: tuple[int, int], want: tuple[int, int], ratio: float
) -> float:
    """Median difference of a distance from the length of a bone, metres; zero if never seen."""
    lengths = distances(points, *got)
    rest = ratio * rest_length(points, *want)
    return float(np.median(np.abs(lengths - rest))) if len(lengths) else 0.0


_FASTEST = 0.1
"""Seconds between two moments beyond which limbs may have changed places."""
_LESS = 0.6
"""Share of the way that points must go to their own last places, below which going to the other
side's last places means that names were exchanged."""
_MIN_SAVED_M = 0.1
"""Metres per point that must be saved by it; below, both sides were in the same place."""


def find_exchanges(points: NamedPoints) -> Bool[np.ndarray, " moments"]:
    """The moments at which left and right are exchanged against the first moment."""
    return _parity(_flips(points, _pairs(points)))


def exchanged_pairs(
    points: NamedPoints,
) -> list[tuple[tuple[int, int], Bool[np.ndarray, " moments"]]]:
    """Single pairs of counterparts that jump to each other's place and back again, and when."""
    found: list[tuple[tuple[int, int], Bool[np.ndarray, " moments"]]] = []
    for pair in _pairs(points):
        flips = _flips(points, [pair])
        moments = _parity(flips)
        if moments.any() and flips.sum() % 2 == 0:  # else nobody knows on which side they began
            found.append((pair, moments & points.visible[:, pair[0]] & points.visible[:, pair[1]]))
    return found


def _pairs(points: NamedPoints) -> list[tuple[int, int]]:
    return [(k, other) for k, other in enumerate(points.counterparts) if k < other]


def _flips(points: NamedPoints, pairs: list[tuple[int, int]]) -> Bool[np.ndarray, " moments"]:
    """Moments at which these pairs, taken together, jump to each other's place."""
    moments = len(points.visible)
    flips = np.zeros(moments, dtype=bool)
    if not pairs:
        return flips
    left, right = (list(side) for side in zip(*pairs, strict=True))
    seen = points.visible[:, left] & points.visible[:, right]
    x = np.stack((points.positions[:, left], points.positions[:, right]), 2)
    last = np.full(len(pairs), -1)
    for t in range(moments):
        known = seen[t] & (last >= 0) & ((t - last) / points.fps <= _FASTEST)
        if known.any():
            before = x[last[known], np.flatnonzero(known)]
            flips[t] = _exchanged(before, x[t, known])
        last = np.where(seen[t], t, last)
    return flips


def _exchanged(
    before: Float[np.ndarray, "pairs 2 3"], after: Float[np.ndarray, "pairs 2 3"]
) -> bool:
    """Whether the pairs moved less if their sides were exchanged."""
    same = np.linalg.norm(after - before, axis=-1).sum(-1)
    other = np.linalg.norm(after[:, ::-1] - before, axis=-1).sum(-1)
    saved = np.clip(same - other, -1.0, 1.0).mean() / 2
    return bool(saved > _MIN_SAVED_M and other.mean() < _LESS * same.mean())


def _parity(flips: Bool[np.ndarray, " moments"]) -> Bool[np.ndarray, " moments"]:
    """True after an odd number of exchanges; nothing where they do not come in a sane number."""
    odd = np.cumsum(flips) % 2 == 1
    return odd if flips.sum() <= max(2, len(flips) // 8) else np.zeros_like(odd)
