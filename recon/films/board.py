"""Calibrates lenses and poses of cameras from films of a checkerboard (Zhang 2000, by OpenCV)."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.core.errors import ObservationError
from recon.core.units import METRES
from recon.films.decoding import Film, open_film
from recon.formats.cameras import CameraArrays, guessed_camera

_RATE = 5.0
"""Moments per second, in each of which the board is looked for in one picture."""
_MOST, _FEWEST, _FEWEST_SHARED = 50, 8, 3
"""Most and fewest moments from which a lens is calibrated, and fewest moments at which two cameras
must both see the board."""
_MOST_DEVIATION = 0.02
"""Largest relative standard deviation of a focal length that is accepted."""
_AT_ODDS = 0.01
"""Share of the focal length by which corners that two cameras see at once may miss each other: two
centimetres at two metres, as where films begin some frames apart."""
_BLURRED = 3.0
"""Multiple of the median corner error of all moments above which one is left out as blurred."""
_STILL, _STILL_S = 0.5, 1.0
"""Largest movement (pixels) from moment to moment of the corners of a board that lies still, and
least seconds that it must lie on the floor."""
_MOVED = 5.0
"""Least movement (pixels) of a corner from one moment to the next of those used for a lens."""
_LENS = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3
Corners = Float[np.ndarray, "rows columns 2"]
"""Positions of a board's inner corners in an image, pixels."""


@dataclass(frozen=True)
class Board:
    """A checkerboard for calibration: numbers of its inner corners and size of its squares."""

    columns: int
    """Inner corners along a row."""
    rows: int
    square: float
    """Side of a square, metres."""

    @classmethod
    def of(cls, board: str, square: str | None) -> "Board":
        """Read a board from texts: "9x6", its inner corners, and "25mm", the side of a square.

        Raises:
            ObservationError: when a text has another form, or a number is out of range.
        """
        size = re.fullmatch(r"(\d{1,2})\s*[xX]\s*(\d{1,2})", board.strip())
        side = re.fullmatch(
            r"(\d+\.?\d*|\.\d+)\s*(mm|cm|m|inch|in)", (square or "").strip().lower()
        )
        if size is None or min(int(size[1]), int(size[2])) < 3:
            raise ObservationError(
                "board: expected its numbers of inner corners, such as 9x6, at least 3 each way, "
                f"got {board!r}"
            )
        metres = float(side[1]) * METRES[side[2]] if side is not None else 0.0
        if not 1e-3 <= metres <= 1.0:
            raise ObservationError(
                "square: expected the side of the board's squares, 1 mm to 1 m, such as 25mm; got "
                f"{square!r}"
            )
        return cls(int(size[1]), int(size[2]), metres)

    @property
    def points(self) -> Float[np.ndarray, "corners 3"]:
        """Inner corners in the board's own frame, row by row, metres; z is 0."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack((x, y, 0 * x), -1).reshape(-1, 3).astype(np.float32) * self.square

    def seen_in(self, image: UInt8[np.ndarray, "height width 3"]) -> Corners | None:
        """Find the inner corners in an image, the first at a dark square; None if not found."""
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        there, found = cv2.findChessboardCornersSB(grey, (self.columns, self.rows))
        if not there:
            return None
        corners = np.asarray(found, float).reshape(self.rows, self.columns, 2)
        right, down = corners[0, 1] - corners[0, 0], corners[1, 0] - corners[0, 0]
        if right[0] * down[1] < right[1] * down[0]:
            corners = corners[:, ::-1]
        middles = (corners[1:, 1:] + corners[1:, :-1] + corners[:-1, 1:] + corners[:-1, :-1]) / 4
        x, y = middles.round().astype(int).T
        bright = grey[y.clip(0, len(grey) - 1), x.clip(0, grey.shape[1] - 1)].T
        dark = np.indices(bright.shape).sum(0) % 2 == 0
        turned = bright[dark].mean() > bright[~dark].mean()
        return corners[::-1, ::-1] if turned else corners


@dataclass(frozen=True)
class _Lens:
    """A camera with a calibrated lens, and the corners of the board that it saw."""

    seen: Mapping[int, Corners]
    """Corners by the number of the moment at which they were seen."""
    camera: CameraArrays
    error: float
    """Root mean square reprojection error of the corners, pixels."""
    std: float
    """Relative standard deviation of the focal length."""

    @property
    def lens(self) -> tuple[np.ndarray, np.ndarray]:
        """Camera matrix and distortion coefficients, as OpenCV takes them."""
        assert self.camera.distortion is not None
        return self.camera.camera_matrix, self.camera.distortion


def cameras_of_board(
    paths: Sequence[Path], board: Board
) -> tuple[dict[str, CameraArrays], float, tuple[str, ...]]:
    """Calibrate the lenses of cameras from films of a board, and the poses of several cameras.

    Several films begin at one time. The ground is where the board lies still for a second.

    Args:
        paths: of films, one for each camera, whose names become those of the cameras.
        board: the checkerboard that is moved and tilted before the cameras.

    Returns:
        The cameras by name, the mean reprojection error of corners, as a share of the focal
        length, and notes on what was found.

    Raises:
        FileNotFoundError: when there is no such film.
        ObservationError: when a film does not show enough of the board; says what to do.
    """
    lenses = {path.stem: _calibrated_lens(open_film(path), board) for path in paths}
    if len(lenses) < len(paths):
        raise ObservationError(
            "cameras are named after their films, so films need different names, got "
            f"{', '.join(one.stem for one in paths)}; rename one"
        )
    said = [
        f"{name}: focal length {one.camera.camera_matrix[0, 0]:.1f} pixels, standard deviation "
        f"{one.std:.2%}, corners {one.error:.2f} pixels off in {len(one.seen)} moments"
        for name, one in lenses.items()
    ]
    cameras = {name: one.camera for name, one in lenses.items()}
    if len(lenses) > 1:
        every = list(lenses.values())
        poses, ground = _poses_above_floor(_relative_poses(lenses, board), every, board)
        named = zip(cameras.items(), poses, strict=True)
        cameras = {name: replace(one, T_camera_world=T[None]) for (name, one), T in named}
        said.append(ground)
    shares = [one.error / one.camera.camera_matrix[0, 0] for one in lenses.values()]
    return cameras, float(np.mean(shares)), tuple(said)


def _calibrated_lens(film: Film, board: Board) -> _Lens:
    seen: dict[int, Corners] = {}
    for moment, frames in groupby(film, lambda frame: round(frame.time * _RATE)):
        if (corners := board.seen_in(next(frames).image)) is not None:
            seen[moment] = film.in_film(corners)
    if len(seen) < _FEWEST:
        raise ObservationError(
            f"{film.path}: a board of {board.columns}x{board.rows} inner corners is seen in "
            f"{len(seen)} moments, {_FEWEST} are needed; check --board, and film the whole board, "
            "slowly moved and tilted, in good light"
        )
    moved = list[int]()
    for moment, corners in seen.items():
        # images of a board at rest are alike: keep one
        if not moved or np.abs(corners - seen[moved[-1]]).max() > _MOVED:
            moved.append(moment)
    chosen = moved[:: -(-len(moved) // _MOST)]
    _, off, _ = _calibrated_camera(film, board, [seen[k] for k in chosen])
    kept = [k for k, one in zip(chosen, off, strict=True) if one <= _BLURRED * np.median(off)]
    camera, off, std = _calibrated_camera(film, board, [seen[k] for k in kept])
    if std > _MOST_DEVIATION:
        raise ObservationError(
            f"{film.path}: the focal length is uncertain by {std:.0%}, expected at most "
            f"{_MOST_DEVIATION:.0%}; tilt the board by 30 to 45 degrees each way, and bring it "
            "near, into every part of the image"
        )
    return _Lens(seen, camera, float(np.sqrt(np.mean(np.square(off)))), std)


def _calibrated_camera(
    film: Film, board: Board, views: Sequence[Corners]
) -> tuple[CameraArrays, Float[np.ndarray, " moments"], float]:
    """Return a fitted camera, each image's error (pixels), and the focal length's relative std."""
    places = [one.reshape(-1, 1, 2).astype(np.float32) for one in views]
    guess = guessed_camera(film.image_size, film.stated_focal)
    _, matrix, distortion, _, _, stds, _, errors = cv2.calibrateCameraExtended(
        [board.points] * len(places), places, film.image_size, guess.camera_matrix.copy(),
        np.zeros(5), flags=_LENS,
    )  # fmt: skip
    camera = CameraArrays(matrix, film.image_size, distortion.ravel()[:5])
    return camera, errors.ravel(), float(stds[1, 0] / matrix[1, 1])


def _relative_poses(lenses: Mapping[str, _Lens], board: Board) -> list[Float[np.ndarray, "4 4"]]:
    """Return poses T_camera_first, chained over pairs of cameras that see the board at once."""
    if (board.columns + board.rows) % 2 == 0:
        raise ObservationError(
            f"board: one of {board.columns}x{board.rows} corners looks the same upside down, so "
            "cameras cannot agree on its direction; one number must be odd and the other even"
        )
    cameras, names = list(lenses.values()), list(lenses)
    poses = {0: np.eye(4)}
    while len(poses) < len(cameras):
        pairs = product(poses, [k for k in range(len(cameras)) if k not in poses])
        shared = {pair: _moments_both_see(cameras[pair[0]], cameras[pair[1]]) for pair in pairs}
        (known, new), moments = max(shared.items(), key=lambda one: len(one[1]))
        if len(moments) < _FEWEST_SHARED:
            raise ObservationError(
                f"{names[new]}: sees the board together with another camera at {len(moments)} "
                f"moments, {_FEWEST_SHARED} are needed; start all films at once, and hold "
                "the board where two cameras see it, or calibrate each lens by itself"
            )
        one, other = cameras[known], cameras[new]
        places = [
            [np.float32(each.seen[k].reshape(-1, 1, 2)) for k in moments] for each in (one, other)
        ]
        given: Any = (
            [board.points] * len(moments), *places, *one.lens, *other.lens, one.camera.image_size,
        )  # fmt: skip
        found = cv2.stereoCalibrate(*given, flags=cv2.CALIB_FIX_INTRINSIC)
        if (off := found[0] / other.camera.camera_matrix[0, 0]) > _AT_ODDS:
            raise ObservationError(
                f"{names[known]} and {names[new]} disagree where the board is: corners lie "
                f"{off:.1%} of the focal length off, expected at most {_AT_ODDS:.1%}; start all "
                "films at one moment, at one frame rate, and do not mirror any"
            )
        poses[new] = np.vstack((np.hstack(found[5:7]), (0, 0, 0, 1))) @ poses[known]
    return [poses[k] for k in range(len(cameras))]


def _moments_both_see(one: _Lens, other: _Lens) -> list[int]:
    """Return at most 50 evenly spread moments at which two cameras both see the board."""
    both = sorted(one.seen.keys() & other.seen.keys())
    step = max(1, -(-len(both) // _MOST))
    return both[::step]


def _poses_above_floor(
    poses: Sequence[Float[np.ndarray, "4 4"]], lenses: Sequence[_Lens], board: Board
) -> tuple[list[Float[np.ndarray, "4 4"]], str]:
    """Return poses T_camera_world and a note; z = 0 is where the board lies still longest."""
    rests = [
        (_longest_rest(lens.seen), lens, pose) for lens, pose in zip(lenses, poses, strict=True)
    ]
    moments, lens, own = max(rests, key=lambda one: _duration(one[0]))
    if _duration(moments) < _STILL_S:
        raise ObservationError(
            f"the ground is where the board lies still for {_STILL_S:g} s, but it never does; lay "
            "it on the floor at the end, where a camera sees it, before all films stop"
        )
    mean = np.mean([lens.seen[one] for one in moments], axis=0).reshape(-1, 1, 2)
    _, turn, place = cv2.solvePnP(board.points, mean, *lens.lens)
    T_camera_board = np.vstack((np.hstack((cv2.Rodrigues(turn)[0], place)), (0, 0, 0, 1)))
    # a lying board's z axis points into the floor, the world's upwards: turn by 180° about x
    T_first_world = np.linalg.inv(own) @ T_camera_board @ np.diag([1.0, -1.0, -1.0, 1.0])
    note = (
        f"the ground is where the board lies from {moments[0] / _RATE:.1f} to "
        f"{moments[-1] / _RATE:.1f} s"
    )
    return [pose @ T_first_world for pose in poses], note


def _longest_rest(seen: Mapping[int, Corners]) -> list[int]:
    """Return the moments of the longest period in which the board does not move.

    A gap of up to a second, in which the board is hidden, does not end the period.
    """
    rests: list[list[int]] = []
    for moment in sorted(seen):
        last = rests[-1][-1] if rests else -1
        soon = bool(rests) and moment - last <= _STILL_S * _RATE
        if soon and np.abs(seen[moment] - seen[last]).max() < _STILL:
            rests[-1].append(moment)
        else:
            rests.append([moment])
    return max(rests, key=_duration)


def _duration(moments: Sequence[int]) -> float:
    """Return the seconds from the first to the last moment."""
    return (moments[-1] - moments[0]) / _RATE
