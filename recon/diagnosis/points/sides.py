"""Left and right exchanged: in a stretch, by continuity; throughout, by which body fits better.

Nobody's left and right change places within a frame. Where the points of both sides jump to each
other's place, the names were exchanged, and back again at the next such jump. Which of the two
kinds of stretch is right, a body tells: knees, elbows and feet bend one way only.
"""

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.points.named_points import NamedPoints

_FASTEST = 0.1
"""Seconds between two moments beyond which limbs may have changed places."""
_LESS = 0.6
"""Share of the way that points must go to their own last places, below which going to the other
side's last places means that names were exchanged."""
_LEAST = 0.1
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
    return bool(saved > _LEAST and other.mean() < _LESS * same.mean())


def _parity(flips: Bool[np.ndarray, " moments"]) -> Bool[np.ndarray, " moments"]:
    """True after an odd number of exchanges; nothing where they do not come in a sane number."""
    odd = np.cumsum(flips) % 2 == 1
    return odd if flips.sum() <= max(2, len(flips) // 8) else np.zeros_like(odd)
