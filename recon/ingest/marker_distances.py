"""Distances and relative positions of the markers of a set, and naming of points by them.

Distances between markers on one segment hardly change; others say less. Mirror images have the
same distances: places seen from three other markers tell them apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_BENDING = 0.25
"""Standard deviation of a distance that other poses change, relative to it."""
_RIGID = 0.02
"""Metres: pairs of markers whose distance poses change by less are on one segment."""
_USUAL, _WRONG = (0.25, 0.75), 0.1
"""Shares of distances that are as in the trial, of pairs on different segments and on one; and of
all pairs that are not what they seem."""
_TRIADS, _EACH, _ALIKE = 200, 6, 0.5
"""Triads of markers that are tried, those that tell most about each marker, and the weight of
each: they tell much the same."""
_WIDTH = 0.05
"""Metres that the third marker of a triad is from the line through the others, at least."""


@dataclass(frozen=True)
class MarkerDistances:
    """Distances between the markers of a set, and their positions in frames of marker triads."""

    names: tuple[str, ...]
    means: Float[np.ndarray, "2 markers markers"]
    """Metres: in one trial, and in all poses."""
    spreads: Float[np.ndarray, "2 markers markers"]
    """Standard deviations, metres; infinite where nothing is known."""
    triads: Int[np.ndarray, "triads 3"]
    best: Int[np.ndarray, "markers some"]
    """The triads that tell most about each marker."""
    places: Float[np.ndarray, "markers some 3"]
    """Its place in the axes of these, metres."""
    scatters: Float[np.ndarray, "markers some 3"]
    """Standard deviations along the axes."""

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        trial: Float[np.ndarray, "time markers 3"],
        poses: Float[np.ndarray, "poses markers 3"],
        noise: float,
    ) -> "MarkerDistances":
        """Distances in the frames of a trial and in poses of a body; NaN where not known.

        Args:
            names: of the markers.
            trial: some of its frames.
            poses: of a body that has the markers.
            noise: of a distance, metres.
        """
        far_mean, far_spread = _distances(poses, noise)
        near_mean, near_spread = _distances(trial, noise)
        bent = np.hypot(near_spread, _BENDING * near_mean)
        lacks = ~np.isfinite(far_spread)
        far_mean, far_spread = np.where(lacks, (near_mean, bent), (far_mean, far_spread))
        alone = ~np.isfinite(near_spread)
        near_mean, near_spread = np.where(alone, (far_mean, far_spread), (near_mean, near_spread))
        every = np.concatenate((trial, poses))
        triads, best, places, scatters = _seen_from_triads(every, noise)
        return cls(
            tuple(names), np.stack((near_mean, far_mean)), np.stack((near_spread, far_spread)),
            triads, best, places, scatters,
        )  # fmt: skip

    def log_odds(
        self, mean: np.ndarray, variance: np.ndarray | float, i: np.ndarray, j: np.ndarray
    ) -> np.ndarray:
        """Log-likelihood ratio of a distance: between markers i and j, against any two points.

        Args:
            mean: of the distance over frames, metres.
            variance: of it over frames, square metres.
            i: one marker.
            j: the other.
        """
        usual = np.where(self.spreads[1] < _RIGID, _USUAL[1], _USUAL[0])[i, j]
        odds = np.log(_WRONG)
        with np.errstate(divide="ignore", invalid="ignore"):
            for share, middle, spread in zip(
                (usual, 1 - _WRONG - usual),
                self.means[:, i, j],
                self.spreads[:, i, j],
                strict=True,
            ):
                square = (mean - middle) ** 2 + variance
                odds = np.logaddexp(
                    odds, np.log(share / (2.5066 * spread)) - square / (2 * spread**2)
                )
        return np.where(np.isfinite(odds), odds, 0.0)

    def odds_of_places(
        self,
        named: Float[np.ndarray, "frames markers 3"],
        points: Float[np.ndarray, "frames points 3"],
        own: Int[np.ndarray, " points"],
        hand: float = 1.0,
    ) -> Float[np.ndarray, "points markers"]:
        """Log-likelihood ratios: points where a marker is expected, against points anywhere.

        Args:
            named: markers that are known, metres; NaN where not.
            points: asked for.
            own: the marker that each point is among `named`, or -1.
            hand: -1 for a mirror image.
        """
        origin, axes = _axes(named, self.triads)
        seen = np.einsum("fqij,fqpj->fqpi", axes, points[:, None] - origin[:, :, None])
        seen[..., 2] *= hand
        seen[:, (self.triads[:, :, None] == own).any(1)] = np.nan
        away = (seen[:, self.best] - self.places[None, :, :, None]) / self.scatters[
            None, :, :, None
        ]
        size = np.log(15.75 * self.scatters.prod(-1))[None, :, :, None]
        odds = np.logaddexp(np.log(1 - _WRONG) - 0.5 * (away**2).sum(-1) - size, np.log(_WRONG))
        return _ALIKE * np.nansum(np.nan_to_num(np.nanmean(odds, 0)), axis=1).T


def _axes(
    x: Float[np.ndarray, "frames markers 3"], triads: Int[np.ndarray, "triads 3"]
) -> tuple[np.ndarray, np.ndarray]:
    """Origin and axes (as rows) of triads in every frame; NaN where one is missing."""
    a, b, c = (x[:, triads[:, k]] for k in range(3))
    with np.errstate(invalid="ignore", divide="ignore"):
        one = (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)
        up = np.cross(one, c - a)
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
    return (a + b + c) / 3, np.stack((one, np.cross(up, one), up), -2)


def _seen_from_triads(
    x: Float[np.ndarray, "time markers 3"], noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The triads that locate each marker best, its position in their frames, and the scatter."""
    count = x.shape[1]
    triads = np.random.default_rng(0).integers(count, size=(_TRIADS, 3))
    triads = triads[[len(set(row)) == 3 for row in triads.tolist()]]
    a, b, c = (x[:, triads[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=-1) / np.linalg.norm(b - a, axis=-1)
    triads = triads[np.nanmedian(area, 0) > _WIDTH]
    origin, axes = _axes(x, triads)
    seen = np.einsum("fqij,fqpj->fqpi", axes, x[:, None] - origin[:, :, None])
    low, middle, high = np.nanquantile(seen, (0.16, 0.5, 0.84), axis=0)
    scatter = np.hypot((high - low) / 2, 2 * noise)
    vague = np.nan_to_num(np.log(scatter).sum(-1), nan=np.inf)
    vague[np.arange(len(triads))[:, None], triads] = np.inf
    best = np.argsort(vague, axis=0)[:_EACH].T
    markers = np.arange(count)[:, None]
    unknown = np.isinf(vague[best, markers])
    places, scatters = middle[best, markers], scatter[best, markers]
    places[unknown] = np.nan
    return triads, best, places, scatters


def _distances(
    x: Float[np.ndarray, "time markers 3"], noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Median and half the width of two thirds of the distances of all pairs; inf if unknown."""
    away = np.linalg.norm(x[:, :, None] - x[:, None], axis=-1)
    known = np.isfinite(away).any(0)
    away[:, ~known] = 0.0
    low, mean, high = np.nanquantile(away, (0.16, 0.5, 0.84), axis=0)
    return mean, np.where(known, np.hypot((high - low) / 2, noise), np.inf)


_STEPS, _JUMPS, _SHARPNESS = 40, 0.3, 30.0
"""Iterations, share and exponent of reweighted random walks."""


def matched(
    model: MarkerDistances,
    mean: Float[np.ndarray, "points points"],
    variance: Float[np.ndarray, "points points"],
    points: Float[np.ndarray, "frames points 3"],
    sides: Int[np.ndarray, " markers"],
) -> Int[np.ndarray, " points"]:
    """The marker of every point by distances and places alone, or -1.

    Reweighted random walks (Cho, Lee and Lee, 2010), then the best marker of every point given
    those of the others, until nothing changes.

    Args:
        model: distances of the markers.
        mean: distances of the points, means over frames, metres; NaN where unknown.
        variance: their variances over frames.
        points: in some frames.
        sides: the marker of the other side of each, -1 if unknown.
    """
    count, markers = len(mean), len(model.names)
    i, j = np.arange(markers)[:, None], np.arange(markers)
    odds = np.zeros((count, markers, count, markers), np.float32)
    for a in range(count):
        found = model.log_odds(mean[a][:, None, None], variance[a][:, None, None], i, j)
        odds[a] = np.where(np.isfinite(found), found, 0.0).transpose(1, 0, 2)
        odds[a, :, a] = 0.0
    odds[:, j, :, j] = 0.0
    table = np.maximum(odds, 0.0).reshape(count * markers, -1)
    x = np.full(len(table), 1 / len(table), np.float32)
    for _ in range(_STEPS):
        y = table @ x
        z = np.exp(_SHARPNESS * (y / y.max() - 1)).reshape(count, markers)
        for _ in range(10):
            z /= np.maximum(z.sum(1, keepdims=True), 1e-3)
            z /= np.maximum(z.sum(0, keepdims=True), 1e-3)
        x = (1 - _JUMPS) * y / y.sum() + _JUMPS * z.ravel() / z.sum()
    start = _assigned(x.reshape(count, markers))

    def by_pairs(found: np.ndarray) -> np.ndarray:
        held = np.flatnonzero(found >= 0)
        return odds[:, :, held, found[held]].sum(-1)

    def by_places(found: np.ndarray, hand: float = 1.0) -> np.ndarray:
        named = np.full((len(points), markers, 3), np.nan)
        held = np.flatnonzero(found >= 0)
        named[:, found[held]] = points[:, held]
        return model.odds_of_places(named, points, found, hand)

    def total(value: np.ndarray, found: np.ndarray) -> float:
        held = np.flatnonzero(found >= 0)
        return float(value[held, found[held]].sum())

    for _ in range(5):
        start = _assigned(by_pairs(start))
    if total(by_places(start, -1.0), start) > total(by_places(start), start):
        start = np.where(start >= 0, sides[start], -1)
    best, most = start, -np.inf
    for share in (1.0, 0.5, 0.2, 0.0, 1.0):
        found = best
        for _ in range(6):
            pairs, places = by_pairs(found), by_places(found)
            now = total(pairs, found) / 2 + total(places, found)
            if now > most:
                best, most = found, now
            found = _assigned(share * pairs + places)
    return best


def _assigned(value: Float[np.ndarray, "points markers"]) -> Int[np.ndarray, " points"]:
    """The markers of points whose values sum up to most; -1 rather than a value below 0."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(-np.maximum(value, 0.0))
    found = np.full(len(value), -1)
    good = value[rows, columns] > 0
    found[rows[good]] = columns[good]
    return found
