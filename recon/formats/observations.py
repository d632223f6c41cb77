"""Reads and writes observation files: the data of one sensor as plain arrays in an .npz."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.core import limits
from recon.core.camera import check_pose
from recon.core.errors import FormatError
from recon.core.limits import Limit
from recon.core.units import METRES, check_unit, to_z_up
from recon.formats.cameras import CameraArrays as CameraArrays
from recon.formats.cameras import CameraFields, checked_camera
from recon.formats.opening import load_arrays
from recon.formats.replacing import save_arrays
from recon.formats.scan_times import PointClock, compact_clock

_POSITIONS = ("positions", "visible", "names", "fps", "up_axis")
_KEYS = {
    "joints3d": _POSITIONS,
    "markers3d": _POSITIONS,
    "keypoints3d": _POSITIONS,
    "keypoints2d": ("pixels", "confidence", "layout", "fps", "camera_matrix", "image_size"),
    "points": ("points", "frame", "fps"),
}
"""Names of the arrays that a file of each kind of observation must have."""
_NOT_WRITTEN = ("decisions", "focal_std", "path", "camera")
"""Fields that files do not hold, or, as `camera`, hold as several arrays."""


@dataclass(frozen=True, kw_only=True)
class _ObservationFields:
    """Optional data of an observation of any kind."""

    truth_visible: Bool[np.ndarray, "truth 22"] | None = None
    """Whether a simulated sensor could see each body joint; fits never read it."""
    truth_T_world_camera: Float[np.ndarray, "4 4"] | None = None
    """True pose of a simulated camera whose pose was left out, metres; fits never read it."""
    decisions: tuple[str, ...] = ()
    """What was assumed about a file of another program, in sentences. Not saved to files."""


@dataclass(frozen=True)
class PositionsFile(_ObservationFields):
    """Positions of named 3D points in all frames: body joints, markers or keypoints."""

    kind: Literal["joints3d", "markers3d", "keypoints3d"]
    positions: Float[np.ndarray, "time points 3"]
    """Positions in metres, world frame with z up; zero where not visible."""
    visible: Bool[np.ndarray, "time points"]
    names: tuple[str, ...]
    fps: float
    start_time: float = 0.0
    ground_known: bool = True
    """Whether the ground is at z = 0."""
    std: Float[np.ndarray, "time points"] | None = None
    """Standard deviation of the coordinates of every point, metres; zero where not visible. None
    where it is not known."""
    level: bool = True
    """Whether z points up; false in the frame of a camera that may be tilted."""
    placed: bool = True
    """Whether positions are in a fixed world; false where they are relative to the body."""
    fingers: Float[np.ndarray, "time 42 4"] | None = None
    """Position, metres, and confidence of points of the hands (`recon.core.fingers`)."""


@dataclass(frozen=True)
class KeypointsFile(_ObservationFields):
    """2D keypoints of one person in all frames of one view, with its camera."""

    pixels: Float[np.ndarray, "time points 2"]
    """Pixels as detected, lens distortion included; zero where the confidence is zero."""
    confidence: Float[np.ndarray, "time points"]
    layout: str
    """Layout of the keypoints: openpose25, coco17, halpe26, smpl22, ..."""
    fps: float
    camera: CameraArrays
    start_time: float = 0.0
    fingers: Float[np.ndarray, "time 42 3"] | None = None
    """Pixels, as detected, and confidence of the points of hands; zero where not seen."""


@dataclass(frozen=True)
class PointsFile(_ObservationFields):
    """Point clouds of all frames, in one array of points."""

    points: Float[np.ndarray, "points 3"]
    """Positions, metres: in the world with z up, or in the frame of a camera without pose."""
    frame: Int[np.ndarray, " points"]
    """The frame each point was seen in, from 0."""
    fps: float
    camera: CameraArrays | None = None
    start_time: float = 0.0


ObservationFile = PositionsFile | KeypointsFile | PointsFile


def load_observation(path: str | Path, *, unit: str | None = None) -> ObservationFile:
    """Read an observation file of any kind, turned to z up where it has y up.

    Args:
        path: of the .npz file.
        unit: of the positions, as the caller believes; None for metres. They are returned as they
            are; only the range in which they must lie depends on it.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, of an unknown kind, lacks a key, or has arrays of the wrong
            shape, with NaN or infinity or outside the ranges of `recon.core.limits`; the message
            says what was expected.
    """
    path = Path(path)
    check_unit(unit)
    found = _FileArrays(path, load_arrays(path))
    kind, keys = found.text("kind"), ", ".join(sorted(found.arrays))
    if kind not in _KEYS:
        raise FormatError(
            f"{path}: expected an observation whose kind is one of {', '.join(_KEYS)}; got "
            f"{kind!r}, with the keys {keys}"
        )
    if missing := [key for key in _KEYS[kind] if key not in found.arrays]:
        raise FormatError(
            f"{path}: an observation of kind {kind} needs {', '.join(_KEYS[kind])}; missing "
            f"{', '.join(missing)}; found {keys}"
        )
    rate = limits.CLOCK_RATE if kind == "points" else limits.FRAME_RATE
    common: dict[str, Any] = {
        "fps": found.number("fps", 0.0, rate),
        "start_time": found.number("start_time", 0.0, limits.TIME),
        "truth_visible": found.optional("truth_visible", (None, 22), "b"),
        "truth_T_world_camera": found.poses("truth_T_world_camera", (4, 4)),
    }
    if kind == "points":
        return _points_file(found, common)
    if kind == "keypoints2d":
        file, frames = _keypoints_file(found, common), len(found.arrays["confidence"])
    else:
        file = _positions_file(found, kind, METRES[unit or "m"], common)
        frames = len(file.visible)
    if frames == 0:
        raise FormatError(f"{path}: expected at least one frame, got none")
    limits.FRAMES.check(frames, path)
    if file.truth_visible is not None and len(file.truth_visible) != frames:
        raise FormatError(
            f"{path}: expected truth_visible for {frames} frames, got {len(file.truth_visible)}"
        )
    return file


def save_observation(path: str | Path, file: ObservationFile) -> None:
    """Write an observation file atomically; reading it gives the same record back."""
    kind = "points" if isinstance(file, PointsFile) else "keypoints2d"
    camera = getattr(file, "camera", None)
    values = {"kind": kind, **vars(file), **({} if camera is None else vars(camera))}
    if not isinstance(file, KeypointsFile):
        values["up_axis"] = "z"
    defaults = {key for key in ("level", "placed") if values.get(key)}
    omitted = {*defaults, *_NOT_WRITTEN, *(key for key, value in values.items() if value is None)}
    arrays = {key: np.asarray(value) for key, value in values.items() if key not in omitted}
    save_arrays(Path(path), arrays)


def _positions_file(
    arrays: "_FileArrays", kind: Any, metres: float, common_fields: dict[str, Any]
) -> PositionsFile:
    visible = arrays.checked("visible", (None, None), "b")
    positions = arrays.checked("positions", (*visible.shape, 3))
    limits.JOINTS.check(visible.shape[1], arrays.path, "visible")
    scaled = positions if metres == 1 else positions * metres
    limits.POSITION.check(scaled, arrays.path, "positions", seen=visible)
    std = arrays.optional("std", visible.shape)
    if std is not None:
        limits.POINT_DEVIATION.check(std * metres, arrays.path, "std", seen=visible)
        std = np.where(visible, std, 0.0)
    names = arrays.checked("names", visible.shape[1:], "US")
    fingers = arrays.optional("fingers", (len(visible), 42, 4))
    if fingers is not None:
        limits.POSITION.check(
            fingers[..., :3] * metres, arrays.path, "fingers", seen=fingers[..., 3] > 0
        )
        fingers[..., :3] = fingers[..., :3] @ arrays.rotation_to_z_up().T
    return PositionsFile(
        fingers=fingers,
        kind=kind,
        positions=np.where(visible[..., None], positions @ arrays.rotation_to_z_up().T, 0.0),
        visible=visible,
        names=tuple(names.astype(str).tolist()),
        std=std,
        **{key: bool(arrays.number(key, 1.0)) for key in ("ground_known", "level", "placed")},
        **common_fields,
    )


def _keypoints_file(arrays: "_FileArrays", common_fields: dict[str, Any]) -> KeypointsFile:
    confidence = arrays.checked("confidence", (None, None), limit=limits.CONFIDENCE)
    pixels = arrays.checked("pixels", (*confidence.shape, 2))
    limits.PIXEL.check(pixels, arrays.path, "pixels", seen=confidence > 0)
    limits.JOINTS.check(confidence.shape[1], arrays.path, "confidence")
    fingers = arrays.optional("fingers", (len(confidence), 42, 3))
    if fingers is not None:
        seen = fingers[..., 2] > 0
        limits.PIXEL.check(fingers[..., :2], arrays.path, "fingers", seen=seen)
        fingers = np.where(seen[..., None], fingers, 0.0)
    return KeypointsFile(
        pixels=np.where(confidence[..., None] > 0, pixels, 0.0),
        confidence=confidence,
        layout=arrays.text("layout"),
        camera=_camera_of_file(arrays, len(confidence)),
        fingers=fingers,
        **common_fields,
    )


def _points_file(arrays: "_FileArrays", common_fields: dict[str, Any]) -> PointsFile:
    path = arrays.path
    points = arrays.checked("points", (None, 3), limit=limits.POSITION)
    frame = arrays.checked("frame", points.shape[:1], "iu")
    if len(points) == 0:
        raise FormatError(f"{path}: expected at least one point")
    limits.FRAME_NUMBER.check(frame, path, "frame")
    limits.CLOUD.check(len(points), path, "points")
    camera, rotation_to_z_up = None, arrays.rotation_to_z_up()
    if {"camera_matrix", "image_size"} <= arrays.arrays.keys():
        camera = _camera_of_file(arrays, int(frame.max()) + 1)
    if camera is None or camera.T_camera_world is not None:
        points = points @ rotation_to_z_up.T
    if camera is not None and camera.T_camera_world is not None:
        pose = camera.T_camera_world.copy()
        pose[:, :3, :3] = pose[:, :3, :3] @ rotation_to_z_up.T
        camera = replace(camera, T_camera_world=pose)
    clock = PointClock(frame.astype(np.int64), common_fields["fps"], common_fields["start_time"])
    moving = camera is not None and camera.pose_count > 1
    if not moving and common_fields["truth_visible"] is None:
        clock = compact_clock(clock.frame, clock.fps, clock.start_time, path)
    limits.FRAME_RATE.check(clock.fps, path, "fps")
    return PointsFile(points=points, camera=camera, **{**common_fields, **vars(clock)})


def _camera_of_file(file: "_FileArrays", frames: int) -> CameraArrays:
    """Read the camera of an observation file; it has no pose, one, or one per frame."""
    arrays = file.arrays
    fields = CameraFields(
        "of the file", arrays["camera_matrix"], arrays["image_size"], arrays.get("distortion"),
        pose=arrays.get("T_camera_world"),
    )  # fmt: skip
    distortion = file.optional("distortion", (None,))
    if distortion is not None and len(distortion) not in (4, 5, 8):
        raise FormatError(
            f"{file.path}: expected 4, 5 or 8 numbers in distortion, got {len(distortion)}"
        )
    camera = replace(checked_camera(fields, None, file.path), distortion=distortion)
    if camera.T_camera_world is not None:
        if camera.pose_count != 1 and camera.pose_count < frames:
            raise FormatError(
                f"{file.path}: expected 1 or {frames} poses in T_camera_world, got "
                f"{camera.pose_count}"
            )
        check_pose(camera.T_camera_world, file.path, "T_camera_world")
    return camera


_NUMBERS = "fiu"
_KINDS = {
    _NUMBERS: "numbers",
    "b": "true or false",
    "iu": "whole numbers from 0",
    "US": "texts",
}
"""Kinds of NumPy's dtypes that arrays may have, and how messages call them."""


@dataclass(frozen=True)
class _FileArrays:
    """The arrays of one file, each checked when it is used."""

    path: Path
    arrays: dict[str, np.ndarray]

    def checked(
        self,
        key: str,
        shape: tuple[int | None, ...],
        dtype_kinds: str = _NUMBERS,
        limit: Limit | None = None,
    ) -> np.ndarray:
        """Return an array after checks of dtype and shape (None: any length); numbers as doubles.

        Raises:
            ValueError: when it has another type or shape, or is not finite or beyond the limit.
        """
        value = self.arrays[key]
        fits = value.ndim == len(shape) and all(
            want in (None, got) for got, want in zip(value.shape, shape, strict=True)
        )
        if value.dtype.kind not in dtype_kinds or not fits:
            wanted = ", ".join("?" if size is None else str(size) for size in shape)
            raise FormatError(
                f"{self.path}: expected {_KINDS[dtype_kinds]} of shape ({wanted}) in {key}, got "
                f"{value.dtype} {value.shape}"
            )
        if dtype_kinds != _NUMBERS:
            return value
        if not np.isfinite(value).all():
            raise FormatError(
                f"{self.path}: {key} holds NaN or infinity; write zeros and mark them as not seen"
            )
        if limit is not None:
            limit.check(value, self.path, key)
        return value.astype(np.float64)

    def optional(
        self, key: str, shape: tuple[int | None, ...], dtype_kinds: str = _NUMBERS
    ) -> np.ndarray | None:
        """Return an array as `checked` does; None where the file lacks it."""
        return self.checked(key, shape, dtype_kinds) if key in self.arrays else None

    def poses(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray | None:
        """Return rigid transforms after a check; None where the file lacks them."""
        pose = self.optional(key, shape)
        if pose is not None:
            check_pose(pose, self.path, key)
        return pose

    def number(self, key: str, default: float, limit: Limit | None = None) -> float:
        """Return the single finite number in an array."""
        value = self.arrays.get(key, np.array(default))
        if value.size != 1 or value.dtype.kind not in "fiub" or not np.isfinite(value).all():
            raise FormatError(
                f"{self.path}: expected one number in {key}, got {value.dtype} {value.shape}"
            )
        if limit is not None:
            limit.check(value.reshape(()), self.path, key)
        return float(value.reshape(()))

    def text(self, key: str, default: str = "") -> str:
        """Return the single text in an array."""
        value = self.arrays.get(key, np.array(default))
        if value.size != 1 or value.dtype.kind not in "US":
            raise FormatError(
                f"{self.path}: expected a text in {key}, got {value.dtype} {value.shape}"
            )
        return str(value.astype(str).reshape(()))

    def rotation_to_z_up(self) -> Float[np.ndarray, "3 3"]:
        """Return the rotation matrix from the file's axes to axes with z up."""
        up = self.text("up_axis", "z")
        if up not in ("y", "z"):
            raise FormatError(f"{self.path}: expected up_axis y or z, got {up!r}")
        return to_z_up("y" if up == "y" else "z")
