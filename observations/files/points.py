"""Observation files at the door: checked for size, axis and names before anything is fitted."""

from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from observations.correspondences import PLACES, BodyPoints
from observations.joints3d import Joints3D
from observations.keypoints3d import Keypoints3D
from observations.markers3d import Markers3D
from recon.body.landmarks import landmark, landmarks, match_markers
from recon.body.model import BodyModel
from recon.core.errors import ObservationError, UnitsError
from recon.core.robust import geman_mcclure, squared
from recon.core.skeleton import JOINTS
from recon.core.units import METRES, Up, check_override, surely_up, to_z_up
from recon.formats.observations import PositionsFile, load_observation

SIZE = (0.25, 2.5)
"""Spread of the points against that of the rest body; outside it the unit must be wrong."""


def load(
    path: str | Path,
    body: BodyModel,
    *,
    unit: str | None = None,
    up: Up | None = None,
    robust: float | None = None,
) -> Joints3D | Markers3D | Keypoints3D:
    """An observation file as an energy of one clip.

    Args:
        path: of an observation .npz.
        body: to compare the size with.
        unit: of the file's positions (m, cm, mm, inch, cmu); None takes the contract's metres
            and refuses what no body can measure.
        up: axis that points up; None believes the file unless the body surely contradicts it.
        robust: distance in metres beyond which a point counts ever less; None is least squares.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when the file is damaged, nothing is visible in it, a name is unknown, or
            unit or axis are wrong; the message says what to do.
    """
    file = load_observation(path, unit=unit)
    if not isinstance(file, PositionsFile):
        raise ObservationError(
            f"{path}: expected 3D joints, markers or keypoints (joints3d, markers3d, keypoints3d)"
        )
    return positions_of(file, path, body, unit=unit, up=up, robust=robust)


def positions_of(
    file: PositionsFile,
    path: str | Path,
    body: BodyModel,
    *,
    unit: str | None = None,
    up: Up | None = None,
    robust: float | None = None,
) -> Joints3D | Markers3D | Keypoints3D:
    """What `load` makes of a file; `path` is for messages.

    Raises:
        ValueError: as `load` does.
    """
    if not file.visible.any():
        raise ObservationError(
            f"{path}: no point is visible in any frame, so there is nothing to fit"
        )
    check_override(unit)
    places, rest = _places(file, path, body)
    positions = _upright(file, path, up) * (METRES[unit] if unit else 1.0)
    _check_size(positions, file.visible, rest, path, told=unit is not None)
    kernel = squared if robust is None else partial(geman_mcclure, sigma=robust)
    visible = torch.from_numpy(file.visible)[None]
    points = torch.from_numpy(positions).float()[None] * visible[..., None]
    std = None if file.std is None else file.std * (METRES[unit] if unit else 1.0)
    if file.kind == "keypoints3d":
        return Keypoints3D(
            points, visible, BodyPoints.of_names(file.names, body), file.fps, file.start_time,
            kernel, file.ground_known, std=std, level=file.level, placed=file.placed,
        )  # fmt: skip
    adapter = Joints3D if file.kind == "joints3d" else Markers3D
    return adapter(
        points, visible, places, file.fps, file.start_time, kernel, file.ground_known, std=std
    )


def _places(
    file: PositionsFile, path: str | Path, body: BodyModel
) -> tuple[tuple[int, ...], Tensor]:
    """Joint numbers or vertices of the named points, and where the rest body has them."""
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


def _upright(file: PositionsFile, path: str | Path, up: Up | None) -> np.ndarray:
    """Positions with z up.

    Raises:
        ValueError: when the body surely stands along another axis than the file says.
    """
    if up is not None:
        return file.positions @ to_z_up(up).T
    if not file.level:
        return file.positions
    if found := surely_up("z", file.names, file.positions, file.visible):
        raise ObservationError(
            f"{path}: says z is up, but the body stands along {found}; give --up {found}, "
            "or --up z if the person really lies or hangs"
        )
    return file.positions


def _check_size(
    positions: np.ndarray, visible: np.ndarray, rest: Tensor, path: str | Path, *, told: bool
) -> None:
    """Refuse points that are spread unlike any body, naming the unit that would fit."""
    ratios = [
        _spread(frame[seen]) / _spread(rest.numpy()[seen])
        for frame, seen in zip(positions, visible, strict=True)
        if seen.sum() >= 4
    ]
    if not ratios or SIZE[0] <= (ratio := float(np.median(ratios))) <= SIZE[1]:
        return
    fitting = [name for name, metres in METRES.items() if SIZE[0] <= ratio * metres <= SIZE[1]]
    hint = f"; give --unit {' or '.join(fitting)}" if fitting and not told else ""
    raise UnitsError(
        f"{path}: expected metres, but the points spread {ratio:.3g} times as far as a "
        f"body's{hint}"
    )


def _spread(points: np.ndarray) -> float:
    """Median distance from the middle: neither noise nor a few wild points change it much."""
    return float(np.median(np.linalg.norm(points - np.median(points, 0), axis=1))) + 1e-9
