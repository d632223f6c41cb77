"""Reads camera paths of trackers as poses with OpenCV's axes.

* COLMAP, `images.txt` (a folder with it) and `cameras.txt`: quaternion first, world to camera,
  axes x right, y down, z forward; any world, any unit (https://colmap.github.io/format.html).
* TUM, text of `timestamp tx ty tz qx qy qz qw`: camera to world; any world, any unit. Read with
  OpenCV's axes (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
* DROID-SLAM and DPVO, `.npy` or `.npz` of (frames, 7): tx ty tz qx qy qz qw, camera to world, as
  `Droid.terminate` returns them (`camera_trajectory.inv()` in droid_slam/droid.py); any unit.
* ARKit, `.json`: `transform` of `ARCamera`, camera to world, metres, the world's y up; axes x
  right, y up, z backwards (https://developer.apple.com/documentation/arkit/arcamera/transform).
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError
from recon.core.units import to_z_up
from recon.formats.cameras import CameraFields
from recon.formats.json_files import read_json
from recon.formats.opening import existing_file, load_array, load_arrays

_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
"""COLMAP's camera models whose distortion OpenCV's coefficients express, and their parameters."""
_LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def read_colmap(path: Path) -> "CameraTrack":
    """Read the poses of COLMAP's `images.txt` and the intrinsics of its `cameras.txt`.

    Images come in the order of their names; the last number of a name is that of its frame.

    Raises:
        ValueError: when there are no images or lines are damaged, or they are of several cameras.
    """
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("#")]
    # every second line lists the points in an image, and is not needed
    fields = [line.split(maxsplit=9) for line in lines[::2] if line.strip()]
    if short := [one for one in fields if len(one) < 10]:
        raise FormatError(
            f"{path}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got "
            f"{' '.join(short[0])[:80]!r}"
        )
    images = {one[9].strip(): one for one in fields}
    if len(images) < 2:
        raise FormatError(f"{path}: expected images with poses, found {len(images)}")
    if len({one[8] for one in images.values()}) > 1:
        raise FormatError(
            f"{path}: its images are of several cameras; expected those of one film: run COLMAP "
            "with --ImageReader.single_camera 1"
        )
    found = {name: re.findall(r"\d+", Path(name).stem)[-1:] for name in images}
    names = sorted(images, key=lambda name: (int((found[name] or "0")[0]), name))
    rows = np.array([_parsed_numbers(images[name][1:8], path) for name in names])
    T = np.linalg.inv(rigid_transforms(rows[:, [1, 2, 3, 0]], rows[:, 4:], path))
    numbers = [int(found[name][0]) for name in names if found[name]]
    counted = len(set(numbers)) == len(names)
    cameras = path.with_name("cameras.txt")
    camera = _colmap_camera(cameras, images[names[0]][8]) if cameras.is_file() else None
    return CameraTrack(T, np.array(numbers) if counted else None, None, camera, "COLMAP")


def read_tum(path: Path) -> "CameraTrack":
    """Read a TUM file: lines of a time (seconds, or frame number if all are whole) and a pose.

    Raises:
        ValueError: when a line has not eight numbers, or times do not rise.
    """
    rows: list[list[float]] = []
    for line in path.read_text("utf-8").splitlines():
        fields = line.replace(",", " ").split()
        if not fields or line.startswith("#"):
            continue
        if len(fields) != 8:
            raise FormatError(
                f"{path}: expected timestamp tx ty tz qx qy qz qw, got {line[:80]!r}"
            )
        rows.append(_parsed_numbers(fields, path))
    table = np.array(rows).reshape(-1, 8)
    times = table[:, 0]
    if len(table) < 2 or not (np.diff(times) > 0).all():
        raise FormatError(
            f"{path}: expected two or more poses with rising timestamps, got {len(table)} "
            "poses, or timestamps that do not rise"
        )
    frames = times.astype(np.int64) if (times == np.round(times)).all() else None
    return CameraTrack(
        rigid_transforms(table[:, 4:], table[:, 1:4], path), frames, times, None, "TUM"
    )


def _colmap_camera(path: Path, camera_id: str) -> CameraFields:
    """Read the intrinsics of the camera with a given ID from COLMAP's `cameras.txt`."""
    lines = [line.split() for line in path.read_text("utf-8").splitlines()]
    fields = next((one for one in lines if one[:1] == [camera_id]), None)
    if fields is None:
        raise FormatError(
            f"{path}: expected camera {camera_id}, which images.txt names, but it is not listed"
        )
    names = _MODELS.get("".join(fields[1:2]), ())
    if not names or len(fields) != 4 + len(names):
        raise FormatError(
            f"{path}: expected a camera of the models {', '.join(_MODELS)}, got "
            f"{' '.join(fields)[:80]!r}"
        )
    own = dict(zip(names, _parsed_numbers(fields[4:], path), strict=True))
    fx, fy = own.get("fx", own.get("f", 0.0)), own.get("fy", own.get("f", 0.0))
    lens = [own.get(name, 0.0) for name in _LENS]
    # COLMAP counts from the corner of the first pixel, OpenCV from its middle
    matrix = [[fx, 0, own["cx"] - 0.5], [0, fy, own["cy"] - 0.5], [0, 0, 1]]
    return CameraFields(
        "track", matrix, _parsed_numbers(fields[2:4], path), lens if any(lens) else None
    )


def _parsed_numbers(fields: list[str], path: Path) -> list[float]:
    try:
        return [float(one) for one in fields]
    except ValueError as error:
        raise FormatError(f"{path}: expected numbers, got {' '.join(fields)[:80]!r}") from error


def rigid_transforms(
    quaternion: Float[np.ndarray, "poses 4"],
    translations: Float[np.ndarray, "poses 3"],
    path: Path,
) -> Float[np.ndarray, "poses 4 4"]:
    """Build rigid transforms from quaternions (x y z w) and translations.

    Raises:
        ValueError: when numbers are not finite, or quaternions are not of length one.
    """
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(quaternion, axis=-1)
    if not np.isfinite(translations).all() or not (np.abs(length - 1) < 0.01).all():
        raise FormatError(
            f"{path}: expected finite numbers and quaternions of length 1, got lengths from "
            f"{np.nanmin(length):.3g} to {np.nanmax(length):.3g}; are its columns in order?"
        )
    return _transforms(Rotation.from_quat(quaternion).as_matrix(), translations)


def _transforms(rotations: np.ndarray, translations: np.ndarray) -> Float[np.ndarray, "poses 4 4"]:
    T = np.tile(np.eye(4), (len(translations), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotations, translations
    return T


_ARKIT = ("transform", "cameraTransform", "camera_transform", "cameraPoseARFrame")
_TIMES = ("timestamp", "time")
_POSE_ARRAYS = ("poses", "traj", "traj_est", "trajectory")
_FLIPPED = np.diag([1.0, -1.0, -1.0, 1.0])
"""Transform from OpenCV's camera axes to ARKit's, which has y and z reversed."""
_KNOWN_FORMATS = (
    "a folder with COLMAP's images.txt, a text of TUM's (timestamp tx ty tz qx qy qz qw), an "
    "array (.npy, .npz) of DROID-SLAM's (frames, 7), or ARKit's .json"
)


@dataclass(frozen=True)
class CameraTrack:
    """Poses of one moving camera over time, with times and intrinsics that its tracker states."""

    T_world_camera: Float[np.ndarray, "poses 4 4"]
    """Poses in the tracker's world and unit; z up where it is `level`."""
    frames: Int[np.ndarray, " poses"] | None
    """Number of the frame of each pose; None where the tracker states none."""
    times: Float[np.ndarray, " poses"] | None
    """Time of each pose, seconds from any origin; None where the tracker states none."""
    camera: CameraFields | None
    """Intrinsics, where the tracker states them."""
    producer: str
    metric: bool = False
    """Whether translations are in metres; otherwise their unit is unknown."""
    level: bool = False
    """Whether the z axis of the world points up."""

    def poses_at_frames(
        self, first: int, count: int, fps: float
    ) -> tuple[Float[np.ndarray, "frames 4 4"], str]:
        """Interpolate T_world_camera at `count` frames from number `first` on; return a note, too.

        Positions are interpolated linearly and rotations by slerp; before the first pose and
        after the last the camera stands still.

        Raises:
            ValueError: when the poses cover less than half of the frames.
        """
        pose_count = len(self.T_world_camera)
        wanted = np.arange(first, first + count, dtype=np.float64)
        if pose_count == count:
            return self.T_world_camera, "a pose for every frame, in their order"
        if self.frames is not None:
            known, how = self.frames.astype(np.float64), "by the numbers of the frames"
        elif self.times is not None:
            known = first + (self.times - self.times[0]) * fps
            how = f"by time, the first pose at the first frame, {fps:g} frames per second"
        else:
            raise FormatError(
                f"{self.producer}: {pose_count} poses for {count} frames, without times or frame "
                "numbers; give one pose for every frame"
            )
        inside = ((wanted >= known[0] - 0.5) & (wanted <= known[-1] + 0.5)).mean()
        if inside < 0.5:
            raise FormatError(
                f"{self.producer}: its {pose_count} poses are of frames {known[0]:.0f} to "
                f"{known[-1]:.0f}, the keypoints of {first} to {first + count - 1}; expected "
                "poses of the same film"
            )
        return _interpolated_poses(self.T_world_camera, known, wanted), how


def read_track(path: Path) -> CameraTrack:
    """Read a camera's path from the file of any known tracker.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or of no tracker that is known.
    """
    if path.is_dir() and (path / "images.txt").is_file():
        path = path / "images.txt"
    existing_file(path)
    match path.suffix.lower():
        case ".txt" | ".tum":
            return (read_colmap if path.name == "images.txt" else read_tum)(path)
        case ".npy":
            return _track_of_droid(load_array(path), None, None, path)
        case ".npz":
            arrays = load_arrays(path)
            name = next((name for name in _POSE_ARRAYS if name in arrays), None)
            if name is None:
                raise FormatError(
                    f"{path}: expected poses of DROID-SLAM or DPVO in one of "
                    f"{', '.join(_POSE_ARRAYS)}, found {', '.join(sorted(arrays))}"
                )
            return _track_of_droid(
                arrays[name], arrays.get("tstamps"), arrays.get("intrinsics"), path
            )
        case ".json":
            return _track_of_arkit(path)
    raise FormatError(f"{path}: expected the track of a camera: {_KNOWN_FORMATS}")


def _interpolated_poses(
    T: Float[np.ndarray, "poses 4 4"], known_times: np.ndarray, wanted_times: np.ndarray
) -> Float[np.ndarray, "frames 4 4"]:
    from scipy.spatial.transform import Rotation, Slerp

    order = np.argsort(known_times)
    known_times, T = known_times[order], T[order]
    held = wanted_times.clip(known_times[0], known_times[-1])
    turns = Slerp(known_times, Rotation.from_matrix(T[:, :3, :3]))(held).as_matrix()
    places = np.stack([np.interp(held, known_times, T[:, k, 3]) for k in range(3)], -1)
    return _transforms(turns, places)


def _track_of_droid(rows: Any, numbers: Any, intrinsics: Any, path: Path) -> CameraTrack:
    if rows.ndim != 2 or rows.shape[1] != 7 or rows.dtype.kind not in "fiu" or len(rows) < 2:
        raise FormatError(
            f"{path}: expected poses of DROID-SLAM or DPVO, an array (frames, 7) of tx ty tz qx "
            f"qy qz qw, got {rows.dtype} {rows.shape}"
        )
    rows = rows.astype(np.float64)
    frames = None if numbers is None else np.asarray(numbers).astype(np.int64).reshape(-1)
    if frames is not None and (len(frames) != len(rows) or not (np.diff(frames) > 0).all()):
        raise FormatError(f"{path}: expected rising tstamps, one for each of {len(rows)} poses")
    camera = None
    if intrinsics is not None:
        fx, fy, cx, cy = np.atleast_2d(np.asarray(intrinsics, np.float64))[0, :4]
        camera = CameraFields("track", [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return CameraTrack(
        rigid_transforms(rows[:, 3:], rows[:, :3], path), frames, None, camera, "DROID-SLAM"
    )


def _track_of_arkit(path: Path) -> CameraTrack:
    value = read_json(path)
    entries = value.get("frames", value) if isinstance(value, dict) else value
    keys = [key for key in _ARKIT if isinstance(entries, list) and entries and key in entries[0]]
    if not keys or not all(isinstance(one, dict) and keys[0] in one for one in entries):
        raise FormatError(
            f"{path}: expected frames of ARKit, each with one of {', '.join(_ARKIT)}"
        )
    matrices = np.array([_square_matrix(one[keys[0]], 4, path) for one in entries])
    times = [next((one[key] for key in _TIMES if key in one), None) for one in entries]
    T = matrices @ _FLIPPED
    level = np.eye(4)
    level[:3, :3] = to_z_up("y")
    stated = entries[0].get(
        "intrinsics", value.get("intrinsics") if value is not entries else None
    )
    size = entries[0].get("imageResolution")
    camera = (
        None if stated is None else CameraFields("track", _square_matrix(stated, 3, path), size)
    )
    known = None if None in times else np.array(times, np.float64)
    return CameraTrack(level @ T, None, known, camera, "ARKit", metric=True, level=True)


def _square_matrix(value: Any, size: int, path: Path) -> Float[np.ndarray, "rows rows"]:
    """Parse a rigid or camera matrix, written by rows or, as Swift does, by columns."""
    try:
        matrix = np.array(value, np.float64).reshape(size, size)
    except (TypeError, ValueError) as error:
        raise FormatError(f"{path}: expected {size * size} numbers, got {value!r:.80}") from error
    bottom = np.eye(size)[-1]
    if not np.isfinite(matrix).all():
        raise FormatError(f"{path}: expected finite numbers, got {value!r:.80}")
    for one in (matrix, matrix.T):
        if np.abs(one[-1] - bottom).max() < 1e-6:
            return one
    raise FormatError(f"{path}: expected the last row {bottom.tolist()}, got {matrix.tolist()}")
