"""Texts of camera trackers: COLMAP's models and trajectories of the TUM benchmark."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError
from recon.formats.calibration.camera import CameraFields

_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
"""COLMAP's camera models whose lens OpenCV's coefficients can tell, and their parameters."""
_LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def read_colmap(
    path: Path,
) -> tuple[Int[np.ndarray, " poses"] | None, Float[np.ndarray, "poses 4 4"], CameraFields | None]:
    """Frame numbers, T_world_camera and intrinsics of a model's `images.txt` and `cameras.txt`.

    Images come in the order of their names; the last number of a name is that of its frame.

    Raises:
        ValueError: when there are no images or lines are damaged, or they are of several cameras.
    """
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("#")]
    images: dict[str, tuple[list[float], str]] = {}
    for line in lines[::2]:  # every other line lists the points that an image shows
        fields = line.split()
        if not fields:
            continue
        if len(fields) < 10:
            raise FormatError(
                f"{path}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got {line[:80]!r}"
            )
        images[" ".join(fields[9:])] = (_numbers(fields[1:8], line, path), fields[8])
    if len(images) < 2:
        raise FormatError(f"{path}: expected images with poses, found {len(images)}")
    names = sorted(images, key=lambda name: (_number(name) or 0, name))
    if len({camera for _, camera in images.values()}) > 1:
        raise FormatError(
            f"{path}: its images are of several cameras; expected those of one film, which COLMAP "
            "takes as one with --ImageReader.single_camera 1"
        )
    rows = np.array([images[name][0] for name in names])
    T = np.linalg.inv(rigid(rows[:, [1, 2, 3, 0]], rows[:, 4:], path))
    numbers = [_number(name) for name in names]
    counted = None not in numbers and len(set(numbers)) == len(numbers)
    cameras = path.with_name("cameras.txt")
    camera = _camera(cameras, images[names[0]][1]) if cameras.is_file() else None
    return (np.array(numbers, np.int64) if counted else None), T, camera


def read_tum(path: Path) -> tuple[Float[np.ndarray, " poses"], Float[np.ndarray, "poses 4 4"]]:
    """Times in seconds and T_world_camera of a trajectory.

    Raises:
        ValueError: when a line has not eight numbers, or times do not rise.
    """
    rows = []
    for line in path.read_text("utf-8").splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        fields = line.replace(",", " ").split()
        if len(fields) != 8:
            raise FormatError(
                f"{path}: expected timestamp tx ty tz qx qy qz qw, got {line[:80]!r}"
            )
        rows.append(_numbers(fields, line, path))
    table = np.array(rows).reshape(-1, 8)
    if len(table) < 2 or not (np.diff(table[:, 0]) > 0).all():
        raise FormatError(f"{path}: expected rising timestamps, got {len(table)} poses")
    return table[:, 0], rigid(table[:, 4:], table[:, 1:4], path)


def _camera(path: Path, identity: str) -> CameraFields:
    for line in path.read_text("utf-8").splitlines():
        fields = line.split()
        if line.startswith("#") or not fields or fields[0] != identity:
            continue
        model, size = fields[1], _numbers(fields[2:4], line, path)
        if model not in _MODELS or len(fields) != 4 + len(_MODELS[model]):
            raise FormatError(
                f"{path}: expected a camera of the models {', '.join(_MODELS)}, got {line[:80]!r}"
            )
        own = dict(zip(_MODELS[model], _numbers(fields[4:], line, path), strict=True))
        fx, fy = own.get("fx", own.get("f", 0.0)), own.get("fy", own.get("f", 0.0))
        lens = [own.get(name, 0.0) for name in _LENS]
        # COLMAP counts from the corner of the first pixel, OpenCV from its middle
        matrix = [[fx, 0, own["cx"] - 0.5], [0, fy, own["cy"] - 0.5], [0, 0, 1]]
        return CameraFields("track", matrix, size, lens if any(lens) else None)
    raise FormatError(f"{path}: expected camera {identity}, which images.txt names")


def _number(name: str) -> int | None:
    found = re.findall(r"\d+", Path(name).stem)
    return int(found[-1]) if found else None


def _numbers(fields: list[str], line: str, path: Path) -> list[float]:
    try:
        return [float(one) for one in fields]
    except ValueError as error:
        raise FormatError(f"{path}: expected numbers, got {line[:80]!r}") from error


def rigid(
    quaternion: Float[np.ndarray, "poses 4"], places: Float[np.ndarray, "poses 3"], path: Path
) -> Float[np.ndarray, "poses 4 4"]:
    """Transforms of quaternions x y z w and translations.

    Raises:
        ValueError: when numbers are not finite, or quaternions are not of length one.
    """
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(quaternion, axis=-1)
    if not np.isfinite(places).all() or not (np.abs(length - 1) < 0.01).all():
        raise FormatError(
            f"{path}: expected finite numbers and quaternions of length 1, got lengths from "
            f"{np.nanmin(length):.3g} to {np.nanmax(length):.3g}; are its columns in order?"
        )
    T = np.tile(np.eye(4), (len(places), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_quat(quaternion).as_matrix(), places
    return T
