"""Checks of 3D points before a fit: finds faults and repairs those that are certain."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from observations.points import TrackedPoints
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import geman_mcclure, squared
from recon.core.skeleton import PARENTS
from recon.diagnosis.exact import (
    floor_finding,
    floor_height,
    repaired_copies,
    repaired_frozen,
    repaired_zeros,
    scale_findings,
)
from recon.diagnosis.findings import (
    NOTHING,
    Finding,
    Findings,
    listed,
    run_checks,
    spans,
    stretches,
)
from recon.diagnosis.misplaced import (
    exchanged_moments,
    exchanged_pairs,
    exchanged_sides,
    exchanged_throughout,
    limbs_maybe_exchanged,
    misplaced_points,
    without_outliers,
)
from recon.diagnosis.movement import belt_velocity
from recon.diagnosis.named_points import NamedPoints, PredictedPoints
from recon.diagnosis.quick_fit import (
    QuickFit,
    middle_seconds,
    quick_fits,
    with_second_start,
    without_implausible,
)
from recon.diagnosis.tracks import frame_order, identity_changes, temporal_noise

_MIN_POSITIONS = 12
"""Number of visible positions below which nothing is checked."""
_SIDES_RATIO = 0.75
"""Ratio of the costs of fits with and without exchanged sides, below which they are exchanged."""
_PAIR_RATIO = 0.9
"""Ratio of the costs of fits with and without two exchanged points, below which they are."""
_MAX_MISPLACED_SHARE = 0.1
"""Share of the points that may be misplaced; if more seem to be, the fit is wrong."""
_KERNEL_STDS, _MIN_KERNEL_M = 4.0, 0.05
"""Scale of the robust kernel where there are outliers: in standard deviations of a coordinate, and
metres at least, as a smaller scale would take the model's own error for outliers."""

Screened = tuple[TrackedPoints, Findings, Float[Tensor, " 2"] | None, Motion | None]
"""Points to be fitted; findings; the velocity (m/s) of a treadmill's belt, if any; and the motion
of the quick fit (1, time), if it resembles a person."""


def screen_points(points: TrackedPoints, body: BodyModel, *, grounded: bool = True) -> Screened:
    """Check one clip's joints or markers, and repair what can be repaired surely.

    The order is: exact repetitions, the order of frames, sides and single pairs that change names
    within the clip, jumps of the whole body, its size, sides exchanged throughout, and, against a
    quick robust fit, exchanged pairs, points away from their place, outliers and the ground (only
    if `grounded`).
    """
    exact = (repaired_zeros, repaired_copies, repaired_frozen)
    named, found = run_checks(NamedPoints.of(points, body), exact)
    if named.visible.sum() < _MIN_POSITIONS:
        return named.observation, found, None, None
    if disorder := frame_order(named):  # other checks need frames in order
        return named.observation, found + Findings(warnings=disorder), None, None
    steady = without_implausible(named)
    flips = exchanged_sides(steady)
    steady = steady.permuted(steady.counterparts, flips)
    found += Findings(warnings=scale_findings(steady))
    for pair, moments in exchanged_pairs(steady):
        steady = steady.swapped(pair, moments)
        named, more = exchanged_back(named, (pair,), moments)
        found += more
    # one body cannot fit two people
    if jumps := identity_changes(steady.positions, steady.visible, steady.fps):
        return named.observation, found + Findings(warnings=jumps), None, None
    named, more = _names_repaired(named.permuted(named.counterparts, flips), steady, body)
    found += more
    named, fitted, more = _sides_repaired(named, flips, body)
    found += more
    named, fitted, more = _pairs_repaired(named, fitted, body)
    found += more
    kept, more, belt, start = _compared_with_body(named, fitted, body, grounded=grounded)
    return kept, found + more, belt, start


def _names_repaired(
    named: NamedPoints, without_outliers: NamedPoints, body: BodyModel
) -> tuple[NamedPoints, Findings]:
    """Exchange two points, or parts of both limbs, whose names are exchanged throughout."""
    pairs = exchanged_names(without_outliers, body)
    if not pairs:
        return named, NOTHING
    return exchanged_back(named, pairs, np.ones(len(named.visible), dtype=bool))


def exchanged_names(points: NamedPoints, body: BodyModel) -> tuple[tuple[int, int], ...]:
    """Return pairs of points that carry each other's name in all frames; usually there are none.

    Bone lengths suggest candidates, which quick fits must confirm. Points have no outliers.
    """
    groups, always = limbs_maybe_exchanged(points), np.ones(len(points.visible), dtype=bool)
    if (pair := exchanged_throughout(points)) is not None:
        groups.append((pair,))
    if not groups:
        return ()
    versions = [points, *(exchanged_back(points, group, always)[0] for group in groups)]
    # fit each version alone, since `quick_fits` of several stops once the first fits well
    excerpts = [middle_seconds(without_implausible(one).observation) for one in versions]
    costs = [quick_fits([one], body)[0].cost for one in excerpts]
    best = int(np.argmin(costs))
    return groups[best - 1] if best and costs[best] <= _PAIR_RATIO * costs[0] else ()


def _sides_repaired(
    named: NamedPoints, exchanged: Bool[np.ndarray, " moments"], body: BodyModel
) -> tuple[NamedPoints, QuickFit, Findings]:
    """Decide by quick fits which naming of left and right is true throughout.

    Args:
        named: points with left and right exchanged in the frames `exchanged`.
        exchanged: frames in which sides are exchanged relative to the first frame.
        body: body model to be fitted.
    """
    order, given = named.counterparts, without_implausible(named).observation
    if all(k == other for k, other in enumerate(order)):
        return named, quick_fits([given], body)[0], NOTHING
    opposite = named.permuted(order, np.ones_like(exchanged))
    fits = quick_fits([given, without_implausible(opposite).observation], body)
    best = min(fits, key=lambda one: one.cost * (1 if one.points is given else 1 / _SIDES_RATIO))
    wrong = exchanged if best.points is given else ~exchanged
    right, found = (named if best.points is given else opposite), NOTHING
    if wrong.all():
        said = Finding(
            "sides exchanged",
            "knees, elbows and feet bend the wrong way unless left and right are exchanged: the "
            "names were exchanged throughout. If the recording is mirrored instead, mirror it "
            "back before fitting: this result is then the mirror image of the motion",
            value=min(one.cost for one in fits) / max(one.cost for one in fits),
        )
        found = Findings((said,), (said,))
    elif wrong.any():
        said = Finding(
            "sides exchanged",
            "left and right change places from one frame to the next and back "
            f"({spans(stretches(wrong))}); there the names were exchanged",
            (),
            stretches(wrong),
            float(wrong.mean()),
        )
        found = Findings((said,))
    return right, best, found


def _pairs_repaired(
    named: NamedPoints, fitted: QuickFit, body: BodyModel
) -> tuple[NamedPoints, QuickFit, Findings]:
    """Undo exchanges of two points' names that last for a while, found by a quick fit."""
    found, noise = NOTHING, temporal_noise(NamedPoints.of(fitted.points, body))
    predicted = PredictedPoints.of(named, fitted.points, fitted.estimate)
    pairs, sure = exchanged_moments(predicted, noise), True
    if pairs or misplaced_points(predicted, noise)[1] or without_outliers(predicted, noise)[1]:
        # points may only look wrong because the quick fit ended in a poor minimum: try another
        fitted = with_second_start(fitted, body)
        again = exchanged_moments(PredictedPoints.of(named, fitted.points, fitted.estimate), noise)
        pairs, sure = again or pairs, len(again) > 0
    if not pairs:
        return named, fitted, NOTHING
    repaired = named
    for pair, moments in pairs:
        repaired, said = exchanged_back(repaired, (pair,), moments)
        found += said
    (tried,) = quick_fits([without_implausible(repaired).observation], body)
    if sure or tried.cost < _PAIR_RATIO * fitted.cost:
        return repaired, tried, found
    return named, fitted, NOTHING  # only the worse of two fits has the points exchanged


def exchanged_back(
    named: NamedPoints, pairs: Sequence[tuple[int, int]], moments: Bool[np.ndarray, " moments"]
) -> tuple[NamedPoints, Findings]:
    """Exchange the labels of pairs of points in some frames; also return the finding."""
    names = tuple(named.names[k] for pair in pairs for k in pair)
    frames = () if moments.all() else stretches(moments)
    when = f" ({spans(frames)})" if frames else ""
    said = Finding(
        "points exchanged",
        f"{listed(names)} lie in each other's place{when}; their names were exchanged",
        names,
        frames,
        float(moments.mean()),
    )
    for pair in pairs:
        named = named.swapped(pair, moments)
    return named, Findings((said,))


def _compared_with_body(
    named: NamedPoints, fitted: QuickFit, body: BodyModel, *, grounded: bool
) -> Screened:
    """Use a quick robust fit to find misplaced points, the height of the ground and the noise."""
    noise = temporal_noise(NamedPoints.of(fitted.points, body))
    predicted = PredictedPoints.of(named, fitted.points, fitted.estimate)
    kept, misplaced = misplaced_points(predicted, noise)
    bones = [named.bones[named.names.index(one.joints[0])] for one in misplaced]
    limb = any(a == b or PARENTS[a] == b or PARENTS[b] == a for a, b in combinations(bones, 2))
    if limb or len(misplaced) > _MAX_MISPLACED_SHARE * len(named.names):
        # judge no points by a bad quick fit, which would reject an acrobat's hand on the ground
        return named.observation, NOTHING, None, None
    kept, wild = without_outliers(replace(predicted, points=kept), noise)
    # a point left out in all frames is also a warning, since the fit must infer its place
    repairs, warnings = tuple(misplaced), tuple(misplaced)
    given = kept.given
    if wild is not None:
        repairs = (*repairs, wild)
        if given.kernel is squared:
            scale = max(_MIN_KERNEL_M, _KERNEL_STDS * noise)
            given = given.replace(kernel=partial(geman_mcclure, sigma=scale))
    motion = fitted.estimate.motion
    belt = None
    if grounded and given.placed:  # root-relative points show no ground
        height = floor_height(kept, motion, body, noise) if given.ground_known else 0.0
        if height != 0:  # the ground is not at z = 0
            given, floor = given.replace(ground_known=False), floor_finding(height)
            repairs, warnings = (*repairs, floor), (*warnings, floor)
        belt = belt_velocity(motion[0], body)
    return replace(kept, given=given).observation, Findings(repairs, warnings), belt, motion
