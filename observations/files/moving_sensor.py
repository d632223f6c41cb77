"""Whether a depth sensor that is taken for fixed moves: the ground it sees then moves, too."""

import math
from itertools import combinations

import numpy as np
from jaxtyping import Float

from recon.core.errors import ObservationError
from recon.core.geometry.planes import find_ground
from recon.core.ground import Ground
from recon.formats.observations import PointsFile

_PLACES, _SHARE = 5, 0.06
"""Stretches of the clip whose ground is compared, and the share of its frames that each has."""
_SAMPLE = 10_000
"""Points that tell the middle of the scene."""
_SAID = (2.0, 0.06)
"""Degrees and metres by which the grounds of two stretches differ from which on it is said.
Grounds of fixed sensors are found to some tenths of a degree and a centimetre."""
_REFUSED = (5.0, 0.2)
"""Degrees and metres from which on a fit would only follow the sensor."""


def movement(file: PointsFile, up: Float[np.ndarray, "3"]) -> tuple[str, ...]:
    """A note where a fixed sensor seems to move a little.

    A sensor that only turns about the vertical or moves along the ground is not found out.

    Args:
        file: points and camera as read.
        up: roughly upwards in the frame of the points.

    Raises:
        ObservationError: when it moves so far that no fit is worth anything.
    """
    camera = file.camera
    if camera is None or camera.poses > 1:
        return ()
    grounds = _grounds(file, up)
    middle = np.median(file.points[:: max(1, len(file.points) // _SAMPLE)], axis=0)
    pairs = [_apart(one, other, middle) for one, other in combinations(grounds, 2)]
    tilt, rise = (max((pair[k] for pair in pairs), default=0.0) for k in (0, 1))
    if tilt <= _SAID[0] and rise <= _SAID[1]:
        return ()
    said = (
        f"the ground lies elsewhere in the sensor's frame from time to time: it differs by "
        f"{tilt:.0f} degrees and {100 * rise:.0f} cm"
    )
    if tilt > _REFUSED[0] or rise > _REFUSED[1]:
        raise ObservationError(
            f"{said}, so the sensor moves; expected one that stands still, or a pose for every "
            "frame (T_camera_world, one per frame): track the sensor, or fit a stretch in which "
            "it is held still"
        )
    return (f"{said}; the sensor seems to move, but is taken as standing still",)


def _grounds(file: PointsFile, up: Float[np.ndarray, "3"]) -> list[Ground]:
    """The ground as it is seen in some stretches of the clip, where it is seen."""
    numbers = np.unique(file.frame)
    length = max(1, round(_SHARE * len(numbers)))
    found: list[Ground] = []
    for first in np.linspace(0, len(numbers) - length, min(_PLACES, len(numbers))).astype(int):
        last = numbers[first + length - 1]
        some = (file.frame >= numbers[first]) & (file.frame <= last)
        ground = find_ground(file.points[some], up).ground
        found += [] if ground is None else [ground]
    return found


def _apart(one: Ground, other: Ground, middle: Float[np.ndarray, "3"]) -> tuple[float, float]:
    """Degrees between two planes, and metres between them below the middle of the scene."""
    a, b = (plane.normal.double().numpy() for plane in (one, other))
    heights = (a @ middle - float(one.offset), b @ middle - float(other.offset))
    across = float(np.linalg.norm(np.cross(a, b)))
    return math.degrees(math.asin(min(across, 1.0))), float(abs(heights[0] - heights[1]))
