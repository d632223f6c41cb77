"""Repairs exchanged names of left and right keypoints, or of other pairs in one of several views.

Left and right follow from two facts: a point does not jump from its own path to its counterpart's
within a frame; and where several cameras see a body, rays through one point meet, and noses, knees
and toes show which side is the right one. All views and frames are decided together (Viterbi's
algorithm).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from recon.core.hands import facing_agreement
from recon.diagnosis.exchanged_pairs import (
    ExchangedPair,
    exchanged_back,
    extrapolated,
    repaired_by,
    without_excursions,
)
from recon.diagnosis.findings import Finding, Findings, spans, stretches
from recon.diagnosis.images import (
    Images,
    confirmed_sides,
    fits_better_exchanged,
    limb_root_by_keypoint_pair,
)
from recon.diagnosis.rays import Rays
from recon.solver.viterbi import cheapest_path

_MISS_STD_M = 0.04
"""Distance (m) by which rays of good views miss each other; 0.01 to 0.03 in real detections."""
_PATH_STEP_M = (0.01, 0.05)
"""Least and largest standard deviation (m) of points from their predicted paths, which is
estimated from the median in each view."""
_RAYLEIGH_MEDIAN = 1.1774
"""Median length of a vector of two independent standard normal numbers."""
_MAX_SQUARED_STDS = 9.0
"""Squared residual, in standard deviations, to which the cost of an outlier is limited."""
_CHANGE_COST = 12.0
"""Cost of a change of names, in squared standard deviations."""
_BACKWARDS_COST = 6.0
"""Cost of a frame in which the body faces backwards, in squared standard deviations."""
_EXCHANGED_COST = 0.05
"""Cost of a frame with exchanged names: without evidence, names are right."""
_MIN_SAVED_COST = 30.0
"""Cost that exchanging names must save; in good windows of validation people it saves 11 at most,
and 60 and more where a third of a clip has its names exchanged."""
_MAX_MISS_M = 0.06
"""Distance (m) by which rays may miss each other under the right names; real detections and
calibrations reach 0.03."""
_MAX_RATIO_NO_JUMPS, _MAX_RATIO_JUMPS = 0.75, 0.95
"""Ratios to which exchanging all sides in one view must reduce the objective of a fit: if no
frame's sides were exchanged, and if some were, so that one part is wrong anyway. Exchanging right
names gives 1.13 in the median of 75 simulated clips; below 0.95 in four, below 0.75 in one."""
_MAX_JOINT_VIEWS = 5
"""Largest number of views that are decided together; further ones follow them."""


def repaired_sides(images: Images) -> tuple[Images, Findings]:
    """Undo exchanges of left and right in all views; also return the findings.

    In a single view only continuity shows exchanges; then a fit must confirm every stretch, and
    unconfirmed ones become warnings. Finally, all frames get the sides with which a body fits
    better.
    """
    flags = exchanged_sides(without_excursions(images))
    doubted = np.zeros_like(flags)
    if len(flags) == 1 and flags.any():
        sure = confirmed_sides(images, flags[0])[None]
        flags, doubted = sure, flags & ~sure
    if len(flags) == 1 and images.sided.any() and images.seen.any():
        needed = _MAX_RATIO_JUMPS if flags.any() else _MAX_RATIO_NO_JUMPS
        flags = flags ^ fits_better_exchanged(images.exchanged(flags), needed)
    found = list(zip(images.names, flags, strict=True))
    if len(flags) > 1 and (flags == flags[0]).all():
        found = [("all views", flags[0])]
    said = tuple(_sides_finding(name, own, images) for name, own in found if own.any())
    doubts = zip(images.names, doubted, strict=True)
    asked = tuple(_sides_finding(*one, images, sure=False) for one in doubts if one[1].any())
    return (images.exchanged(flags) if said else images), Findings(said, asked)


def _sides_finding(
    name: str, exchanged: Bool[np.ndarray, " moments"], images: Images, *, sure: bool = True
) -> Finding:
    throughout = bool(exchanged[images.seen.any((0, 2))].all())
    frames = () if throughout else stretches(exchanged)
    when = "throughout" if throughout else f"in {spans(frames)}"
    said = (
        f"left and right are exchanged {when}; they were given back their names. Detectors "
        "confuse them in views from the side and from behind"
        if sure
        else f"left and right may be exchanged {when}, or just before or after: they jump onto "
        "each other's path. One view does not tell for sure, and they kept their names; look at "
        "these frames, cut them off (--between) or add a view"
    )
    return Finding("sides exchanged", said, (), frames, float(exchanged.mean())).of_sensor(name)


def exchanged_sides(images: Images) -> Bool[np.ndarray, "views moments"]:
    """Return a mask of views and frames whose left and right are surely exchanged.

    Of several views, only those are marked in which all rays meet under the new names: another
    error of a view is not repaired by other names.
    """
    views, moments = images.confidence.shape[:2]
    flags = np.zeros((views, moments), dtype=bool)
    if not images.sided.any() or moments == 0:
        return flags
    first = np.argsort(-images.seen.sum((1, 2)), kind="stable")[:_MAX_JOINT_VIEWS].tolist()
    flags[first] = _cheapest_exchanges(images.view(first), list(range(len(first))))
    for v in sorted(set(range(views)) - set(first)):
        group = images.exchanged(flags).view([*first, v])
        flags[v] = _cheapest_exchanges(group, [len(first)])[-1]
    if views > 1:
        rays = Rays.of(images.exchanged(flags))
        points, exists = rays.triangulated()
        miss, there = rays.distances_from(points), exists & (rays.weight > 0)
        for own, near, seen in zip(flags, miss, there, strict=True):
            if seen[own].any() and np.median(near[own][seen[own]]) > _MAX_MISS_M:
                own[:] = False
    return flags


def _cheapest_exchanges(images: Images, free: list[int]) -> Bool[np.ndarray, "views moments"]:
    """Return where sides are exchanged at the least cost, if only the views `free` may have this.

    False in all frames unless that saves `_MIN_SAVED_COST`.
    """
    views = len(images.confidence)
    states = np.stack([
        np.isin(np.arange(views), [v for k, v in enumerate(free) if number >> k & 1])
        for number in range(2 ** len(free))
    ])  # fmt: skip
    met = [_triangulated_after_exchange(images, state, images.counterparts) for state in states]
    here = _costs_of_states(met, states, images.sided[None])
    if views > 1:
        facing = [facing_agreement(images.points, points, exists) for points, exists, _ in met]
        here -= _BACKWARDS_COST * np.stack(facing, -1)
    between = _costs_of_changes(images, states, images.counterparts, images.sided[None])
    return states[_cheapest_paths(here, between)[0]].T


def _triangulated_after_exchange(
    images: Images, exchanged: Bool[np.ndarray, " views"], order: Int[np.ndarray, " points"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangulate points with names exchanged in some views; also return a mask and costs.

    The costs (moments, points) are squared distances of rays from the points, in standard
    deviations; zero if there is only one view.
    """
    moments = images.confidence.shape[1]
    named = images.exchanged(np.repeat(exchanged[:, None], moments, 1), order)
    rays = Rays.of(named)
    points, exists = rays.triangulated()
    miss = np.minimum((rays.distances_from(points) / _MISS_STD_M) ** 2, _MAX_SQUARED_STDS)
    counted = np.where(exists, miss, _MAX_SQUARED_STDS / 2).sum(0, where=named.seen)
    return points, exists, counted * (len(exchanged) > 1)


def _costs_of_states(
    triangulations: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    states: Bool[np.ndarray, "states views"],
    groups: Bool[np.ndarray, "groups points"],
) -> Float[np.ndarray, "groups moments states"]:
    miss = np.stack([groups @ counted.T for *_, counted in triangulations], -1)
    return miss + _EXCHANGED_COST * states.sum(-1)


def _costs_of_changes(
    images: Images,
    states: Bool[np.ndarray, "states views"],
    order: Int[np.ndarray, " points"],
    groups: Bool[np.ndarray, "groups points"],
) -> Float[np.ndarray, "groups moments states states"]:
    """Return costs of transitions between states of consecutive frames; 0 in the first frame."""
    stay, change = (cost @ groups.T for cost in _costs_of_steps(images, order))
    differ = (states[:, None] ^ states).astype(float)
    more = np.einsum("abv,vtg->gtab", differ, change + _CHANGE_COST - stay)
    return stay.sum(0).T[..., None, None] + more


def _cheapest_paths(
    state_costs: Float[np.ndarray, "groups moments states"],
    change_costs: Float[np.ndarray, "groups moments states states"],
) -> Int[np.ndarray, "groups moments"]:
    """Return the state of every frame at the least total cost; state 0 if little is saved."""
    paths = cheapest_path(
        torch.from_numpy(state_costs), torch.from_numpy(change_costs[:, 1:])
    ).numpy()

    def cost_of_paths(paths: Int[np.ndarray, "groups moments"]) -> Float[np.ndarray, " groups"]:
        group, moment = np.ogrid[: len(paths), : paths.shape[1]]
        steps = change_costs[group, moment[:, 1:], paths[:, :-1], paths[:, 1:]].sum(1)
        return state_costs[group, moment, paths].sum(1) + steps

    saves = cost_of_paths(0 * paths) - cost_of_paths(paths) >= _MIN_SAVED_COST
    return np.where(saves[:, None], paths, 0)


def _costs_of_steps(
    images: Images, order: Int[np.ndarray, " points"]
) -> tuple[np.ndarray, np.ndarray]:
    """Return costs, per frame, of continuing with the same names and with exchanged names.

    Both are (views, moments, points); the first frame has no cost. Points are predicted to keep
    their velocity.
    """
    before, known = extrapolated(images)
    away = np.linalg.norm(images.pixels - before, axis=-1) / images.scale[..., None]
    typical = np.array([
        np.clip(np.median(way[some]) / _RAYLEIGH_MEDIAN if some.any() else 0.0, *_PATH_STEP_M)
        for way, some in zip(away, images.seen & known, strict=True)
    ])  # fmt: skip

    def cost_of_prediction(predicted: np.ndarray, known: np.ndarray) -> np.ndarray:
        away = (images.pixels - predicted) / images.scale[..., None, None]
        squared = np.square(away / typical[:, None, None, None]).sum(-1)
        both = images.seen & known
        counted = both & both[:, :, order] & (order != np.arange(len(order)))
        return np.where(counted, np.minimum(squared, _MAX_SQUARED_STDS), 0.0)

    return cost_of_prediction(before, known), cost_of_prediction(
        before[:, :, order], known[:, :, order]
    )


def repaired_by_rays(images: Images) -> tuple[Images, Findings]:
    """Exchange names of two keypoints back where only then rays meet; also return findings."""
    return repaired_by(images, exchanged_between_views(images), "rays meet only after an exchange")


def exchanged_between_views(images: Images) -> list[ExchangedPair]:
    """Find pairs of keypoints in one view whose rays meet the others' only when exchanged.

    Pairs are left and right, or neighbours along a limb. If nothing shows which view has the right
    sides, `repaired_sides` decides. Of two views, the one whose points jump is wrong; or else the
    one with which the body faces backwards. `repaired_names` checks bones.
    """
    if (views := len(images.names)) < 2 or (moments := images.confidence.shape[1]) == 0:
        return []
    states = np.eye(views + 1, views, -1, dtype=bool)
    order = np.arange(len(images.points))
    halves = [[*limb_root_by_keypoint_pair(images)][k::2] for k in (0, 1)]
    sides = [(a, b) for a, b in enumerate(images.counterparts.tolist()) if a < b]
    found: list[ExchangedPair] = []
    for pairs in filter(None, (sides, *halves)):
        turned, own = order.copy(), np.array(pairs)
        turned[own], groups = own[:, ::-1], np.isin(order, own) & (order == own[:, :1])
        groups[np.arange(len(own)), own[:, 1]] = True
        met = [_triangulated_after_exchange(images, state, turned) for state in states]
        here = _costs_of_states(met, states, groups)
        paths = _cheapest_paths(here, _costs_of_changes(images, states, turned, groups))
        for pair, path, cost in zip(pairs, paths, here, strict=True):
            for v in range(views):
                for first, last in stretches(path == v + 1):
                    when = slice(first, last + 1)
                    against = (here[:, when, 0] - here[:, when, v + 1]).sum(1).min()
                    meet = cost[when, v + 1].mean() <= 2 * views * (_MAX_MISS_M / _MISS_STD_M) ** 2
                    if meet and (pairs is not sides or against < -_MIN_SAVED_COST):
                        away = np.sqrt(cost[when, 0].mean() / (2 * views)) * _MISS_STD_M
                        found.append(ExchangedPair(v, pair, first, last, float(away)))
    always = [one for one in found if (one.first, one.last) == (0, moments - 1)]
    if views == 2 and always:
        other = [replace(one, view=1 - one.view) if one in always else one for one in found]

        def facing_of(some: list[ExchangedPair]) -> float:
            met = Rays.of(exchanged_back(images, some)).triangulated()
            return float(facing_agreement(images.points, *met).mean())

        found = max(found, other, key=facing_of)
    return found
