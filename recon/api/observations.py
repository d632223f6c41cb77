"""Brings a caller's observations to one clip with names, batch axis and frame of coordinates."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.core.arrays import is_geometry
from recon.core.errors import ObservationError, ReconError
from recon.fitting.records import Clip
from recon.method.sensor import Sensor, frame_is_level, unposed_camera

Plane = tuple[float, float, float, float]
"""(nx, ny, nz, d): the points x of the ground have n·x = d in the observations' frame, metres."""
ObservationsLike = Sensor | Path | str | Sequence[Sensor | Path | str] | Iterable[Sensor] | Clip
"""One or several observations of one clip: records, files and folders that
`recon.load_observation` reads, or what `recon.simulate` returned."""
GroundChoice = Literal["auto", "known", "unknown"] | Plane | None


@dataclass(frozen=True)
class ClipInFitFrame:
    """A clip whose observations are in the coordinates of the fit, and the transform to these."""

    clip: Clip
    T_recording_given: Float[np.ndarray, "4 4"] | None = None
    """Maps the frame in which the observations were given to the one in which they are fitted,
    metres; None where it is the same."""


def clip_of(given: Any, body: BodyModel) -> Clip:
    """Combine the caller's observations to one clip with the body's precision and device.

    Args:
        given: an observation, several, or a `Clip`; files are read before.
        body: that is to be fitted.

    Raises:
        ObservationError: when there is none, something is no observation, or there are several
            clips.
    """
    if hasattr(given, "keys") or not isinstance(given, Sensor | Clip | Iterable):
        raise _no_observation_error(given)
    if isinstance(given, Clip):
        seen, names = given.observations, given.names
    else:
        seen = (given,) if isinstance(given, Sensor) else tuple(given)
        names = _observation_names(seen)
    if len(seen) == 0:
        raise ObservationError("nothing to fit: expected at least one observation, got none")
    like = body.template
    one = tuple(_with_clip_axis(each).to(device=like.device, dtype=like.dtype) for each in seen)
    if isinstance(given, Clip):
        return replace(given, observations=one)
    return Clip(one, names, (), unposed_camera(one))


def in_fit_frame(clip: Clip, ground: Any) -> ClipInFitFrame:
    """Transform a clip to coordinates that suit the caller's choice of ground.

    A camera whose pose is the identity has none: the recording's frame is its own, and the ground
    is searched from that of a level camera, whose frame is kept where there is no ground.

    Args:
        clip: as it was given.
        ground: a `GroundChoice`.

    Raises:
        ReconError: when the choice is none, or a plane is not below the camera.
    """
    unposed = any(one.unposed for one in clip.observations)
    if ground is None and not unposed:
        ungrounded = tuple(one.derived(ground_known=False) for one in clip.observations)
        return ClipInFitFrame(replace(clip, observations=ungrounded))
    if ground is None or isinstance(ground, str):
        if ground not in (None, "auto", "known", "unknown"):
            raise ReconError(
                "ground: expected 'auto', 'known', 'unknown', None or a plane (nx, ny, nz, d), "
                f"got {ground!r}"
            )
        if unposed and ground == "known":
            raise ReconError(
                "ground: a camera has no pose (T_camera_world is the identity), so its ground "
                "is not at z = 0; give the pose, the plane (nx, ny, nz, d), or 'unknown'"
            )
        if unposed:
            from recon.fitting.ground import LEVEL_CAMERA, camera_above

            return _in_world(clip, camera_above(LEVEL_CAMERA), ground_known=False)
        return ClipInFitFrame(
            clip if ground == "auto" else _with_ground_known(clip, ground_known=ground == "known")
        )
    from recon.fitting.ground import camera_above, world_above  # rarely needed

    plane = _checked_plane(ground)
    if clip.T_recording_camera is not None and clip.notes:
        raise ReconError("ground: files were read with another plane; give this one to recon.read")
    if unposed:
        found = _in_world(clip, camera_above(plane), ground_known=False)
    else:
        level = frame_is_level(clip.observations)
        found = _in_world(clip, world_above(plane), ground_known=level)
    return replace(found, clip=replace(found.clip, ground_given=True))


def with_robust_kernel(clip: Clip, distance: float) -> Clip:
    """Return the clip with Geman and McClure's robust kernel on joints, markers and keypoints3d.

    Args:
        clip: whose keypoints in images and points of surfaces are robust already.
        distance: metres beyond which a residual counts ever less.

    Raises:
        ReconError: when the distance is not a number above 0.
    """
    if not 0 < distance < float("inf"):
        raise ReconError(f"robust: expected 'auto' or metres above 0, got {distance!r}")
    return replace(
        clip, observations=tuple(one.robust_beyond(distance) for one in clip.observations)
    )


def _observation_names(seen: Sequence[Any]) -> tuple[str, ...]:
    """Return a name per observation: its kind, with a number if several are of one kind."""
    for one in seen:
        if not isinstance(one, Sensor):
            raise _no_observation_error(one)
    kinds = [one.kind for one in seen]
    count, number = Counter(kinds), Counter[str]()
    names: list[str] = []
    for kind in kinds:
        number[kind] += 1
        names.append(kind if count[kind] == 1 else f"{kind} {number[kind]}")
    return tuple(names)


def _no_observation_error(given: object) -> ObservationError:
    if is_geometry(given):
        return ObservationError(
            "expected either geometries of Open3D, one per frame, or observations, got both; make "
            "the geometries an observation first, recon.read(geometries, frame_rate=...)"
        )
    return ObservationError(
        "expected observations (recon.Joints3D, Markers3D, Keypoints3D, Keypoints2D, PointCloud "
        "or a sensor of your own that derives from recon.method.Sensor; "
        f"recon.load_observation reads files), got {type(given).__name__}"
    )


def _with_clip_axis(sensor: Sensor) -> Sensor:
    """Return a single clip's observation with a batch axis of length one; refuse batches."""
    if sensor.sees is None and type(sensor).predict is not Sensor.predict:
        sensor.check()
    if sensor.clips == ():
        return sensor[None]
    if sensor.clips != (1,):
        raise ObservationError(
            f"expected the observations of one clip, got leading axes {sensor.clips}; "
            "recon.fit_clips takes several, recon.method.reconstruction.solve a batch"
        )
    return sensor


def _with_ground_known(clip: Clip, *, ground_known: bool) -> Clip:
    seen = tuple(one.derived(ground_known=ground_known) for one in clip.observations)
    return replace(clip, observations=seen, T_recording_camera=unposed_camera(seen))


def _in_world(clip: Clip, T: Float[np.ndarray, "4 4"], *, ground_known: bool) -> ClipInFitFrame:
    moved = replace(clip, observations=tuple(one.transformed(T) for one in clip.observations))
    return ClipInFitFrame(_with_ground_known(moved, ground_known=ground_known), T)


def _checked_plane(ground: object) -> Plane:
    try:
        plane = np.asarray(ground, float)
    except (TypeError, ValueError):
        plane = np.zeros(0)
    if plane.shape != (4,) or not np.isfinite(plane).all():
        raise ReconError(
            "ground: expected 'auto', 'known', 'unknown', None or a plane (nx, ny, nz, d), "
            f"got {ground!r}"
        )
    nx, ny, nz, d = plane.tolist()
    return nx, ny, nz, d
