"""Points that stay away from the body that most points agree on, and why."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Float

from observations.timing import at_observation_times
from recon.diagnosis.named_points import NamedPoints, Points
from recon.findings import Code, Finding, listed, stretches
from recon.protocols import Estimate
from recon.skeleton import PARENTS

_FAR = 0.25
"""Metres from the body beyond which a single position is an outlier, whatever the noise."""
_NOISES = 6.0
"""Standard deviations of a coordinate beyond which a position is an outlier."""
_MANY = 0.02
"""Share of outliers that is worth a word."""
_AWAY = 0.08
"""Metres of median distance from which on a point may be away from its place throughout."""
_OTHERS = 3.0
"""Times the median distance of the other points, likewise."""
_STEADY = 0.5
"""Share of its distance within which an offset stays the same in the frame of the bone."""
_MOSTLY = 0.8
"""Quantile of its distances that must be as large; limbs return to a point that stands still."""
_STILL = 0.08
"""Metres from its middle within which a point that stands still in the room remains."""
_ALWAYS = 0.9
"""Share of the moments at which it does."""
_MOVED = 0.2
"""Metres that the body moves a point meanwhile (largest from the middle)."""
_BETTER = 0.5
"""Share of the distance that may remain when two points exchange their names."""
_SAVED = 0.08
"""Metres by which bones must become more like a person's by it."""


@dataclass(frozen=True)
class Predicted:
    """Where a body has the points, beside where they were seen."""

    points: NamedPoints
    positions: Float[np.ndarray, "moments points 3"]
    """Of the body, in the frame of the recording, metres; the nearest known beyond its frames."""
    turns: Float[np.ndarray, "moments points 3 3"]
    """Orientation of every point's bone."""

    @classmethod
    def of(cls, points: NamedPoints, observed: Points, estimate: Estimate) -> "Predicted":
        """The prediction of an estimate at the moments of the observation."""
        moments = observed.positions.shape[-3]
        with torch.no_grad():
            there, seen = at_observation_times(
                estimate.scene.to_recording(observed.predict(estimate)), estimate.motion,
                fps=observed.fps, start_time=observed.start_time, moments=moments,
            )  # fmt: skip
        covered = np.clip(np.arange(moments) - seen.start, 0, seen.stop - seen.start - 1)
        turns = estimate.body.orientations[0][:, list(points.bones)].double().numpy()
        frames = np.linspace(0, len(turns) - 1, seen.stop - seen.start).round().astype(int)
        return cls(points, there[0].double().numpy()[covered], turns[frames[covered]])

    @property
    def away(self) -> Float[np.ndarray, "moments points"]:
        """Distance of every visible point from its place, metres; NaN where not visible."""
        distance = np.linalg.norm(self.points.positions - self.positions, axis=-1)
        return np.where(self.points.visible, distance, np.nan)

    @property
    def typical(self) -> Float[np.ndarray, " points"]:
        """Median distance of every point, metres; zero for those never seen."""
        away = self.away.copy()
        away[:, ~self.points.visible.any(0)] = 0.0
        return np.nanmedian(away, axis=0)


def exchanged_points(predicted: Predicted) -> list[tuple[int, int]]:
    """Pairs of points that lie where the other one should be, throughout.

    Candidates are told by the body, and for joints by the bones they would be the ends of, as a
    body may cross its legs to reach exchanged ankles.
    """
    return _by_bones(predicted.points) or _by_place(predicted)


def _by_bones(points: NamedPoints) -> list[tuple[int, int]]:
    """The pair of joints whose exchange makes bones most like a person's, if it clearly does."""
    if not points.are_joints:
        return []
    spans = [(k, j) for j in range(len(points.bones)) for k in range(len(points.bones))
             if PARENTS[points.bones[j]] == points.bones[k]]  # fmt: skip
    size = _ratio(points, spans)
    best, pair = 0.0, None
    for a, b in combinations(range(len(points.bones)), 2):
        touched = [one for one in spans if a in one or b in one]
        if (a, b) in spans or (b, a) in spans or not touched:
            continue
        swap = {a: b, b: a}
        other = [(swap.get(k, k), swap.get(j, j)) for k, j in touched]
        own = sum(
            _misfit(points, got, want, size) for got, want in zip(touched, touched, strict=True)
        )
        new = sum(
            _misfit(points, got, want, size) for got, want in zip(other, touched, strict=True)
        )
        if own - new > max(best, _SAVED) and new < _BETTER * own:
            best, pair = own - new, (a, b)
    return [] if pair is None else [pair]


def _by_place(predicted: Predicted) -> list[tuple[int, int]]:
    points, typical = predicted.points, predicted.typical
    suspects = np.flatnonzero(typical > _least(typical))
    found: list[tuple[int, int]] = []
    for a, b in combinations(suspects.tolist(), 2):
        both = points.visible[:, a] & points.visible[:, b]
        if both.sum() < 3 or any(k in pair for pair in found for k in (a, b)):
            continue
        x, body = points.positions[both], predicted.positions[both]
        own = _median_distance(x[:, [a, b]], body[:, [a, b]])
        other = _median_distance(x[:, [b, a]], body[:, [a, b]])
        if other < _BETTER * own:
            found.append((a, b))
    return found


def _misfit(
    points: NamedPoints, got: tuple[int, int], want: tuple[int, int], size: float
) -> float:
    """Median difference of a distance from the length of a bone, metres; zero if never seen."""
    lengths = _distances(points, got)
    rest = size * float(np.linalg.norm(points.rest[want[0]] - points.rest[want[1]]))
    return float(np.median(np.abs(lengths - rest))) if len(lengths) else 0.0


def _ratio(points: NamedPoints, spans: list[tuple[int, int]]) -> float:
    """Median length of bones against those of the average body."""
    ratios = [
        float(np.median(lengths)) / float(np.linalg.norm(points.rest[a] - points.rest[b]))
        for a, b in spans
        if len(lengths := _distances(points, (a, b))) > 0
    ]
    return float(np.median(ratios)) if ratios else 1.0


def _distances(points: NamedPoints, pair: tuple[int, int]) -> Float[np.ndarray, " moments"]:
    both = points.visible[:, pair[0]] & points.visible[:, pair[1]]
    return np.linalg.norm(
        points.positions[both, pair[0]] - points.positions[both, pair[1]], axis=-1
    )


def misplaced_points(predicted: Predicted) -> tuple[NamedPoints, list[Finding]]:
    """The points without those that are away from their place throughout, and why they are."""
    points, typical = predicted.points, predicted.typical
    found: list[Finding] = []
    least, away = _least(typical), predicted.away
    for point in np.flatnonzero(points.visible.any(0)):
        seen = points.visible[:, point]
        if np.quantile(away[seen, point], _MOSTLY) < least:
            continue
        x, body = points.positions[seen, point], predicted.positions[seen, point]
        local = np.einsum("tij,ti->tj", predicted.turns[seen, point], x - body)
        offset = np.median(local, axis=0)
        steady = _median_norm(local - offset) < _STEADY * np.linalg.norm(offset)
        still = np.quantile(np.linalg.norm(x - np.median(x, axis=0), axis=-1), _ALWAYS) < _STILL
        moved = np.linalg.norm(body - np.median(body, axis=0), axis=-1).max() > _MOVED
        name = points.names[point]
        value = float(typical[point])
        if still and moved:
            found.append(_left_out("constant point", name, value, (
                f"{name} stays in one place in the room while the body moves away from it"
            )))  # fmt: skip
        elif steady and typical[point] > least:
            found.append(_left_out("offset point", name, value, (
                f"{name} is {100 * value:.0f} cm away from its place on the body throughout"
            )))  # fmt: skip
        else:
            continue
        hidden = np.zeros_like(points.visible)
        hidden[:, point] = True
        points = points.without(hidden)
    return points, found


def outliers(predicted: Predicted, noise: float) -> tuple[NamedPoints, Finding | None]:
    """The points without single positions that are far from the body, and their share."""
    points = predicted.points
    limit = max(_FAR, _NOISES * noise)
    far = points.visible & (np.nan_to_num(predicted.away) > limit)
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


def _left_out(code: Code, name: str, value: float, what: str) -> Finding:
    said = f"{what}; it was left out. Look at its label and its tracking"
    return Finding(code, said, (name,), (), value)


def _least(typical: Float[np.ndarray, " points"]) -> float:
    """Median distance from which on a point is suspicious, metres."""
    known = typical[typical > 0]
    return max(_AWAY, _OTHERS * float(np.median(known))) if len(known) > 0 else np.inf


def _median_norm(vectors: Float[np.ndarray, "rows 3"]) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=-1)))


def _median_distance(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(one - other, axis=-1), axis=0).sum())
