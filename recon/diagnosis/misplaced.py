"""Finds 3D points that are not where they should be: exchanged, displaced, or outliers."""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from recon.core.arrays import finite_median
from recon.core.skeleton import ARMS, MIRROR, PARENTS
from recon.diagnosis.findings import Code, Finding, flagged, listed, long_runs, stretches
from recon.diagnosis.named_points import (
    NamedPoints,
    PredictedPoints,
    distances,
    joint_pairs,
    joints_of_impossible_bones,
    relative_body_size,
    rest_length,
)
from recon.diagnosis.quick_fit import without_implausible

_MAX_REMAINING_SHARE = 0.5
"""Share of their errors that may remain when two points exchange their names."""
_MIN_LENGTH_SAVED_M = 0.08
"""Sum (m) by which exchanging two names must reduce the errors of the lengths of bones."""
_MIN_NEARER_M = 0.15
"""Sum (m) by which exchanging two points must bring them nearer to their places in a frame."""
_MIN_STDS = 6.0
"""Standard deviations of a coordinate beyond which a position is an outlier, and by which two
points must come nearer when they exchange names."""
_MAX_GAP, _MIN_STRETCH = 2, 2
"""Largest gap between exchanged frames that is closed, and shortest stretch of them (frames)."""


Exchanges = list[tuple[tuple[int, int], Bool[np.ndarray, " moments"]]]
"""Pairs of points that carry each other's name, each with a mask of frames."""


def exchanged_throughout(points: NamedPoints) -> tuple[int, int] | None:
    """Return the two joints whose exchange clearly makes bone lengths plausible, or None.

    A body may cross its legs to reach exchanged ankles, but it cannot change its bones.
    """
    if not points.are_joints:
        return None
    bones, ratio = joint_pairs(points), relative_body_size(points) or 1.0
    shown = np.where(points.visible[..., None], points.positions, np.nan)
    misfit: dict[tuple[int, int], Float[np.ndarray, " points"]] = {}
    """For each bone's end that stays and end that is replaced: every point's distance from the
    end that stays, minus the length of the bone, as the median absolute value (m) over time."""
    for k, j in bones:
        length = ratio * rest_length(points, k, j)
        for stays, replaced in ((k, j), (j, k)):
            away = np.linalg.norm(shown - shown[:, stays, None], axis=-1)
            misfit[stays, replaced] = np.nan_to_num(finite_median(np.abs(away - length).T))
    best, pair = 0.0, None
    for a, b in combinations(range(len(points.bones)), 2):
        touched = [ends for ends in misfit if ends[1] in (a, b)]
        if any(ends in ((a, b), (b, a)) for ends in touched):
            continue
        own = sum(float(misfit[ends][ends[1]]) for ends in touched)
        if own <= max(best, _MIN_LENGTH_SAVED_M):  # an exchange lowers the misfit by at most `own`
            continue
        new = sum(float(misfit[ends][b if ends[1] == a else a]) for ends in touched)
        if own - new > max(best, _MIN_LENGTH_SAVED_M) and new < _MAX_REMAINING_SHARE * own:
            best, pair = own - new, (a, b)
    return pair


_MIN_CROSSED_M = 0.02
"""Sum (m) by which an exchange must reduce two bones' errors of length for a fit to test it."""
_MAX_COSINE = -0.5
"""Cosine of the left-to-right directions of two limbs below which one is exchanged."""


def limbs_maybe_exchanged(points: NamedPoints) -> list[tuple[tuple[int, int], ...]]:
    """Find parts of limbs, as left-right pairs, whose names may be exchanged; usually none.

    Candidates are limbs of which a bone fits the other side's joint, and limbs whose left-to-right
    direction is opposite to another limb's. Every part of these is a group; a fit must decide.
    """
    if not points.are_joints:
        return []
    other, ratio = points.counterparts, relative_body_size(points) or 1.0
    pairs = [(a, b) for a, b in joint_pairs(points) if a < other[a] and other[b] not in (a, b)]
    one_side = [k for k in range(len(other)) if k < other[k]]
    bone = {k: min(points.bones[k], MIRROR[points.bones[k]]) for k in one_side}
    rank = [(bone.get(k, 0), k) for k in range(len(other))]
    edges = [(a, b) for a in one_side for b in one_side if PARENTS[bone[b]] == bone[a]]
    edges += [(a, min(b, other[b])) for a, b in pairs]
    parent = {max(edge, key=rank.__getitem__): min(edge, key=rank.__getitem__) for edge in edges}

    def pairs_from_root(k: int) -> set[int]:
        return {k} | (pairs_from_root(parent[k]) if k in parent else set())

    limbs = {
        k: [{j for j in one_side if k in pairs_from_root(j)}] for k in one_side if k not in parent
    }
    crossed = set[int]()
    for a, b in combinations(limbs, 2):
        cosine = _cosine_across(points, a, b)
        crossed |= {a, b} if cosine < _MAX_COSINE else set()
    for a, b in pairs:
        (root,) = pairs_from_root(a) & limbs.keys()
        limbs[root].append({j for j in one_side if min(b, other[b]) in pairs_from_root(j)})
        length = ratio * rest_length(points, a, b)
        own, new = (
            [np.abs(distances(points, *ends) - length) for ends in two]
            for two in (((a, b), (other[a], other[b])), ((a, other[b]), (other[a], b)))
        )
        if not all(map(len, (*own, *new))):
            continue
        own, new = (sum(float(np.median(one)) for one in two) for two in (own, new))
        if own - new > _MIN_CROSSED_M and new < _MAX_REMAINING_SHARE * own:
            crossed.add(root)
    parts = [part for root in sorted(crossed) for part in limbs[root]]
    parts += [one - less for one in parts for less in parts if less < one]
    return list(dict.fromkeys(tuple((k, other[k]) for k in sorted(part)) for part in parts))


def _cosine_across(points: NamedPoints, a: int, b: int) -> float:
    """Return the median cosine between left-to-right directions of two pairs; 1 if unseen."""
    ends = [(k, points.counterparts[k]) for k in (a, b)]
    seen = points.visible[:, [*ends[0], *ends[1]]].all(1)
    across = [points.positions[seen, left] - points.positions[seen, right] for left, right in ends]
    length = np.prod([np.linalg.norm(one, axis=-1) for one in across], axis=0)
    cosine = (across[0] * across[1]).sum(-1) / np.maximum(length, 1e-9)
    return float(np.median(cosine)) if seen.any() else 1.0


def exchanged_moments(predicted: PredictedPoints, noise: float) -> Exchanges:
    """Find pairs of points that lie at each other's place on the body, and in which frames."""
    points = predicted.points
    away = np.linalg.norm(points.positions[:, :, None] - predicted.positions[:, None], axis=-1)
    nearer = max(_MIN_NEARER_M, _MIN_STDS * noise)
    found: list[tuple[float, tuple[int, int], Bool[np.ndarray, " moments"]]] = []
    for a, b in combinations(range(len(points.names)), 2):
        own, other = away[:, a, a] + away[:, b, b], away[:, a, b] + away[:, b, a]
        both = points.visible[:, a] & points.visible[:, b]
        surely = both & (own - other > nearer) & (other < _MAX_REMAINING_SHARE * own)
        moments = _likely_runs_with_sure_frame(surely, both & (own - other > noise))
        if moments.any():
            found.append((float((own - other)[moments].sum()), (a, b), moments & both))
    kept: Exchanges = []
    for _, pair, moments in sorted(found, key=lambda one: -one[0]):
        if not any(set(pair) & set(other) for other, _ in kept):
            kept.append((pair, moments))
    return kept


def _likely_runs_with_sure_frame(
    surely: Bool[np.ndarray, " moments"], likely: Bool[np.ndarray, " moments"]
) -> Bool[np.ndarray, " moments"]:
    """Return runs of likely frames that contain a sure one, with short gaps closed.

    Limbs that pass each other are too close to be distinguished for a few frames.
    """
    if not surely.any():
        return surely
    grown = surely.copy()
    for first, last in stretches(likely):
        grown[first : last + 1] |= surely[first : last + 1].any()
    gaps = ~grown & ~long_runs(~grown, _MAX_GAP + 1)
    gaps[: int(grown.argmax())] = gaps[len(grown) - int(grown[::-1].argmax()) :] = False
    return long_runs(grown | gaps, _MIN_STRETCH)


_MAX_GAP_S = 0.1
"""Time (s) between two observations beyond which limbs may have changed places."""
_MAX_STEP_RATIO = 0.6
"""Ratio of the steps from the other side's last places to those from a point's own places, below
which names were exchanged."""
_MIN_SAVED_M = 0.1
"""Least decrease (m) of the step per point by an exchange; below, both sides were in one place."""


def exchanged_sides(points: NamedPoints) -> Bool[np.ndarray, " moments"]:
    """Return a mask of frames where left and right are exchanged relative to the first frame."""
    return _after_odd_count(_moments_of_exchange(points, _counterpart_pairs(points)))


def exchanged_pairs(points: NamedPoints) -> Exchanges:
    """Find left-right pairs of points that jump to each other's place and back, and the frames."""
    found: Exchanges = []
    for pair in _counterpart_pairs(points):
        flips = _moments_of_exchange(points, [pair])
        # skip odd numbers of exchanges, which leave open whether the first or last frame is wrong
        if flips.any() and flips.sum() % 2 == 0:
            found.append((pair, _after_odd_count(flips) & points.visible[:, list(pair)].all(1)))
    return [(pair, moments) for pair, moments in found if moments.any()]


def _counterpart_pairs(points: NamedPoints) -> list[tuple[int, int]]:
    return [(k, other) for k, other in enumerate(points.counterparts) if k < other]


def _moments_of_exchange(
    points: NamedPoints, pairs: list[tuple[int, int]]
) -> Bool[np.ndarray, " moments"]:
    """Return a mask of frames in which these pairs of points jump to each other's place.

    In these frames the points move less if their sides are exchanged.
    """
    rows, moment = np.array(pairs, int).reshape(-1, 2), np.arange(len(points.visible))[:, None]
    seen, x = np.all(points.visible[:, rows], axis=-1), points.positions[:, rows]
    last = np.maximum.accumulate(np.where(seen, moment, -1))
    last = np.concatenate((np.full_like(last[:1], -1), last[:-1]))
    known = seen & (last >= 0) & ((moment - last) / points.fps <= _MAX_GAP_S)
    before = np.take_along_axis(x, last.clip(min=0)[..., None, None], axis=0)
    same, other = (
        np.where(known, np.linalg.norm(after - before, axis=-1).sum(-1), 0.0)
        for after in (x, x[:, :, ::-1])
    )
    saved = np.clip(same - other, -1.0, 1.0).sum(-1) / known.sum(-1).clip(min=1) / 2
    return (saved > _MIN_SAVED_M) & (other.sum(-1) < _MAX_STEP_RATIO * same.sum(-1))


def _after_odd_count(exchanges: Bool[np.ndarray, " moments"]) -> Bool[np.ndarray, " moments"]:
    """Return a mask of frames after an odd number of exchanges; false if there are too many."""
    odd = np.cumsum(exchanges) % 2 == 1
    return odd if exchanges.sum() <= max(2, len(exchanges) // 8) else np.zeros_like(odd)


_OUTLIER_M = 0.25
"""Distance (m) from the body beyond which a single position is an outlier, whatever the noise."""
_MIN_LEAP_M = 0.1
"""Distance (m) between a position and the mean of the two next to it in time, by which outliers
leap away; hands that punch turn around within 8 cm at 30 frames per second."""
_REPORTED_SHARE = 0.02
"""Share of outliers from which on they are reported."""
_MIN_AWAY_M = 0.08
"""Median distance (m) from which on a point may be away from its place throughout."""
_MIN_AWAY_RATIO = 3.0
"""Median distance of a misplaced point, as a multiple of the other points' median distance."""
_OFFSET_JOINTS, _OFFSET_MARKERS = 0.07, 0.15
"""Metres of a constant offset from which on a point is misplaced. Joints of other models are
within 4 cm of where the body has them; real markers of elbows and wrists are put up to 13 cm away
from the landmark that they are named after."""
_MAX_ASYMMETRY_M = 0.065
"""Distance (m) by which a marker of the trunk or a leg may differ from the mirror image of its
counterpart: both are usually placed alike, even if at other places than the names say. Elbows and
wrists, whose few markers leave the bone's twist open, differ by more."""
_MAX_LENGTH_SHARE, _MAX_LENGTH_STDS = 0.5, 2.0
"""Variation of an offset in the frame of the bone, as a share of its length and in standard
deviations of a coordinate (the larger counts), up to which the offset is constant."""
_AWAY_QUANTILE = 0.8
"""Quantile of a point's distances from its place that must exceed the limit, if the point stands
still in the room; limbs may return to it."""
_MAX_STILL_RADIUS_M = 0.08
"""Distance (m) from its median within which a point that stands still in the room remains."""
_STILL_QUANTILE = 0.9
"""Quantile of a still point's distances from its median that must be within the radius."""
_MIN_BODY_MOTION_M = 0.2
"""Largest distance (m) that the body must move from its median for a point to be held still."""


def misplaced_points(
    predicted: PredictedPoints, noise: float
) -> tuple[NamedPoints, list[Finding]]:
    """Mark points as unseen that are displaced in all frames; also return findings about them."""
    points, typical = predicted.points, predicted.typical
    found: list[Finding] = []
    known, away = typical[typical > 0], predicted.away
    least = max(_MIN_AWAY_M, _MIN_AWAY_RATIO * float(np.median(known))) if len(known) else np.inf
    offset, spread = predicted.offset, predicted.spread
    constant = np.linalg.norm(offset, axis=-1)
    displaced = constant > (_OFFSET_JOINTS if points.are_joints else _OFFSET_MARKERS)
    if not points.are_joints:
        displaced |= _displaced_on_one_side(points, offset)
    unreached = joints_of_impossible_bones(without_implausible(points), _OFFSET_JOINTS)
    steady = spread < np.maximum(_MAX_LENGTH_SHARE * constant, _MAX_LENGTH_STDS * noise)
    hidden = np.zeros_like(points.visible)
    for point in np.flatnonzero(points.visible.any(0)):
        seen, name = points.visible[:, point], points.names[point]
        x, body = points.positions[seen, point], predicted.positions[seen, point]
        still = np.linalg.norm(x - np.median(x, axis=0), axis=-1)
        moved = np.linalg.norm(body - np.median(body, axis=0), axis=-1).max() > _MIN_BODY_MOTION_M
        stays = moved and np.quantile(still, _STILL_QUANTILE) < _MAX_STILL_RADIUS_M
        value = float(typical[point])
        code: Code = "offset point"
        if stays and np.quantile(away[seen, point], _AWAY_QUANTILE) > least:
            code, why = (
                "constant point",
                (f"{name} stays in one place in the room while the body moves away from it"),
            )
        elif unreached[point]:
            why = f"all bones that end at {name} have lengths that no person's have"
        elif steady[point] and displaced[point]:
            why = f"{name} is {100 * value:.0f} cm away from its place on the body throughout"
        else:
            continue
        hidden[:, point] = True
        said = f"{why}; it was left out. Look at its label and its tracking"
        found.append(Finding(code, said, (name,), (), value))
    return points.without(hidden), found


def _displaced_on_one_side(
    points: NamedPoints, offset: Float[np.ndarray, "points 3"]
) -> Bool[np.ndarray, " points"]:
    """Return a mask of markers of trunk and legs that are displaced on one side only."""
    mirrored = offset[list(points.counterparts)] * (-1.0, 1.0, 1.0)
    apart = np.linalg.norm(offset - mirrored, axis=-1)
    away, other = np.linalg.norm(offset, axis=-1), np.linalg.norm(mirrored, axis=-1)
    fixed = np.array([bone not in ARMS for bone in points.bones])
    return fixed & (apart > _MAX_ASYMMETRY_M) & (away > _MAX_ASYMMETRY_M) & (other < away / 2)


def without_outliers(
    predicted: PredictedPoints, noise: float
) -> tuple[NamedPoints, Finding | None]:
    """Mark positions far from the body as unseen; also return a finding with their number."""
    points = predicted.points
    limit = max(_OUTLIER_M, _MIN_STDS * noise)
    far = points.visible & (np.nan_to_num(predicted.away) > limit)
    # an outlier jumps away and back; a fast limb moves smoothly, even if the quick fit lags behind
    bend, unknown, x = np.zeros(far.shape), ~points.visible, points.positions
    if len(x) > 2:
        bend[1:-1] = np.linalg.norm(x[1:-1] - (x[:-2] + x[2:]) / 2, axis=-1)
        bend[[0, -1]] = bend[[1, -2]]
        unknown[1:-1] |= ~points.visible[2:] | ~points.visible[:-2]
    bend[unknown] = np.inf
    leap = max(_MIN_LEAP_M, _MIN_STDS * noise)
    for point in range(far.shape[1]):
        for first, last in stretches(far[:, point]):
            inner = [t for t in (first, last) if 0 < t < len(far) - 1]
            # leave out first and last frame of the clip, which have no second difference
            ends = inner or ([first] if first == last else [])
            far[first : last + 1, point] = min(bend[ends, point], default=0.0) >= leap
    share = float(far.sum() / max(points.visible.sum(), 1))
    if share == 0:
        return points, None
    kept = points.without(far)
    if share < _REPORTED_SHARE:
        return kept, None
    joints = flagged(points.names, np.any(far, axis=0))
    return kept, Finding(
        "outliers",
        f"{100 * share:.3g} % of the visible positions are more than {limit:.2f} m from the body "
        f"that the others agree on ({listed(joints)}); they were left out, and the others are "
        "weighted robustly",
        joints,
        stretches(np.any(far, axis=1)),
        share,
    )
