"""Left and right exchanged in some views at some moments: the likeliest names of every moment.

Two facts tell. A point does not leave its path and go on along its counterpart's within a frame;
and where several cameras see a body, rays through one point meet, and noses, knees and toes point
to where right is on the right. All views and moments are decided together (Viterbi's algorithm).
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from recon.diagnosis.findings import NOTHING, Finding, Findings, spans, stretches
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.rays import Rays

_ANKLES, _TOES = ("heel", "ankle"), ("big_toe", "foot", "small_toe")
_MIN_FORWARD_M = 0.02
"""Metres by which something must stick out forwards for its direction to count."""
_BENT = 0.06
"""Metres by which a knee must stand before the line from hip to ankle to tell the front."""


def handedness(
    positions: Float[np.ndarray, "moments points 3"],
    exists: Bool[np.ndarray, "moments points"],
    names: Sequence[str],
) -> Float[np.ndarray, " moments"]:
    """1 where the body's right is to the right of where it faces, -1 where to the left.

    The trunk has an up and a right, whose product points forwards; noses, toes and bent knees
    point forwards themselves. The value is the mean cosine between both; 0 where nothing tells.
    """
    points = {
        n: np.where(exists[:, k, None], positions[:, k], np.nan) for k, n in enumerate(names)
    }
    hips, shoulders = (_pair(points, name) for name in ("hip", "shoulder"))
    if hips is None or shoulders is None:
        return np.zeros(len(positions))
    up = _unit(shoulders[0] + shoulders[1] - hips[0] - hips[1])
    right = np.nan_to_num(_unit(hips[1] - hips[0])) + np.nan_to_num(
        _unit(shoulders[1] - shoulders[0])
    )
    forwards = _unit(np.cross(up, _unit(right)))
    cosines = [(_unit(_level(way, up)) * forwards).sum(-1) for way in _ahead(points)]
    if not cosines:
        return np.zeros(len(positions))
    known = np.isfinite(cosines)
    return np.nan_to_num(cosines).sum(0) / np.maximum(known.sum(0), 1)


def _ahead(points: dict[str, np.ndarray]) -> Iterator[np.ndarray]:
    """Ways that lead forwards whichever side they are on; NaN where they are too short to tell."""
    ears = _pair(points, "ear") or _pair(points, "shoulder")
    if "nose" in points and ears is not None:
        yield _long(points["nose"] - (ears[0] + ears[1]) / 2, _MIN_FORWARD_M)
    for side in ("left", "right"):
        back = [points[f"{side}_{n}"] for n in _ANKLES if f"{side}_{n}" in points]
        front = [points[f"{side}_{n}"] for n in _TOES if f"{side}_{n}" in points]
        if back and front:
            yield _long(front[0] - back[0], _MIN_FORWARD_M)
        leg = [points.get(f"{side}_{name}") for name in ("hip", "knee", "ankle")]
        if all(point is not None for point in leg):
            hip, knee, ankle = leg
            yield _long(knee - (hip + ankle) / 2, _BENT)  # type: ignore[operator]


def _pair(points: dict[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray] | None:
    left, right = points.get(f"left_{name}"), points.get(f"right_{name}")
    return None if left is None or right is None else (left, right)


def _long(way: np.ndarray, least: float) -> np.ndarray:
    return np.where(np.linalg.norm(way, axis=-1, keepdims=True) > least, way, np.nan)


def _level(way: np.ndarray, up: np.ndarray) -> np.ndarray:
    return way - (way * up).sum(-1, keepdims=True) * up


def _unit(way: np.ndarray) -> np.ndarray:
    return way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)


_MISS = 0.04
"""Metres by which rays of good views miss each other; real detections do by 0.01 to 0.03."""
_PATH_STEP_M = (0.01, 0.05)
"""Metres by which points of views leave their paths from one frame to the next, least and most;
the median of a view tells."""
_RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector whose two coordinates are unit normal."""
_MAX_SQUARED_STDS = 9.0
"""Squared standard deviations beyond which a point is an outlier and says no more."""
_CHANGE = 12.0
"""Cost of a change of names, in squared standard deviations."""
_BACKWARDS_COST = 6.0
"""Cost of a moment that faces backwards, in squared standard deviations."""
_EXCHANGED = 0.05
"""Cost of a moment with exchanged names: where nothing tells, most moments are right."""
_MIN_SAVED_COST = 30.0
"""Cost that exchanging names must save; in good windows of validation people it saves 11 at most,
and 60 and more where a third of a clip has its names exchanged."""
_MEET = 0.06
"""Metres by which rays may miss each other under the right names; real detections, with what
their calibrations are worth, do by 0.03."""
_TOGETHER = 5
"""Views that are decided together; further ones follow them."""


def repaired_sides(images: Images) -> tuple[Images, Findings]:
    """Left and right given back their names, and what was found."""
    flags = exchanged_sides(images)
    if not flags.any():
        return images, NOTHING
    if len(flags) > 1 and (flags == flags[0]).all():
        found = (_finding("all views", flags[0], images),)
    else:
        rows = [v for v, own in enumerate(flags) if own.any()]
        found = tuple(_finding(images.names[v], flags[v], images) for v in rows)
    return images.exchanged(flags), Findings(found)


def _finding(name: str, here: Bool[np.ndarray, " moments"], images: Images) -> Finding:
    there = images.seen.any((0, 2))
    throughout = bool(here[there].all())
    frames = () if throughout else stretches(here)
    when = "throughout" if throughout else f"in {spans(frames)}"
    return Finding(
        "sides exchanged",
        f"left and right are exchanged {when}; they were given back their names. Detectors "
        "confuse them in views from the side and from behind",
        (),
        frames,
        float(here.mean()),
    ).of(name)


def exchanged_sides(images: Images) -> Bool[np.ndarray, "views moments"]:
    """The views and moments that surely have left and right exchanged."""
    views, moments = images.confidence.shape[:2]
    flags = np.zeros((views, moments), dtype=bool)
    if not images.sided.any() or moments == 0:
        return flags
    first = np.argsort(-images.seen.sum((1, 2)), kind="stable")[:_TOGETHER].tolist()
    flags[first] = _decided(images.view(first), list(range(len(first))))
    for v in sorted(set(range(views)) - set(first)):
        group = images.exchanged(flags).view([*first, v])
        flags[v] = _decided(group, [len(first)])[-1]
    return flags if views < 2 else _where_rays_meet(images, flags)


def _where_rays_meet(
    images: Images, flags: Bool[np.ndarray, "views moments"]
) -> Bool[np.ndarray, "views moments"]:
    """The flags of those views under whose new names all rays meet.

    A view that is wrong in another way is not put right by other names.
    """
    rays = Rays.of(images.exchanged(flags))
    points, exists = rays.meet()
    miss, kept = rays.miss(points), flags.copy()
    for v, own in enumerate(flags):
        there = (exists & (rays.weight > 0))[:, own]
        if there.any() and np.median(miss[:, own][there]) > _MEET:
            kept[v] = False
    return kept


def _decided(images: Images, free: list[int]) -> Bool[np.ndarray, "views moments"]:
    """The flags of some free views that cost least; none where that is not sure."""
    views, moments = images.confidence.shape[:2]
    states = [
        np.isin(np.arange(views), [v for k, v in enumerate(free) if number >> k & 1])
        for number in range(2 ** len(free))
    ]
    here = np.stack([_emission(images, state) for state in states], -1)
    stay, change = _steps(images)
    differ = np.stack([[one ^ other for other in states] for one in states])
    between = np.where(differ, (change + _CHANGE).T[:, None, None], stay.T[:, None, None]).sum(-1)
    path = cheapest_path(here, between[1:])
    if not path.any():
        return np.zeros((views, moments), dtype=bool)
    saved = _cost(here, between, np.zeros(moments, dtype=int)) - _cost(here, between, path)
    if saved < _MIN_SAVED_COST:
        return np.zeros((views, moments), dtype=bool)
    return np.stack(states)[path].T


def cheapest_path(
    here: Float[np.ndarray, "moments states"], between: Float[np.ndarray, "steps states states"]
) -> np.ndarray:
    """The state of every moment with the least sum of costs of moments and of steps."""
    best, back = here[0], []
    for cost, step in zip(here[1:], between, strict=True):
        reached = best[:, None] + step
        back.append(reached.argmin(0))
        best = reached.min(0) + cost
    path = [int(best.argmin())]
    for origin in reversed(back):
        path.append(int(origin[path[-1]]))
    return np.array(path[::-1])


def _cost(here: np.ndarray, between: np.ndarray, path: np.ndarray) -> float:
    steps = between[np.arange(1, len(path)), path[:-1], path[1:]]
    return float(here[np.arange(len(path)), path].sum() + steps.sum())


def _emission(images: Images, state: Bool[np.ndarray, " views"]) -> Float[np.ndarray, " moments"]:
    """How badly the views fit together at every moment when some have their names exchanged."""
    cost = np.full(images.confidence.shape[1], _EXCHANGED * state.sum())
    if len(state) < 2:
        return cost
    moments = images.confidence.shape[1]
    named = images.exchanged(np.repeat(state[:, None], moments, 1))
    rays = Rays.of(named)
    points, exists = rays.meet()
    miss = np.minimum((rays.miss(points) / _MISS) ** 2, _MAX_SQUARED_STDS)
    counted = np.where(exists, miss, _MAX_SQUARED_STDS / 2).sum(0, where=named.seen)
    cost += counted[:, named.sided].sum(-1)
    return cost - _BACKWARDS_COST * handedness(points, exists, images.points)


def _steps(images: Images) -> tuple[np.ndarray, np.ndarray]:
    """What it costs to go on from the moment before under the same names, and under exchanged.

    Both (views, moments); the first moment has no cost. Points go on as they went before.
    """
    seen, place = images.seen, images.pixels
    scale = images.scale[..., None, None]
    before, known = np.zeros_like(place), np.zeros_like(seen)
    before[:, 1:], known[:, 1:] = place[:, :-1], seen[:, :-1]
    moving = np.zeros_like(seen)
    moving[:, 2:] = seen[:, 1:-1] & seen[:, :-2]
    before[:, 2:] += np.where(moving[:, 2:, :, None], place[:, 1:-1] - place[:, :-2], 0.0)
    order = images.counterparts

    typical = np.array([
        np.clip(np.median(way[some]) / _RAYLEIGH_MEDIAN if some.any() else 0.0, *_PATH_STEP_M)
        for way, some in zip(
            np.linalg.norm(place - before, axis=-1) / scale[..., 0], seen & known, strict=True
        )
    ])  # fmt: skip

    def cost(there: np.ndarray, known: np.ndarray) -> np.ndarray:
        away = np.square((place - there) / scale / typical[:, None, None, None]).sum(-1)
        counted = seen & known & seen[:, :, order] & known[:, :, order] & images.sided
        return np.minimum(away, _MAX_SQUARED_STDS).sum(-1, where=counted)

    return cost(before, known), cost(before[:, :, order], known[:, :, order])
