"""Observation files of points, checked for size, axes and names before a fit."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.correspondences import PLACES, BodyPoints
from observations.joints3d import Joints3D
from observations.keypoints3d import Keypoints3D
from observations.markers3d import Markers3D
from recon.body.landmarks import landmark, landmarks
from recon.body.marker_labels import match_markers
from recon.body.model import BodyModel
from recon.core.arrays import finite_median
from recon.core.coordinates import corrected_up
from recon.core.errors import FormatError, ObservationError, UnitsError
from recon.core.hands import right_handed_signs
from recon.core.layouts import LAYOUTS, keypoint_names
from recon.core.residuals import geman_mcclure, squared
from recon.core.skeleton import JOINTS
from recon.core.units import METRES, Hand, Up, check_unit, to_z_up
from recon.formats.observations import PositionsFile
from recon.keypoints3d.layouts import KNOWN_BY_COUNT

_ROOM = (-0.3, 2.5)
"""Metres above the floor between which a person lies or hangs."""
SIZE = (0.25, 2.5)
"""Spread of the points against that of the rest body; outside it the unit must be wrong."""


def positions_of(
    file: PositionsFile,
    path: str | Path,
    body: BodyModel,
    *,
    unit: str | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
    robust: float | None = None,
) -> Joints3D | Markers3D | Keypoints3D:
    """The points of an observation file as a sensor of one clip.

    Args:
        file: as read.
        path: of the file, for messages.
        body: to compare the size with.
        unit: as of `positions_in_metres`.
        up: as of `positions_in_metres`.
        hand: as of `positions_in_metres`.
        robust: distance in metres beyond which a point counts ever less; None is least squares.

    Raises:
        ValueError: when nothing is visible in it, a name is unknown, or unit or axis are wrong;
            the message says what to do.
    """
    file = positions_in_metres(file, path, body, unit=unit, up=up, hand=hand)
    places, _ = _places_on_body(file, path, body)
    kernel = squared if robust is None else partial(geman_mcclure, sigma=robust)
    visible = torch.from_numpy(file.visible)[None]
    points = torch.from_numpy(file.positions).float()[None] * visible[..., None]
    if file.kind == "keypoints3d":
        return Keypoints3D(
            points, visible, BodyPoints.of_names(file.names, body), file.fps, file.start_time,
            kernel, file.ground_known, std=file.std, level=file.level, placed=file.placed,
            fingers=None if file.fingers is None else file.fingers[None],
        )  # fmt: skip
    given = (points, visible, places, file.fps, file.start_time, kernel, file.ground_known)
    if file.kind == "joints3d":
        return Joints3D(*given, std=file.std)
    return Markers3D(*given, std=file.std)


def positions_in_metres(
    file: PositionsFile,
    path: str | Path,
    body: BodyModel,
    *,
    unit: str | None = None,
    up: Up | None = None,
    hand: Hand | None = None,
) -> PositionsFile:
    """The points in metres and right-handed axes with z up, with notes on how they were read.

    Args:
        file: as read.
        path: of the file, for messages.
        body: to compare the size with.
        unit: of the file's positions (m, cm, mm, inch, ft, cmu); None takes the contract's metres
            and refuses what no body can measure.
        up: axis that points up, or down; None believes the file unless the body contradicts it.
        hand: handedness of the axes; None tells it from the body.

    Raises:
        ValueError: when nothing is visible in it, a name is unknown, or unit or axis are wrong;
            the message says what to do.
    """
    if not file.visible.any():
        raise ObservationError(
            f"{path}: no point is visible in any frame, so there is nothing to fit"
        )
    check_unit(unit)
    _, rest = _places_on_body(file, path, body)
    metres = METRES[unit] if unit else 1.0
    turn, said = _turn_to_z_up(file, path, up)
    positions = file.positions @ turn.T * metres
    _check_size(positions, file.visible, rest, path, unit_given=unit is not None)
    matched, _ = match_markers(file.names) if file.kind == "markers3d" else ({}, ())
    names = [matched.get(name, name) for name in file.names]
    factors, mirrored = right_handed_signs(names, positions, file.visible, hand)
    fingers = file.fingers
    if fingers is not None:
        moved = fingers[..., :3] @ turn.T * metres * factors
        fingers = np.concatenate((moved, fingers[..., 3:]), -1)
    return replace(
        file, positions=positions * factors, fingers=fingers,
        std=None if file.std is None else file.std * metres,
        decisions=(*file.decisions, *said, *mirrored),
    )  # fmt: skip


def _places_on_body(
    file: PositionsFile, path: str | Path, body: BodyModel
) -> tuple[tuple[int, ...], Tensor]:
    """Joint numbers or vertices of the named points, and their positions on the rest body."""
    if file.kind == "joints3d":
        if unknown := [name for name in file.names if name not in JOINTS]:
            raise ObservationError(
                f"{path}: no joint is called {', '.join(unknown)}; name the points among "
                f"{', '.join(JOINTS)} and leave the others out"
            )
        joints = tuple(JOINTS.index(name) for name in file.names)
        return joints, body.joint_template[list(joints)]
    if file.kind == "keypoints3d":
        if unknown := [name for name in file.names if name not in PLACES]:
            raise ObservationError(
                f"{path}: no keypoint is called {', '.join(unknown)}; name the points among "
                f"{', '.join(PLACES)} and leave the others out"
            )
        points = BodyPoints.of_names(file.names, body)
        return (), points.at_rest(body, body.template.new_zeros(body.shape_size))
    if body.checksum != BodyModel.load().checksum:
        raise ObservationError(
            f"{path}: markers sit on vertices of the bundled body, which {body.name!r} does not "
            "have; fit markers without --body, or build Markers3D with vertices of your own mesh"
        )
    matched, _ = match_markers(file.names)
    matched |= {name: name for name in file.names if name in landmarks()}
    if unknown := [name for name in file.names if name not in matched]:
        raise ObservationError(
            f"{path}: the markers {', '.join(unknown)} are not known; use landmark names "
            f"({', '.join(sorted(landmarks())[:6])}, ...) or leave them out"
        )
    vertices = tuple(landmark(matched[name]) for name in file.names)
    return vertices, body.template[list(vertices)]


def _turn_to_z_up(
    file: PositionsFile, path: str | Path, up: Up | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rotation to axes with z up, and a note if it was inferred, not stated in the file.

    Raises:
        ValueError: when the body stands along another axis than the file says, and may as well
            lie or hang.
    """
    if up is not None:
        return to_z_up(up), ()
    found = corrected_up("z", file.names, file.positions, file.visible) if file.level else None
    if found is None:
        return np.eye(3), ()
    low, high = np.quantile(file.positions[..., 2][file.visible], (0.02, 0.98))
    if _ROOM[0] < low and high < _ROOM[1]:
        raise ObservationError(
            f"{path}: the file has z up, but the body stands along {found}; give --up {found}, "
            "or --up z if the person really lies or hangs"
        )
    said = f"up axis {found}: the file says z, but the body stands along it, and not above z = 0"
    return to_z_up(found), (said,)


def _check_size(
    positions: np.ndarray, visible: np.ndarray, rest: Tensor, path: str | Path, *, unit_given: bool
) -> None:
    """Refuse points whose spread no body has, naming the unit that would fit."""
    frames = np.flatnonzero(visible.sum(1) >= 4)
    frames = frames[:: max(len(frames) // _MOMENTS, 1)]
    seen = visible[frames, :, None]
    sizes = [_median_spread(np.where(seen, p, np.nan)) for p in (positions[frames], rest.numpy())]
    ratio = float(np.median(sizes[0] / sizes[1])) if len(frames) > 0 else 1.0
    if SIZE[0] <= ratio <= SIZE[1]:
        return
    fitting = [name for name, metres in METRES.items() if SIZE[0] <= ratio * metres <= SIZE[1]]
    hint = f"; give --unit {' or '.join(fitting)}" if fitting and not unit_given else ""
    raise UnitsError(
        f"{path}: expected metres, but the points spread {ratio:.3g} times as far as a "
        f"body's{hint}"
    )


def _median_spread(points: np.ndarray) -> Float[np.ndarray, " frames"]:
    """Median distance of every frame's points from their middle; a few may be wild or NaN."""
    middle = finite_median(points.swapaxes(-1, -2))
    return finite_median(np.linalg.norm(points - middle[:, None], axis=-1)) + 1e-9


GOOD = 0.35
"""Misfit up to which points may be a body in a layout; those of real people are below a half of
it, those of a wrong layout above twice of it."""
_BETTER = 0.6
"""Share of the second best misfit up to which the best is clearly the right one."""
_FEWEST = 4
"""Distances along bones without which no size is told."""
_LONG = 0.1
"""Metres at rest from which on a distance says more of a body than of noise."""
_MOMENTS = 400
"""Moments that are looked at."""


@dataclass(frozen=True)
class BoneLengths:
    """Distances of points along bones, relative to those of the average body."""

    size: float
    """Median of the ratios: 1000 for a person of average size in millimetres."""
    misfit: float
    """How far ratios are from their median, plus how far each distance varies over time; both
    relative, at most 1, and averaged over the distances."""


def bone_lengths(
    positions: Float[np.ndarray, "time points 3"], points: BodyPoints, body: BodyModel
) -> BoneLengths | None:
    """Measure how points' distances fit a body of any size; None where too few are visible."""
    rest = points.at_rest(body, body.template.new_zeros(body.shape_size)).double().numpy()
    some = positions[:: max(len(positions) // _MOMENTS, 1)]
    ratios: list[float] = []
    spreads: list[float] = []
    apart = np.linalg.norm(rest[:, None] - rest[None], axis=-1)
    for a, b in points.rigid_pairs(body):
        if apart[a, b] < _LONG:
            continue
        length = np.linalg.norm(some[:, a] - some[:, b], axis=-1)
        length = length[np.isfinite(length)]
        if len(length) == 0:
            continue
        middle = float(np.median(length))
        ratios.append(middle / float(apart[a, b]))
        spreads.append(float(np.median(np.abs(length - middle))) / max(middle, 1e-12))
    if len(ratios) < _FEWEST:
        return None
    size = float(np.median(ratios))
    away = np.minimum(np.abs(np.array(ratios) / max(size, 1e-12) - 1), 1.0)
    return BoneLengths(size, float(away.mean() + np.minimum(spreads, 1.0).mean()))


def settle_body_layout(
    positions: Float[np.ndarray, "time points 3"],
    layout: str | None,
    body: BodyModel,
    name: str,
) -> tuple[str, str]:
    """The keypoint layout of an array of points without names, and the reason.

    Args:
        positions: in any unit and axes; NaN where not seen.
        layout: what the caller or the format says; None to tell it from the array.
        body: whose proportions decide.
        name: of the file, for messages.

    Raises:
        ValueError: when the layout is wrong, or none fits, or two do; names what fits.
    """
    count = positions.shape[1]
    misfits = {
        one: _misfit_of_layout(positions, one, body)
        for one, names in LAYOUTS.items()
        if len(names) == count
    }
    fitting = [one for one, misfit in misfits.items() if misfit <= GOOD]
    if layout is not None:
        if len(keypoint_names(layout)) != count:
            raise FormatError(
                f"{name}: layout {layout} has {len(keypoint_names(layout))} keypoints, the file "
                f"{count}{_hint_at_layout(fitting)}"
            )
        if misfits[layout] > GOOD:
            raise FormatError(
                f"{name}: read in the layout {layout}, the points do not form a body: lengths of "
                f"bones change, or nobody has such bones{_hint_at_layout(fitting)}"
            )
        return layout, f"layout {layout}: given"
    if not misfits:
        known = {one: len(names) for one, names in LAYOUTS.items()}
        known |= {what: number for number, what in KNOWN_BY_COUNT.items()}
        raise FormatError(
            f"{name}: {count} points, but known layouts have other numbers ("
            f"{', '.join(f'{one} {number}' for one, number in known.items())}); write the names "
            "of the points beside them, in a table or .npz; those of hands are left_hand_wrist, "
            "left_thumb1, left_thumb_tip, left_index1, ..."
        )
    if not fitting:
        raise FormatError(
            f"{name}: {count} points may be {' or '.join(misfits)}, but they are a body in none "
            "of these orders; give the right one with --layout, or write the points with names"
        )
    best, *others = sorted(fitting, key=lambda one: misfits[one])
    if others and misfits[best] > _BETTER * misfits[others[0]]:
        raise FormatError(
            f"{name}: {count} points fit {' and '.join((best, *others))}; choose one by --layout"
        )
    which = f"{count} points" if len(misfits) == 1 else f"{count} points, a body only so"
    return best, f"layout {best}: {which}"


def _hint_at_layout(fitting_layouts: list[str]) -> str:
    return (
        f"; {' or '.join(fitting_layouts)} fits, give it with --layout" if fitting_layouts else ""
    )


def _misfit_of_layout(positions: np.ndarray, layout: str, body: BodyModel) -> float:
    found = bone_lengths(positions, BodyPoints.of_layout(layout, body), body)
    return np.inf if found is None else found.misfit
