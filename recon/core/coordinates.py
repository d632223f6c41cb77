"""Unit and up axis of a recording, found from the size and the posture of the body in it."""

import re
from collections.abc import Sequence
from typing import get_args

import numpy as np
from jaxtyping import Bool, Float

from recon.core.errors import UnitsError
from recon.core.units import AXES, METRES, Axis, Up, to_z_up

_DOWN: dict[Axis, Up] = {"x": "x-down", "y": "y-down", "z": "z-down"}
_BODY_LENGTH = (1.0, 2.2)
"""Metres along the bones from the head to a foot: children to the tallest adults. Narrower than
the closest pair of candidate units (a ratio of 2.22), so no length fits two of them."""
_UNUSUAL, _ADULT = ("ft", "inch"), (1.4, 2.0)
"""Units that are not found out, and metres that are a likely size of somebody in them."""
_MARKER_EXTENT = (0.5, 2.5)
"""Metres spanned by markers, upright or crouched; only m, cm and mm can be told apart by it."""
_SANE_EXTENT = (0.05, 10.0)
"""Metres; outside it no body was recorded and the unit a file declares is wrong."""
_SMALLEST_BODY = 0.2
"""Metres that two ends of a body span at least; adults in cm that are called mm have 0.19."""

_FASTEST_SLIDE = 2.5
"""Metres per second that the slowest foot has at most, half of the time, under a true scale."""
_FAR = 30.0
"""Metres from the origin from which on it must be the feet that say that they are metres."""
_STEP_S = 0.15
"""Seconds over which feet are seen to slide: jitter counts less than over a frame."""
_NO_MOVEMENT = 1e-4
"""Range of a path, in any unit, below which it was not measured: every pelvis sways by more."""
_BENDS = 0.05
"""Range of the entries of rotation matrices from which on a body moves, about 3 degrees."""
_USUAL = ("m", "cm", "mm")
_NEAR_FLOOR = 0.2
"""Metres from zero height within which the joints of feet are on the floor."""
_SLOWER = 0.5
"""Share of the speed of feet under one scale that a better one leaves."""

_LOW = re.compile(
    r"foot|toe|heel|hee$|hel$|ank|calc|cal$|mt\d|\dmt|meta|mal$|^[lr]_?f(cc|al|m\d)$"
)
_HIGH = re.compile(
    r"head|[fb]hd$|^top|temple|ariel|neck|^c7$|^cv7$|^t10$|should|sho$|^[lr]_?[fb]?sh$|clav|acr"
    r"|stern|strn|^man$|^s[jx][ns]$|^[lr]_?s(aa|ae|ia)$"
)
_PELVIS = re.compile(r"asi|psi|sac|ias$|ips$|pelvi|waist|wt$|hip")
_HEAD = re.compile(r"head|[fb]hd$|^top|temple|ariel")
_NECK = re.compile(r"^c7$|^cv7$|^ij$|clav|acr|sho$|should")
_CHEST = re.compile(r"^px$|strn|stern|xiph|^sxs$|^tv?(7|8|10|12)$")
_SURE = 0.7
"""Mean cosine between the body and an axis from which it surely stands along that axis."""
_CLEAR = 1.5
"""Multiple of the cosine along the axis that a file says is up that another's must be."""
_LEGS_M = 0.5
"""Metres of height above which everything is seen of somebody whose legs are hidden."""
_STEADY_COSINE = 0.8
"""Cosine with its upright direction that such a body exceeds in 19 of 20 frames. Of 1,007 windows
of two seconds without what is below 0.9 m, 7 of people who bend or lie are called wrong (22
without this), and 923 of those that do have another axis (932)."""
_STEADY = 0.25
"""Share of its movement along another axis, at most, by which the lowest point of a body that
moves over a floor goes up and down."""
_MOSTLY = 0.35
"""Share of its length that the mean vector up a body has along an axis at least, else it turns."""
_UPSIDE_DOWN = 0.5
"""Share of the swing of the feet below which that of the other end shows that it is at the floor:
somebody stands on the hands."""
_STILL = 0.02
"""Share of the body's size by which a point moves that stands in the room."""


def unit_from_bones(length: float, name: str) -> tuple[str, str]:
    """Tell the unit by the summed length of bones from head to foot; also return the reason.

    Raises:
        ValueError: when no unit fits.
    """
    low, high = _BODY_LENGTH
    fitting = [unit for unit, metres in METRES.items() if low <= length * metres <= high]
    if len(fitting) != 1:
        raise UnitsError(
            f"{name}: expected bones of {low} m to {high} m from head to foot in one of the units "
            f"{', '.join(METRES)}, got {length:.4g} units; give the unit with --unit"
        )
    tall = length * METRES[fitting[0]]
    return fitting[0], f"unit {fitting[0]}: head to foot is {tall:.2f} m along the bones"


def hint_at_adult(size: float, units: Sequence[str] = _UNUSUAL) -> str:
    """Return a hint, for messages, at a unit in which a size fits an adult; else no text."""
    found = [one for one in units if _ADULT[0] <= size * METRES[one] <= _ADULT[1]]
    return f", but an adult's in {found[0]} (--unit {found[0]})" if found else ""


def unit_from_markers(extent: float, name: str) -> tuple[str, str]:
    """Tell the unit (m, cm, mm) by the extent of all markers; also return the reason.

    Raises:
        ValueError: when no unit fits.
    """
    low, high = _MARKER_EXTENT
    fitting = [unit for unit in ("m", "cm", "mm") if low <= extent * METRES[unit] <= high]
    if len(fitting) != 1:
        raise UnitsError(
            f"{name}: expected markers that span {low} m to {high} m in m, cm or mm, got "
            f"{extent:.4g} units{hint_at_adult(extent)}; give the unit with --unit"
        )
    return fitting[0], f"unit {fitting[0]}: the markers span {extent * METRES[fitting[0]]:.2f} m"


def reason_for_declared_unit(unit: str, size: float, name: str, names: Sequence[str] = ()) -> str:
    """Check that a body's size is possible in the unit that a file states; return the reason.

    What shows two of foot, pelvis and head among its points' `names` is no single hand or knee.

    Raises:
        ValueError: when no body has that size.
    """
    metres, words = size * METRES[unit], set(_plain_words(names))
    feet = {word for word in words if _LOW.search(word)}
    ends = [bool(feet), *(any(map(end.search, words - feet)) for end in (_PELVIS, _HEAD))]
    least = _SMALLEST_BODY if sum(ends) > 1 else _SANE_EXTENT[0]
    if not least <= metres <= _SANE_EXTENT[1]:
        raise UnitsError(
            f"{name}: the file says its unit is {unit}, in which the body's size is {metres:.4g} m"
            f"{hint_at_adult(size, _USUAL + _UNUSUAL)}; give the true unit with --unit"
        )
    return f"unit {unit}: stated by the file"


def unit_of_path(
    path: Float[np.ndarray, "time 3"],
    feet: Float[np.ndarray, "time points 3"],
    fps: float,
    up: Float[np.ndarray, "3"],
    name: str,
) -> tuple[str, tuple[str, ...]]:
    """Return the unit of a path in which feet in contact stand still, with notes if not metres.

    For somebody who hardly moves away, it is the unit in which the feet are at height zero.

    Args:
        path: of the body, in the unknown unit.
        feet: points of both feet relative to it, metres; some are at rest most of the time.
        fps: frames per second.
        up: unit vector.
        name: of the file, for messages.

    Raises:
        UnitsError: when it is not metres and nothing tells what else.
    """
    if len(path) < 2:
        return "m", ()
    step = min(max(round(_STEP_S * fps), 1), len(path) - 1)
    moved = (path[step:] - path[:-step])[:, None] * (fps / step)
    swung = (feet[step:] - feet[:-step]) * (fps / step)
    m, cm, mm, still = (
        float(np.median(np.linalg.norm(scale * moved + swung, axis=-1).min(1)))
        for scale in (1.0, METRES["cm"], METRES["mm"], 0.0)
    )
    far = float(np.median(np.linalg.norm(path, axis=-1)))
    if m < _FASTEST_SLIDE and (far < _FAR or m < _SLOWER * still):
        return "m", ()
    unit = "cm" if cm < _SLOWER * min(m, mm) else "mm" if mm < _SLOWER * min(m, cm) else ""
    if unit == "cm" or (unit == "mm" and cm > _FASTEST_SLIDE):
        slides = f"{m:.0f} m/s, so at {cm if unit == 'cm' else mm:.1f}"
        return unit, (f"unit of the translation {unit}: as metres, feet would slide at {slides}",)
    level = [
        one for one in _USUAL
        if abs(np.median(((METRES[one] * path[:, None] + feet) @ up).min(1))) < _NEAR_FLOOR
    ]  # fmt: skip
    if len(level) == 1:
        return level[0], (
            f"unit of the translation {level[0]}: in this unit the feet are on the floor",
        )
    raise UnitsError(
        f"{name}: the translation is not in metres: the body would be {far:.0f} m from the origin "
        f"and its feet slide at {m:.1f} m/s. Give the unit of the translation (--unit cm or mm; m "
        "if these numbers are right), or divide it by the scale of the body"
    )


def notes_on_missing_path(
    path: Float[np.ndarray, "time 3"], rotations: Float[np.ndarray, "time joints 3 3"]
) -> str:
    """A warning where the body moves but its translation is constant; empty otherwise.

    Args:
        path: of the body, in any unit.
        rotations: of its joints.
    """
    single_or_moves = len(path) < 2 or np.ptp(path, axis=0).max() > _NO_MOVEMENT
    if single_or_moves or np.ptp(rotations, axis=0).max() < _BENDS:
        return ""
    return (
        "the translation is the same in every frame though the body moves: the file holds poses "
        "and no path. The person stays on the spot, and feet that stood slide; save the "
        "translation in the world (trans, transl) too"
    )


def vectors_up_body(
    names: Sequence[str],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> Float[np.ndarray, "frames 3"]:
    """Return vectors from the lower to the upper end of the body in frames that show both.

    It goes from the feet to the head and shoulders, or to the pelvis where neither is seen. Feet
    count where more than half of their points are seen: one foot alone may be a raised one whose
    fellow on the floor is hidden. Without them it goes from the pelvis to head and neck, from the
    chest to the neck, or from the shoulders to the head; a single foot is the last resort.
    """
    words = _plain_words(names)

    def points_named(pattern: re.Pattern[str]) -> np.ndarray:
        return visible & np.array([bool(pattern.search(word)) for word in words])

    feet, head, neck = points_named(_LOW), points_named(_HEAD), points_named(_NECK)
    high, pelvis = points_named(_HIGH) & ~feet, points_named(_PELVIS) & ~feet
    of_feet = sum(bool(_LOW.search(word)) for word in words)
    both_feet = feet & (feet.sum(1, keepdims=True) > of_feet / 2)
    pairs = (
        (both_feet, high), (both_feet, pelvis), (pelvis, high | neck),
        (points_named(_CHEST) & ~neck, neck), (high & ~head, head & ~feet), (feet, high),
        (feet, pelvis),
    )  # fmt: skip
    found = np.zeros((len(positions), 3))
    shown = np.zeros(len(positions), dtype=bool)
    for low, top in pairs:
        new = low.any(1) & top.any(1) & ~shown
        found[new] = _means_of_chosen(positions[new], top[new]) - _means_of_chosen(
            positions[new], low[new]
        )
        shown |= new
    return found[shown]


def _plain_words(names: Sequence[str]) -> list[str]:
    """Return names in lower case without their subject, with _ for what is no letter."""
    return [re.sub(r"[^a-z0-9]+", "_", name.lower().split(":")[-1]).strip("_") for name in names]


def _means_of_chosen(positions: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the mean position of the points that a mask selects in every frame."""
    return np.einsum("tk,tkd->td", chosen / chosen.sum(1, keepdims=True), positions)


def inferred_up(
    names: Sequence[str],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
    hinted: Up | None,
    name: str,
    extent: Float[np.ndarray, "3"] | None = None,
) -> tuple[Up, str]:
    """Infer the up direction from body posture, file format or floor; also return the reason.

    Args:
        names: of the points.
        positions: of the points, in any unit and axes.
        visible: whether each is seen.
        hinted: what the file hints at or its format has by custom; None where nothing does.
        name: of the recording, for the message.
        extent: of a body along the axes, where the longest one tells if nothing else does.

    Raises:
        UnitsError: when none of these tells.
    """
    vectors = vectors_up_body(names, positions, visible)
    rise = vectors.mean(0) if len(vectors) else None
    if rise is not None and abs(rise).max() < _MOSTLY * np.linalg.norm(vectors, axis=-1).mean():
        rise = None
    elif rise is None and hinted is None:
        rise = extent
    try:
        up, reason = decide_up(rise, hinted, name)
    except UnitsError:
        if rise is not None and (floor := axis_of_floor(rise, positions, visible)):
            return floor
        raise
    if hinted is None or hinted == up or hinted[0] != up[0]:
        return up, reason
    hands, feet = (_height_range(one, positions, visible) for one in (hinted, up))
    if hands < _UPSIDE_DOWN * feet:
        return hinted, f"up axis {hinted}: by convention of the file; the body is upside down"
    return up, reason


def decide_up(
    to_head: Float[np.ndarray, "3"] | None, hinted: Up | None, name: str
) -> tuple[Up, str]:
    """Decide the up direction by the vector from feet to head; also return the reason.

    Args:
        to_head: mean vector from feet to head, in any unit; None when unknown.
        hinted: what the file hints at or its format has by custom; it decides where the body
            does not (somebody lying down), and never against an upright body.
        name: of the recording, for the message.

    Raises:
        UnitsError: when neither tells.
    """
    if to_head is not None:
        best, second = (int(k) for k in np.argsort(np.abs(to_head))[:-3:-1])
        found = signed_axis(best, to_head[best])
        if abs(to_head[best]) >= 1.5 * abs(to_head[second]):
            against = f" (the file hints at {hinted})" if hinted not in (None, found) else ""
            if to_head[best] > 0:
                return found, f"up axis {found}: the head is above the feet{against}"
            axis = AXES[best]
            return found, f"up axis: {axis} points down, as the feet are farther along it{against}"
        if hinted is not None and to_head @ to_z_up(hinted)[2] >= 0.5 * abs(to_head[best]):
            return hinted, f"up axis {hinted}: by convention of the file; the body lies or bends"
    elif hinted is not None:
        return hinted, f"up axis {hinted}: by convention of the file; no head and feet show it"
    described = "unknown" if to_head is None else np.array2string(to_head, precision=3)
    raise UnitsError(
        f"{name}: cannot tell which axis points up (from feet to head: {described}); "
        f"give it with --up, one of {', '.join(get_args(Up))}"
    )


def signed_axis(axis: int, sign: float) -> Up:
    """Return an axis direction as text, such as "z" or "z-down", from axis number and sign."""
    return AXES[axis] if sign > 0 else _DOWN[AXES[axis]]


def axis_of_floor(
    to_head: Float[np.ndarray, "3"],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> tuple[Up, str] | None:
    """Infer the up direction of people who crouch or bend, by the constant height of the floor.

    Along it, the lowest moving point varies least over time. Returns None if that is not clear.

    Args:
        to_head: mean vector from feet to head.
        positions: of the points, in any unit.
        visible: whether each is seen.
    """
    size = float(np.abs(to_head).max())
    axes: list[Up] = [signed_axis(axis, to_head[axis]) for axis in range(3)]
    ends = [np.where(visible[..., None], positions, far) for far in (np.inf, -np.inf)]
    moves = (ends[1].max(0) - ends[0].min(0)).max(-1) > _STILL * size
    shown = visible & moves
    if shown.any(1).sum() < 2:
        return None
    moved = np.array([_height_range(direction, positions, shown) for direction in axes])
    above = np.abs(to_head) >= 0.5 * size
    best = int(np.where(above, moved, np.inf).argmin())
    others = np.delete(moved, best)[np.delete(above, best)]
    if moved[best] > _STEADY * others.min(initial=np.inf):
        return None
    return axes[best], f"up axis {axes[best]}: the lowest point stays at the floor along it"


def _height_range(
    up: Up,
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> float:
    """Return how much the lowest visible point's height along `up` varies (5 to 95 % quantile)."""
    heights = np.where(visible, positions @ to_z_up(up)[2], np.inf)[visible.any(1)].min(1)
    return float(np.subtract(*np.quantile(heights, (0.95, 0.05))))


def corrected_up(
    declared: Axis,
    names: Sequence[str],
    positions: Float[np.ndarray, "time points 3"],
    visible: Bool[np.ndarray, "time points"],
) -> Up | None:
    """Return the up direction seen from the body if it contradicts the declared one, else None.

    The body is sure where its unit vectors of all frames have a mean of at least `_SURE` along an
    axis or against it, and `_CLEAR` times as much as along the declared one. Where all that is
    seen is high above the declared floor, somebody with hidden legs may bend or lie down: then
    half of the frames must show the body, and it must keep that direction.
    """
    vectors = vectors_up_body(names, positions, visible)
    if not len(vectors):
        return None
    units = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    mean = units.mean(0)
    best, own = int(np.abs(mean).argmax()), AXES.index(declared)
    if abs(mean[best]) < _SURE or (best == own and mean[own] > 0):
        return None
    if best != own and abs(mean[best]) < _CLEAR * abs(mean[own]):
        return None
    steady = np.quantile(units[:, best] * np.sign(mean[best]), 0.05) > _STEADY_COSINE
    if positions[visible][:, own].min() > _LEGS_M and not (
        steady and 2 * len(vectors) > len(positions)
    ):
        return None
    return signed_axis(best, mean[best])
