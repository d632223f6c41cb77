"""Detects whether a depth sensor declared fixed moves, by the ground and walls that it sees."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from recon.core.errors import ObservationError
from recon.core.planes import find_ground, find_walls
from recon.formats.cameras import CameraArrays

_PLACES, _SHARE = 5, 0.06
"""Stretches of the clip whose planes are compared, and the share of its frames that each has."""
_SAMPLE = 10_000
"""Points that tell the middle of the scene."""
_SAID = (2.0, 0.06)
"""Degrees and metres by which the planes of two stretches differ from which on it is said.
Planes of fixed sensors are found to some tenths of a degree and a centimetre."""
_REFUSED = (5.0, 0.2)
"""Degrees and metres from which on a fit would only follow the sensor."""


def sensor_movement(
    camera: CameraArrays | None, clouds: Sequence[np.ndarray], up: Float[np.ndarray, "3"]
) -> tuple[str, ...]:
    """Return a note if a sensor declared fixed seems to move; raise an error if it surely does.

    A rotation about the vertical, or a movement along the ground, is detected by walls only, not
    by a bare floor.

    Args:
        camera: as read; None for scans.
        clouds: points as read, axes (points, 3), of every frame; some may be empty.
        up: roughly upwards in the frame of the points.

    Raises:
        ObservationError: when it moves so far that a fit would be useless.
    """
    if camera is None or camera.pose_count > 1:
        return ()
    shown = [cloud for cloud in clouds if len(cloud) > 0]
    every = max(1, sum(map(len, shown)) // _SAMPLE)
    middle = np.median(np.concatenate(shown)[::every], axis=0)
    seen = _planes_in_stretches(shown, sensor_position(camera), up)
    tilt, rise = 0.0, 0.0
    for one, other in combinations(seen, 2):
        for planes, others in ((one.grounds, other.grounds), (one.walls, other.walls)):
            # the person may hide a wall for a while: compare the two walls that match best
            pairs = [_plane_difference(a, b, middle) for a in planes for b in others]
            if pairs:
                least = min(pairs, key=lambda pair: pair[0] / _SAID[0] + pair[1] / _SAID[1])
                tilt, rise = max(tilt, least[0]), max(rise, least[1])
    if tilt <= _SAID[0] and rise <= _SAID[1]:
        return ()
    said = (
        "ground or walls lie elsewhere in the sensor's frame from time to time: they differ by "
        f"{tilt:.0f} degrees and {100 * rise:.0f} cm"
    )
    if tilt > _REFUSED[0] or rise > _REFUSED[1]:
        raise ObservationError(
            f"{said}, so the sensor moves; expected one that stands still, or a pose for every "
            "frame (T_camera_world, one per frame): track the sensor, or fit a stretch in which "
            "it is held still"
        )
    return (f"{said}; the sensor seems to move, but is taken as standing still",)


Plane = tuple[Float[np.ndarray, "3"], float]
"""Unit normal n and offset d of the points with n·x = d."""


@dataclass(frozen=True)
class _PlanesInStretch:
    """The planes of ground and walls, as seen in one part of the clip."""

    grounds: tuple[Plane, ...]
    """One, or none."""
    walls: tuple[Plane, ...]


def sensor_position(camera: CameraArrays) -> Float[np.ndarray, "3"]:
    """Return the position of a fixed sensor in the frame of its points, metres."""
    pose = camera.T_camera_world
    return np.zeros(3) if pose is None else np.linalg.inv(pose[0])[:3, 3]


def _planes_in_stretches(
    clouds: Sequence[np.ndarray], eye: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]
) -> list[_PlanesInStretch]:
    """Find ground and walls separately in several parts of the clip."""
    length = max(1, round(_SHARE * len(clouds)))
    found: list[_PlanesInStretch] = []
    for first in np.linspace(0, len(clouds) - length, min(_PLACES, len(clouds))).astype(int):
        stretch = clouds[first : first + length]
        ground = find_ground(stretch, up).ground
        if ground is None:
            grounds, upwards = (), up
        else:
            upwards = ground.normal.double().numpy()
            grounds = ((upwards, float(ground.offset)),)
        turn = _turn_to_z(upwards)
        walls = find_walls([cloud @ turn.T for cloud in stretch], turn @ eye)
        found.append(_PlanesInStretch(grounds, tuple((turn.T @ n, offset) for n, offset in walls)))
    return found


def _turn_to_z(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return a rotation matrix that turns a direction to the z axis."""
    across = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    across /= np.linalg.norm(across)
    return np.stack((across, np.cross(up, across), up))


def _plane_difference(
    one: Plane, other: Plane, middle: Float[np.ndarray, "3"]
) -> tuple[float, float]:
    """Return angle (degrees) and distance at a point `middle` (metres) of two planes."""
    (a, far), (b, far_other) = one, other
    # a plane has two opposite normals: compare the planes with normals of the same direction
    sign = np.sign(a @ b)
    away = (a @ middle - far) - sign * (b @ middle - far_other)
    across = float(np.linalg.norm(np.cross(a, b)))
    return math.degrees(math.asin(min(across, 1.0))), float(abs(away))
