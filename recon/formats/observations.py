"""Observation files: what a sensor saw, as plain arrays in one .npz, checked at the door."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.core import limits
from recon.core.errors import FormatError
from recon.core.limits import Limit, check_camera, check_pose
from recon.core.units import METRES, Axis, check_override, to_z_up
from recon.formats.camera_path import CameraPath
from recon.formats.opening import load_arrays, save_arrays
from recon.formats.scan_times import PointClock, settled_clock

_KEYS = {
    "joints3d": ("positions", "visible", "names", "fps", "up_axis"),
    "markers3d": ("positions", "visible", "names", "fps", "up_axis"),
    "keypoints3d": ("positions", "visible", "names", "fps", "up_axis"),
    "keypoints2d": ("pixels", "confidence", "layout", "fps", "camera_matrix", "image_size"),
    "points": ("points", "frame", "fps"),
}
"""Kinds of observation and the keys each must have."""


@dataclass(frozen=True)
class CameraArrays:
    """A calibrated camera; OpenCV axes."""

    camera_matrix: Float[np.ndarray, "3 3"]
    """Focal lengths, skew and principal point, pixels."""
    image_size: tuple[int, int]
    """Width and height, pixels."""
    distortion: Float[np.ndarray, " coefficients"] | None = None
    """Lens coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]] in OpenCV's order; None for no distortion."""
    T_camera_world: Float[np.ndarray, "poses 4 4"] | None = None
    """Maps world to camera, metres; one pose or one per frame. None where it is not known."""
    focal_known: bool = True
    """Whether somebody measured the focal length; not written."""
    path: CameraPath | None = None
    """How a camera whose pose is not known moved; not written."""

    @property
    def poses(self) -> int:
        """Number of poses: none where it is not known, one of a fixed camera, or one per frame."""
        return 0 if self.T_camera_world is None else len(self.T_camera_world)


@dataclass(frozen=True)
class PositionsFile:
    """Named 3D points: body joints, markers or keypoints."""

    kind: Literal["joints3d", "markers3d", "keypoints3d"]
    positions: Float[np.ndarray, "time points 3"]
    """Positions in metres, world frame with z up; zero where not visible."""
    visible: Bool[np.ndarray, "time points"]
    names: tuple[str, ...]
    fps: float
    start_time: float = 0.0
    ground_known: bool = True
    """Whether the ground is at z = 0."""
    truth_visible: Bool[np.ndarray, "time 22"] | None = None
    """Body joints that a simulated sensor could see; fits never read it."""
    std: Float[np.ndarray, "time points"] | None = None
    """Standard deviation of the coordinates of every point, metres; zero where not visible. None
    where it is not known."""
    level: bool = True
    """Whether z points up; false in the frame of a camera that may be tilted."""
    placed: bool = True
    """Whether positions are places in the world; false where they are relative to the body."""
    decisions: tuple[str, ...] = ()
    """What was read or guessed of a file of another program; not written."""


@dataclass(frozen=True)
class KeypointsFile:
    """2D keypoints of one view."""

    pixels: Float[np.ndarray, "time points 2"]
    """Pixels as detected, lens distortion included; zero where the confidence is zero."""
    confidence: Float[np.ndarray, "time points"]
    layout: str
    """Layout of the keypoints: openpose25, coco17, halpe26, smpl22, ..."""
    fps: float
    camera: CameraArrays
    start_time: float = 0.0
    truth_visible: Bool[np.ndarray, "time 22"] | None = None
    """Body joints that a simulated sensor could see; fits never read it."""
    truth_T_world_camera: Float[np.ndarray, "4 4"] | None = None
    """True pose of a simulated camera whose pose was left out, metres; fits never read it."""


@dataclass(frozen=True)
class PointsFile:
    """Point clouds, all frames in one list."""

    points: Float[np.ndarray, "points 3"]
    """World frame, metres, z up; the camera's frame when a camera without pose is given."""
    frame: Int[np.ndarray, " points"]
    """The frame each point was seen in, from 0."""
    fps: float
    camera: CameraArrays | None = None
    start_time: float = 0.0
    truth_visible: Bool[np.ndarray, "time 22"] | None = None
    """Body joints that a simulated sensor could see; fits never read it."""
    truth_T_world_camera: Float[np.ndarray, "4 4"] | None = None
    """True pose of a simulated camera whose pose was left out, metres; fits never read it."""
    decisions: tuple[str, ...] = ()
    """What was assumed in reading scans; not written."""


ObservationFile = PositionsFile | KeypointsFile | PointsFile


def load_observation(path: str | Path, *, unit: str | None = None) -> ObservationFile:
    """Read an observation of any kind; files with y up are turned to z up.

    Args:
        path: of the .npz file.
        unit: that the caller takes the positions to be in, where it is not metres. They are
            returned as they are; only the range they must lie in depends on it.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, of an unknown kind, lacks a key, or has arrays of the wrong
            shape, with NaN or infinity or outside the ranges of `recon.core.limits`; the message
            says what was expected.
    """
    path = Path(path)
    check_override(unit)
    arrays = load_arrays(path)
    kind = _text(path, arrays, "kind", "") if "kind" in arrays else None
    if kind not in _KEYS:
        raise FormatError(
            f"{path}: expected an observation whose kind is one of {', '.join(_KEYS)}; got "
            f"{kind!r}, with the keys {', '.join(sorted(arrays))}"
        )
    if missing := [key for key in _KEYS[kind] if key not in arrays]:
        raise FormatError(
            f"{path}: an observation of kind {kind} needs {', '.join(_KEYS[kind])}; missing "
            f"{', '.join(missing)}; found {', '.join(sorted(arrays))}"
        )
    rate = limits.CLOCK_RATE if kind == "points" else limits.FRAME_RATE
    fps = _number(path, arrays, "fps", limit=rate)
    start = _number(path, arrays, "start_time", 0.0, limit=limits.TIME)
    common: dict[str, Any] = {"fps": fps, "start_time": start}
    if "truth_visible" in arrays:
        common["truth_visible"] = _flags(path, arrays, "truth_visible", (None, 22))
    if kind == "keypoints2d":
        return _keypoints(path, arrays, common)
    if kind == "points":
        return _points(path, arrays, common)
    return _positions(path, arrays, common, METRES[unit or "m"])


def save_observation(path: str | Path, file: ObservationFile) -> None:
    """Write an observation in one step; reading it gives the same record back."""
    arrays: dict[str, Any] = {"fps": file.fps, "start_time": file.start_time}
    if file.truth_visible is not None:
        arrays["truth_visible"] = file.truth_visible
    if isinstance(file, PositionsFile):
        arrays |= {"kind": file.kind, "positions": file.positions, "visible": file.visible}
        arrays |= {"names": np.array(file.names), "up_axis": "z"}
        arrays |= {"ground_known": file.ground_known}
        arrays |= {} if file.level else {"level": False}
        arrays |= {} if file.placed else {"placed": False}
        arrays |= {} if file.std is None else {"std": file.std}
    elif isinstance(file, KeypointsFile):
        arrays |= {"kind": "keypoints2d", "pixels": file.pixels, "confidence": file.confidence}
        arrays |= {"layout": file.layout}
    else:
        arrays |= {"kind": "points", "points": file.points, "frame": file.frame, "up_axis": "z"}
    camera = None if isinstance(file, PositionsFile) else file.camera
    if not isinstance(file, PositionsFile) and file.truth_T_world_camera is not None:
        arrays["truth_T_world_camera"] = file.truth_T_world_camera
    if camera is not None:
        arrays |= {"camera_matrix": camera.camera_matrix, "image_size": camera.image_size}
        optional = {"distortion": camera.distortion, "T_camera_world": camera.T_camera_world}
        arrays |= {key: value for key, value in optional.items() if value is not None}
    save_arrays(Path(path), {key: np.asarray(value) for key, value in arrays.items()})


def _positions(
    path: Path, arrays: dict[str, np.ndarray], common: dict[str, Any], metres: float
) -> PositionsFile:
    visible = _flags(path, arrays, "visible", (None, None))
    positions = _floats(path, arrays, "positions", (*visible.shape, 3))
    limits.JOINTS.check(visible.shape[1], path, "visible")
    scaled = positions if metres == 1 else positions * metres
    limits.POSITION.check(scaled, path, "positions", seen=visible)
    names = arrays["names"]
    if names.dtype.kind not in "US" or names.shape != visible.shape[1:]:
        raise FormatError(
            f"{path}: expected {visible.shape[1]} texts in names, got {names.dtype} {names.shape}"
        )
    _check_frames(path, len(visible), common)
    kind = _text(path, arrays, "kind", "")
    return PositionsFile(
        kind=kind,  # type: ignore[arg-type]
        positions=np.where(visible[..., None], _turned(path, arrays, positions), 0.0),
        visible=visible,
        names=tuple(names.astype(str).tolist()),
        ground_known=bool(_number(path, arrays, "ground_known", 1.0)),
        level=bool(_number(path, arrays, "level", 1.0)),
        placed=bool(_number(path, arrays, "placed", 1.0)),
        std=_deviations(path, arrays, visible, metres),
        **common,
    )


def _deviations(
    path: Path, arrays: dict[str, np.ndarray], visible: np.ndarray, metres: float
) -> np.ndarray | None:
    """Standard deviations of points in the unit of their positions, where the file has them."""
    if "std" not in arrays:
        return None
    std = _floats(path, arrays, "std", visible.shape)
    limits.POINT_DEVIATION.check(std * metres, path, "std", seen=visible)
    return np.where(visible, std, 0.0)


def _keypoints(path: Path, arrays: dict[str, np.ndarray], common: dict[str, Any]) -> KeypointsFile:
    confidence = _floats(path, arrays, "confidence", (None, None), limits.CONFIDENCE)
    pixels = _floats(path, arrays, "pixels", (*confidence.shape, 2))
    limits.PIXEL.check(pixels, path, "pixels", seen=confidence > 0)
    limits.JOINTS.check(confidence.shape[1], path, "confidence")
    _check_frames(path, len(confidence), common)
    return KeypointsFile(
        pixels=np.where(confidence[..., None] > 0, pixels, 0.0),
        confidence=confidence,
        layout=_text(path, arrays, "layout", ""),
        camera=_camera(path, arrays, len(confidence)),
        truth_T_world_camera=_true_pose(path, arrays),
        **common,
    )


def _check_frames(path: Path, frames: int, common: dict[str, Any]) -> None:
    """Refuse an observation of nothing, and a truth of another length."""
    if frames == 0:
        raise FormatError(f"{path}: expected at least one frame, got none")
    limits.FRAMES.check(frames, path)
    truth = common.get("truth_visible")
    if truth is not None and len(truth) != frames:
        raise FormatError(f"{path}: expected truth_visible for {frames} frames, got {len(truth)}")


def _points(path: Path, arrays: dict[str, np.ndarray], common: dict[str, Any]) -> PointsFile:
    points = _floats(path, arrays, "points", (None, 3), limits.POSITION)
    frame = arrays["frame"]
    if frame.dtype.kind not in "iu" or frame.shape != points.shape[:1]:
        raise FormatError(
            f"{path}: expected frame with {len(points)} whole numbers from 0, got {frame.dtype} "
            f"{frame.shape}"
        )
    if len(points) == 0:
        raise FormatError(f"{path}: expected at least one point")
    limits.FRAME_NUMBER.check(frame, path, "frame")
    limits.CLOUD.check(len(points), path, "points")
    camera = None
    if "camera_matrix" in arrays and "image_size" in arrays:
        camera = _camera(path, arrays, int(frame.max()) + 1)
    turn = _turn(path, arrays)
    if camera is None:
        points = _turned(path, arrays, points)
    elif camera.T_camera_world is not None:
        points = points @ turn.T
        pose = camera.T_camera_world.copy()
        pose[:, :3, :3] = pose[:, :3, :3] @ turn.T
        camera = replace(camera, T_camera_world=pose)
    frame = frame.astype(np.int64)
    clock = PointClock(frame, common["fps"], common["start_time"])
    moving = camera is not None and camera.poses > 1
    if not moving and "truth_visible" not in common:
        clock = settled_clock(frame, clock.fps, clock.start_time, path)
    limits.FRAME_RATE.check(clock.fps, path, "fps")
    return PointsFile(
        points=points,
        frame=clock.frame,
        fps=clock.fps,
        camera=camera,
        start_time=clock.start_time,
        truth_visible=common.get("truth_visible"),
        truth_T_world_camera=_true_pose(path, arrays),
        decisions=clock.decisions,
    )


def _camera(path: Path, arrays: dict[str, np.ndarray], frames: int) -> CameraArrays:
    size = _floats(path, arrays, "image_size", (2,), limits.IMAGE_SIZE)
    distortion, pose = None, None
    if "distortion" in arrays:
        distortion = _floats(path, arrays, "distortion", (None,))
        if len(distortion) not in (4, 5, 8):
            raise FormatError(
                f"{path}: expected 4, 5 or 8 numbers in distortion, got {len(distortion)}"
            )
    if "T_camera_world" in arrays:
        pose = arrays["T_camera_world"]
        arrays = {**arrays, "T_camera_world": pose[None] if pose.ndim == 2 else pose}
        pose = _floats(path, arrays, "T_camera_world", (None, 4, 4))
        if len(pose) not in (1, frames) and len(pose) < frames:
            raise FormatError(f"{path}: expected 1 or {frames} poses in T_camera_world")
        check_pose(pose, path, "T_camera_world")
    matrix = _floats(path, arrays, "camera_matrix", (3, 3))
    check_camera(matrix, size, distortion, path)
    return CameraArrays(matrix, (int(size[0]), int(size[1])), distortion, pose)


def _true_pose(path: Path, arrays: dict[str, np.ndarray]) -> np.ndarray | None:
    if "truth_T_world_camera" not in arrays:
        return None
    pose = _floats(path, arrays, "truth_T_world_camera", (4, 4))
    check_pose(pose, path, "truth_T_world_camera")
    return pose


def _turned(path: Path, arrays: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    turn = _turn(path, arrays)
    return points if (turn == np.eye(3)).all() else points @ turn.T


def _turn(path: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    up = _text(path, arrays, "up_axis", "z")
    if up not in ("y", "z"):
        raise FormatError(f"{path}: expected up_axis y or z, got {up!r}")
    axis: Axis = "y" if up == "y" else "z"
    return to_z_up(axis)


def _floats(
    path: Path,
    arrays: dict[str, np.ndarray],
    key: str,
    shape: tuple[int | None, ...],
    limit: Limit | None = None,
) -> np.ndarray:
    value = arrays[key]
    if value.dtype.kind not in "fiu" or not _fits(value, shape):
        wanted = ", ".join("?" if size is None else str(size) for size in shape)
        raise FormatError(
            f"{path}: expected numbers of shape ({wanted}) in {key}, got {value.dtype} "
            f"{value.shape}"
        )
    if not np.isfinite(value).all():
        raise FormatError(
            f"{path}: {key} holds NaN or infinity; write zeros and mark them as not seen"
        )
    if limit is not None:
        limit.check(value, path, key)
    return value.astype(np.float64)


def _flags(
    path: Path, arrays: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...]
) -> np.ndarray:
    value = arrays[key]
    if value.dtype != np.bool_ or not _fits(value, shape):
        raise FormatError(
            f"{path}: expected true or false for every frame and point in {key}, got "
            f"{value.dtype} {value.shape}"
        )
    return value


def _fits(value: np.ndarray, shape: tuple[int | None, ...]) -> bool:
    return value.ndim == len(shape) and all(
        want in (None, got) for got, want in zip(value.shape, shape, strict=True)
    )


def _number(
    path: Path,
    arrays: dict[str, np.ndarray],
    key: str,
    default: float | None = None,
    limit: Limit | None = None,
) -> float:
    value = arrays.get(key, np.array(default if default is not None else np.nan))
    if value.size != 1 or value.dtype.kind not in "fiub" or not np.isfinite(value).all():
        raise FormatError(f"{path}: expected one number in {key}, got {value.dtype} {value.shape}")
    if limit is not None:
        limit.check(value.reshape(()), path, key)
    return float(value.reshape(()))


def _text(path: Path, arrays: dict[str, np.ndarray], key: str, default: str) -> str:
    value = arrays.get(key, np.array(default))
    if value.size != 1 or value.dtype.kind not in "US":
        raise FormatError(f"{path}: expected a text in {key}, got {value.dtype} {value.shape}")
    return str(value.astype(str).reshape(()))
