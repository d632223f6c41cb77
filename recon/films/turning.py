"""Finds rotations and focal length of a camera on one spot, from points of the background.

A point far away, or any point seen from one spot, keeps its direction in the world. The rotation
of a picture is the one that turns the directions of its points onto those known from the pictures
before (Kabsch), whereby points that disagree count little (Geman-McClure). Where the camera turns
far, only the true focal length lets all agree.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import interp1d
from scipy.spatial.transform import Rotation, Slerp

_NOISE = 0.0015
"""Standard deviation of a point's observed direction, radians."""
_WIDER = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0)
"""Widths of the robust kernel, in multiples of the noise, in the rounds of fitting a rotation."""
_FEWEST_POINTS = 6
"""Fewest points to fit a picture's rotation; with fewer it keeps that of the one before."""
_LEAST_TURN = np.radians(6.0)
"""Least rotation over a film (radians) that differs clearly from a small shift of the camera."""
_FOCAL_TURN = np.radians(10.0)
"""Least rotation over a film (radians) that determines the focal length."""
_FOCAL_FACTORS = np.geomspace(0.7, 1.43, 13)
_MOST_OFF = 0.0025
"""Largest median residual (radians) of points before a camera that only rotates."""


@dataclass(frozen=True)
class CameraMotion:
    """Poses and focal length of a moving camera, in the frame of its first picture."""

    frames: Int[np.ndarray, " pictures"]
    R_first_camera: Float[np.ndarray, "pictures 3 3"]
    """Rotations from the camera's frame to that of the first picture."""
    places: Float[np.ndarray, "pictures 3"]
    """Positions in the first picture's frame, in an unknown unit; zero if it stays on one spot."""
    focal: float
    """Focal length, pixels."""
    focal_told: bool
    """Whether the focal length follows from the motion, instead of being given or guessed."""

    @property
    def angle(self) -> float:
        """The largest angle of rotation from the first picture, radians."""
        return _largest_turn(self.R_first_camera)

    def poses_at(self, frames: Int[np.ndarray, " wanted"]) -> Float[np.ndarray, "wanted 4 4"]:
        """Interpolate the poses T_first_camera at any frames, by shortest rotations."""
        T = np.tile(np.eye(4), (len(frames), 1, 1))
        if len(self.frames) < 2:
            return T
        within = np.clip(frames, self.frames[0], self.frames[-1])
        T[:, :3, :3] = Slerp(self.frames, Rotation.from_matrix(self.R_first_camera))(
            within
        ).as_matrix()
        T[:, :3, 3] = interp1d(self.frames, self.places, axis=0)(within)
        return T


def find_turning(
    frame: Int[np.ndarray, " rows"],
    point: Int[np.ndarray, " rows"],
    pixels: Float[np.ndarray, "rows 2"],
    focal: float,
    *,
    focal_known: bool,
) -> CameraMotion | None:
    """Find a camera's rotation over time; None where it hardly rotates, or leaves its spot.

    Args:
        frame: number of the picture of each observation.
        point: number of the observed point.
        pixels: its position from the principal point, without the lens' distortion.
        focal: focal length in pixels; its guess where it is not known.
        focal_known: whether the focal length is known; if not, it is looked for.
    """
    order = np.argsort(frame, kind="stable")
    frame, point, pixels = frame[order], point[order], pixels[order]
    frames = np.unique(frame)
    starts = np.searchsorted(frame, frames[1:])

    def rotations_at(factor: float) -> tuple[Float[np.ndarray, "pictures 3 3"], np.ndarray]:
        return _chained_rotations(point, pixels / (focal * factor), starts)

    def misfit_at(factor: float) -> float:
        # errors in pixels, not angles: one pixel is a smaller angle at a longer focal length
        return float(np.log1p((rotations_at(factor)[1] * factor / _NOISE) ** 2).mean())

    factor, told = 1.0, False
    found, off = rotations_at(factor)
    if _largest_turn(found) > _FOCAL_TURN and not focal_known:
        values = np.array([misfit_at(one) for one in _FOCAL_FACTORS])
        best = int(values.argmin())
        told = 0 < best < len(values) - 1
        if told:
            around = slice(best - 1, best + 2)
            bend = np.polyfit(np.log(_FOCAL_FACTORS[around]), values[around], 2)
            factor = float(np.exp(-bend[1] / (2 * bend[0])))
            found, off = rotations_at(factor)
    if _largest_turn(found) < _LEAST_TURN or np.median(off) > _MOST_OFF:
        return None
    return CameraMotion(frames, found, np.zeros((len(frames), 3)), focal * factor, told)


def _largest_turn(rotations: Float[np.ndarray, "pictures 3 3"]) -> float:
    """Return the largest angle of rotation from the first picture, radians."""
    return float(Rotation.from_matrix(rotations).magnitude().max())


def fitted_rotation(
    rays: Float[np.ndarray, "points 3"],
    goal: Float[np.ndarray, "points 3"],
    R: Float[np.ndarray, "3 3"] | None = None,
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """Fit a rotation R with R rays ≈ goal robustly; return R, and each ray's residual and weight.

    Args:
        rays: unit vectors before the rotation.
        goal: the same vectors after it.
        R: first guess; None is no rotation.
    """
    R, off, weight = np.eye(3) if R is None else R, np.zeros(len(rays)), np.ones(len(rays))
    for wider in _WIDER:
        off = np.linalg.norm(rays @ R.T - goal, axis=1)
        weight = 1 / (1 + (off / (wider * _NOISE)) ** 2) ** 2
        u, _, vt = np.linalg.svd((goal * weight[:, None]).T @ rays)
        R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return R, off, weight


def _chained_rotations(
    point: Int[np.ndarray, " rows"],
    places: Float[np.ndarray, "rows 2"],
    starts: Int[np.ndarray, " later"],
) -> tuple[Float[np.ndarray, "pictures 3 3"], Float[np.ndarray, " compared"]]:
    """Return the rotation of each picture to the first, and residuals (radians) of all points.

    Args:
        point: number of the observed point in each row, sorted by picture.
        places: x/z and y/z of each observation in the camera's frame.
        starts: first rows of all pictures but the first.
    """
    rays = np.concatenate((places, np.ones((len(places), 1))), 1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    known, trust = np.zeros((point.max() + 1, 3)), np.zeros(point.max() + 1)
    turn, turns, errors = np.eye(3), list[np.ndarray](), [np.zeros(1)]
    for rows in np.split(np.arange(len(point)), starts):
        numbers, seen, weight = point[rows], rays[rows], np.ones(len(rows))
        old = trust[numbers] > 0
        if old.sum() >= _FEWEST_POINTS:
            turn, error, weight[old] = fitted_rotation(seen[old], known[numbers[old]], turn)
            errors.append(error)
        turns.append(turn)
        trust[numbers] += weight + 1e-3
        share = (weight + 1e-3) / trust[numbers]
        known[numbers] += share[:, None] * (seen @ turn.T - known[numbers])
    return np.stack(turns), np.concatenate(errors)
