"""Points in space before a fit: what is wrong with them, and the repairs that are sure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.robust import geman_mcclure, squared
from recon.core.skeleton import PARENTS
from recon.diagnosis.findings import Finding, listed, spans, stretches
from recon.diagnosis.motions.belt import belt_velocity
from recon.diagnosis.points.exact import (
    floor_finding,
    floor_height,
    repaired_exact,
    scale_findings,
)
from recon.diagnosis.points.exchanged import (
    exchanged_moments,
    exchanged_pairs,
    exchanged_throughout,
    find_exchanges,
)
from recon.diagnosis.points.named_points import NamedPoints, Points, Predicted
from recon.diagnosis.points.outlying import misplaced_points, outliers
from recon.diagnosis.points.quick import QuickFit, plausible, pursued, quick_fits
from recon.diagnosis.points.tracks import frame_order, identity_changes, temporal_noise

_MIN_POSITIONS = 12
"""Visible positions without which nothing is checked."""
_WRONG_SIDES = 0.75
"""Share of the cost of the names as given, below which exchanged sides are the right ones."""
_CLEARLY_BETTER = 0.9
"""Share of the cost below which two points that exchange their names are the right ones."""
_FEW = 0.1
"""Share of the points that may be misplaced; if more seem to be, the body is."""
_KERNEL = 4.0
"""Scale of the robust kernel in standard deviations of a coordinate, where there are outliers."""
_LEAST_KERNEL = 0.05
"""Metres; smaller scales would take the model's own error for outliers."""


@dataclass(frozen=True)
class Screened:
    """One clip's points as they should be fitted, and what was found."""

    points: Points
    repairs: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    belt: Float[Tensor, " 2"] | None = None
    """Velocity of the treadmill under the feet, m/s, where there is one."""

    def after(self, points: Points, *repairs: Finding) -> "Screened":
        """The next state, with repairs that were made."""
        return replace(self, points=points, repairs=(*self.repairs, *repairs))

    def warned(self, *warnings: Finding) -> "Screened":
        """The screened points with more warnings."""
        return replace(self, warnings=(*self.warnings, *warnings))


def screen_points(points: Points, body: BodyModel, *, grounded: bool = True) -> Screened:
    """Check one clip's joints or markers, and repair what can be repaired surely.

    In this order: what repeats bit for bit, the order of frames, sides and single pairs that
    change names within the clip, jumps of the whole body, its size, sides exchanged throughout,
    and, against a quick robust fit, two points exchanged, points away from their place, outliers
    and the ground, unless there is none (`grounded`).
    """
    exact, found = repaired_exact(NamedPoints.of(points, body))
    state = Screened(points).after(exact.into(points), *found)
    if exact.visible.sum() < _MIN_POSITIONS:
        return state
    if disorder := frame_order(exact):  # nothing else can be told from such frames
        return state.warned(*disorder)
    named = plausible(exact)
    exchanges = find_exchanges(named)
    steady = named.permuted(named.counterparts, exchanges)
    state = state.warned(*scale_findings(steady))
    for pair, moments in exchanged_pairs(steady):
        steady = _swapped(steady, pair, moments)
        state = _exchanged_back(state, pair, moments, body)
    if jumps := identity_changes(steady):  # no one body explains the points before and after
        return state.warned(*jumps)
    state, fitted = _sides(state, exchanges, body)
    state, fitted = _exchanged(state, fitted, body)
    return _against_a_body(state, fitted, body, grounded=grounded)


def _sides(
    state: Screened, exchanged: Bool[np.ndarray, " moments"], body: BodyModel
) -> tuple[Screened, QuickFit]:
    """Left and right by continuity within the clip, and by which body fits throughout."""
    named = NamedPoints.of(state.points, body)
    order = named.counterparts
    steady = named.permuted(order, exchanged)
    given = _cleaned(steady, state.points)
    if all(k == other for k, other in enumerate(order)):
        return state, quick_fits([given], body)[0]
    everywhere = np.ones_like(exchanged)
    opposite = steady.permuted(order, everywhere)
    fits = quick_fits([given, _cleaned(opposite, state.points)], body)
    best = min(fits, key=lambda one: one.cost * (1 if one.points is given else 1 / _WRONG_SIDES))
    wrong = exchanged if best.points is given else ~exchanged
    if not wrong.any():
        return state, best
    chosen = steady if best.points is given else opposite
    said = _stretch_finding(wrong) if not wrong.all() else _throughout(fits)
    state = state.after(chosen.into(state.points), said)
    return (state.warned(said) if wrong.all() else state), best


def _cleaned(named: NamedPoints, points: Points) -> Points:
    return plausible(named).into(points)


def _stretch_finding(wrong: np.ndarray) -> Finding:
    return Finding(
        "sides exchanged",
        "left and right change places from one frame to the next and back "
        f"({spans(stretches(wrong))}); there the names were exchanged",
        (),
        stretches(wrong),
        float(wrong.mean()),
    )


def _throughout(fits: Sequence[QuickFit]) -> Finding:
    return Finding(
        "sides exchanged",
        "knees, elbows and feet bend the wrong way unless left and right are exchanged: the names "
        "were exchanged throughout. If the recording is mirrored instead, mirror it back before "
        "fitting: this result is then the mirror image of the motion",
        value=min(one.cost for one in fits) / max(one.cost for one in fits),
    )


def _exchanged(state: Screened, fitted: QuickFit, body: BodyModel) -> tuple[Screened, QuickFit]:
    """Two points that carry each other's name, throughout or in a stretch."""
    named = NamedPoints.of(state.points, body)
    everywhere = np.ones(len(named.visible), dtype=bool)
    if (pair := exchanged_throughout(named)) is not None:
        other = _swapped(named, pair, everywhere)
        (better,) = quick_fits([_cleaned(other, state.points)], body)
        if better.cost < _CLEARLY_BETTER * fitted.cost:
            said = _exchange_finding(named, pair, everywhere)
            state, fitted, named = state.after(other.into(state.points), said), better, other
    noise = temporal_noise(NamedPoints.of(fitted.points, body))
    predicted = Predicted.of(named, fitted.points, fitted.estimate)
    if _suspicious(predicted, noise):  # before points are blamed, the body reaches for them
        fitted = pursued(fitted, body)
        predicted = Predicted.of(named, fitted.points, fitted.estimate)
    pairs = exchanged_moments(predicted, noise)
    for pair, moments in pairs:
        state = _exchanged_back(state, pair, moments, body)
    if pairs:
        named = NamedPoints.of(state.points, body)
        (fitted,) = quick_fits([_cleaned(named, state.points)], body)
    return state, fitted


def _suspicious(predicted: Predicted, noise: float) -> bool:
    """Whether a quick fit would blame any point."""
    return (
        len(exchanged_moments(predicted, noise)) > 0
        or len(misplaced_points(predicted, noise)[1]) > 0
        or outliers(predicted, noise)[1] is not None
    )


def _exchanged_back(
    state: Screened,
    pair: tuple[int, int],
    moments: Bool[np.ndarray, " moments"],
    body: BodyModel,
) -> Screened:
    named = NamedPoints.of(state.points, body)
    said = _exchange_finding(named, pair, moments)
    return state.after(_swapped(named, pair, moments).into(state.points), said)


def _swapped(
    named: NamedPoints, pair: tuple[int, int], moments: Bool[np.ndarray, " moments"]
) -> NamedPoints:
    order = list(range(len(named.names)))
    order[pair[0]], order[pair[1]] = pair[1], pair[0]
    return named.permuted(tuple(order), moments)


def _exchange_finding(
    named: NamedPoints, pair: tuple[int, int], moments: Bool[np.ndarray, " moments"]
) -> Finding:
    names = (named.names[pair[0]], named.names[pair[1]])
    frames = () if moments.all() else stretches(moments)
    when = f" ({spans(frames)})" if frames else ""
    return Finding(
        "points exchanged",
        f"{listed(names)} lie in each other's place{when}; their names were exchanged",
        names,
        frames,
        float(moments.mean()),
    )


def _against_a_body(
    state: Screened, fitted: QuickFit, body: BodyModel, *, grounded: bool
) -> Screened:
    """What a quick robust fit says about single points, the ground and the noise."""
    named = NamedPoints.of(state.points, body)
    noise = temporal_noise(NamedPoints.of(fitted.points, body))
    predicted = Predicted.of(named, fitted.points, fitted.estimate)
    kept, misplaced = misplaced_points(predicted, noise)
    if len(misplaced) > _FEW * len(named.names) or _limbs(named, misplaced):
        return state  # the quick fit itself is wrong, so it cannot judge points
    kept, wild = outliers(replace(predicted, points=kept), noise)
    # what is left out throughout is inferred, which a user should know
    state = state.after(kept.into(state.points), *misplaced).warned(*misplaced)
    if wild is not None:
        state = state.after(_robust(state.points, noise), wild)
    if not grounded or not state.points.placed:
        return state  # what is relative to the body tells neither heights nor paths
    if state.points.ground_known:
        height = floor_height(kept, fitted.estimate.motion, body, noise)
        if height != 0:
            moved, said = state.points.replace(ground_known=False), floor_finding(height)
            state = state.after(moved, said).warned(said)  # soles tell it to two centimetres
    motion = fitted.estimate.motion[0]
    belt = belt_velocity(motion, body)
    if belt is None:
        return state
    said = Finding(
        "treadmill",
        f"standing feet are all carried along at {float(belt.norm()):.2f} m/s, as on a treadmill: "
        "the motion was fitted in the frame of the belt and carried back to the room",
        value=float(belt.norm()),
    )
    return replace(state.after(state.points, said), belt=belt)


def _limbs(named: NamedPoints, misplaced: Sequence[Finding]) -> bool:
    """Whether several points of one limb are misplaced: then the limb is, in the quick fit.

    An acrobat's planted foot or hand was said to be left behind by a body that was fitted wrong.
    """
    bones = [named.bones[named.names.index(one.joints[0])] for one in misplaced]
    return any(a == b or PARENTS[a] == b or PARENTS[b] == a for a, b in combinations(bones, 2))


def _robust(points: Points, noise: float) -> Points:
    """The points with a robust kernel, unless they have one."""
    if points.kernel is not squared:
        return points
    scale = max(_LEAST_KERNEL, _KERNEL * noise)
    return points.replace(kernel=partial(geman_mcclure, sigma=scale))
