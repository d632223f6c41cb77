"""Converts point clouds to arrays, and infers their unit and up axis from the person seen."""

from typing import Any, get_args

import numpy as np
from jaxtyping import Float

from recon.core.arrays import is_geometry
from recon.core.coordinates import signed_axis
from recon.core.errors import ReconError, UnitsError
from recon.core.units import METRES, Up, to_z_up

_PERSON = (0.9, 2.6)
"""Metres from corner to corner of a cloud of a person alone; narrower than a factor of ten."""
_ROOM = (0.4, 25.0)
"""Metres that a cloud with a person, and some of the room, extends over."""
_UPRIGHT = 1.35
"""Multiple of the other extents that the height of an upright person is at least."""
_SHORTEST = 1.08
"""Metres that adults who stand extend over, in half of the frames, without the last percent of
points at either end; those of 129 clips have 1.23."""
_SURE = 0.8
"""Evidence from which on feet and head are told apart; of 129 clips 126 have more, none less than
its opposite."""
_SWAY = 0.01
"""Metres by which ends of a cloud go up and down that says nothing."""
_NEAR = 0.15
"""Metres from z = 0 within which the lowest points stand on the floor."""

_BELOW = 0.5
"""Metres below the origin from which on a whole body makes doubtful which of its ends is up."""
_STEADIER, _SWAYS = 2.0, 0.1
"""Multiple of the movement of the steadiest end of the clouds, and metres, up to which the lowest
points of somebody who crouches stay on the floor."""


def array_of_open3d(values: Any) -> np.ndarray:
    """Convert an Open3D vector or tensor to a NumPy array in double precision."""
    values = values.cpu().numpy() if hasattr(values, "cpu") else values
    return np.asarray(values, dtype=np.float64)


def cloud_points(one: Any, name: str) -> np.ndarray:
    """Return the points (N, 3) of an array or an Open3D cloud or mesh, without NaN rows.

    Raises:
        ValueError: when it has no points of three coordinates.
    """
    held = next((getattr(one, key) for key in ("points", "vertices") if hasattr(one, key)), one)
    if held is one and is_geometry(one):  # open3d.t.geometry
        inside = one.point if hasattr(one, "point") else one.vertex
        held = array_of_open3d(inside["positions"]) if "positions" in inside else ()
    found = array_of_open3d(held)
    found = found.reshape(0, 3) if found.size == 0 else found
    if found.ndim != 2 or found.shape[1] != 3:
        raise ReconError(f"{name}: expected points (N, 3), got {found.shape}")
    return found[~np.isnan(found).all(1)]  # organised clouds have NaN at pixels without depth


def unit_of_clouds(clouds: list[np.ndarray], name: str) -> str:
    """Tell the unit of clouds (m, cm or mm) by the size of the person in them.

    Raises:
        UnitsError: when the size fits none.
    """
    sizes = [
        float(np.linalg.norm(np.subtract(*np.percentile(cloud, (98, 2), axis=0))))
        for cloud in clouds
        if len(cloud) >= 10
    ]
    if not sizes:
        raise UnitsError(f"{name}: too few points to tell their unit; give it with --unit")
    size = float(np.median(sizes))
    for (low, high), units in ((_PERSON, ("m", "cm", "mm")), (_ROOM, ("m", "mm"))):
        for unit in units:
            if low <= size * METRES[unit] <= high:
                return unit
    raise UnitsError(
        f"{name}: expected clouds that are {_ROOM[0]} to {_ROOM[1]} m large in m, cm or mm, got "
        f"{size:.3g} units; give the unit with --unit"
    )


def up_of_clouds(
    clouds: list[Float[np.ndarray, "_ 3"]], name: str, *, unit_given: bool
) -> tuple[Up, tuple[str, ...]]:
    """Infer the up direction of scans of one person; return it, with a note if it is not z.

    The longest axis is up, or down: the lower end stays on the floor, is wider, as feet stand
    apart, and has less of the body near it. Scans that show a room have z up, and those of
    somebody who lies or crouches as well, if z = 0 is the floor.

    Args:
        clouds: of every frame, metres.
        name: of the folder, for messages.
        unit_given: whether the user gave the unit, and with it the size of a child.

    Raises:
        UnitsError: when nothing tells, or who stands is no adult.
    """
    shown = [cloud for cloud in clouds if len(cloud) >= 50]
    if not shown:
        return "z", ()
    ends = np.array([np.percentile(cloud, (1, 99), axis=0) for cloud in shown])
    extent = np.median(ends[:, 1] - ends[:, 0], axis=0)
    axis = int(extent.argmax())
    if extent[axis] > _PERSON[1]:
        return "z", ()
    remedy = f"give the up axis with --up, one of {', '.join(get_args(Up))}"
    if extent[axis] < _UPRIGHT * np.delete(extent, axis).max():
        swing = np.ptp(ends, axis=0)
        steady = swing < max(_STEADIER * swing.min(), _SWAYS)
        floors = steady & (abs(np.median(ends, axis=0)) < _NEAR)
        if floors[0, 2] and floors.sum() == 1:
            return "z", ()
        raise UnitsError(
            f"{name}: the up axis is unknown, as the person in the clouds is not upright along "
            f"any axis, and z = 0 need not be the floor; {remedy}"
        )
    low, high = np.median(ends[:, :, axis], axis=0)
    whole = min(abs(low), abs(high), abs(low + high)) < _NEAR
    if whole and high - low < _SHORTEST and not unit_given:
        raise UnitsError(
            f"{name}: the person who stands in the clouds is {high - low:.2f} m tall, less than "
            "an adult; scans are often scaled to unit height. Multiply the points by the height "
            "in metres, or give --unit m for a child or a part of a body"
        )
    evidence = _head_above_feet(shown, signed_axis(axis, 1.0))
    usual = axis == 2 and evidence > -_SURE
    below = -high if usual or evidence > 0 else low
    if below > _BELOW and abs(evidence) < 2 * _SURE:
        raise UnitsError(
            f"{name}: the person stands along {signed_axis(axis, 1.0)}, but which end is up is "
            f"unclear: with the head where it seems to be, the body lies {below:.1f} m below the "
            f"origin; {remedy}"
        )
    if usual:
        return "z", ()
    if abs(evidence) < _SURE:
        raise UnitsError(
            f"{name}: the person stands along {signed_axis(axis, 1.0)}, but which end is up is "
            f"unknown; {remedy}"
        )
    up = signed_axis(axis, evidence)
    return up, (f"up axis {up}: the person in the clouds stands along it",)


def _head_above_feet(clouds: list[np.ndarray], up: Up) -> float:
    """Score above 0 if heads point in the direction `up`, below 0 if they point against it."""
    turned = [cloud @ to_z_up(up).T for cloud in clouds]
    low, foot, middle, head, high = np.array(
        [np.percentile(cloud[:, 2], (1, 6, 50, 94, 99)) for cloud in turned]
    ).T
    sway = np.log((np.ptp(high) + _SWAY) / (np.ptp(low) + _SWAY))
    share = float(np.median((middle - low) / (high - low)))
    apart = [
        np.log(
            _mean_horizontal_radius(cloud[cloud[:, 2] <= a])
            / _mean_horizontal_radius(cloud[cloud[:, 2] >= b])
        )
        for cloud, a, b in zip(turned, foot, head, strict=True)
    ]
    return float(sway + 20 * (share - 0.5) + np.median(apart))


def _mean_horizontal_radius(points: Float[np.ndarray, "points 3"]) -> float:
    """Mean horizontal distance of points from their centroid, plus a small constant."""
    level = points[:, :2]
    return float(np.linalg.norm(level - level.mean(0), axis=-1).mean()) + _SWAY
