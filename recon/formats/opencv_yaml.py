"""OpenCV's YAML: EasyMocap's `intri.yml` and `extri.yml`, or the calibration of one camera."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import IMAGE_SIZE, TABLE, check_camera, check_pose
from recon.formats.observations import CameraArrays
from recon.formats.opening import decode, read_bytes

_COEFFICIENTS = (4, 5, 8)
"""OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]."""


@dataclass(frozen=True)
class CameraFields:
    """What a file says about a camera, unchecked."""

    name: str
    matrix: Any
    size: Any = None
    """Width and height."""
    distortion: Any = None
    rotation: Any = None
    """World to camera: Rodrigues vector or matrix."""
    translation: Any = None
    pose: Any = None
    """Instead of the two: 3x4 or 4x4, one or one per frame."""


def settle_camera(
    parts: CameraFields, image_size: tuple[int, int] | None, path: Path
) -> CameraArrays:
    """A camera of finite numbers and right shapes, in the file's unit and world.

    Raises:
        ValueError: for what is not numbers, has a wrong shape, a focal length that is not
            positive, a rotation that is none, or an image size that is neither stated nor given.
    """
    where = f"{path}, camera {parts.name}"
    matrix = _numbers(parts.matrix, "camera matrix", where)
    if matrix.shape != (3, 3):
        raise FormatError(
            f"{where}: expected a camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got "
            f"an array of shape {matrix.shape}"
        )
    size = _size(parts.size, image_size, where)
    distortion = _distortion(parts.distortion, where)
    check_camera(matrix, size, distortion, where)
    return CameraArrays(
        camera_matrix=matrix,
        image_size=size,
        distortion=distortion,
        T_camera_world=_pose(parts, where),
    )


def _numbers(value: Any, what: str, where: str) -> np.ndarray:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        shown = repr(value)[:80]
        raise FormatError(f"{where}: expected numbers in the {what}, got {shown}") from error
    if not np.isfinite(numbers).all():
        raise FormatError(f"{where}: the {what} holds NaN or infinity")
    return numbers


def _size(stated: Any, given: tuple[int, int] | None, where: str) -> tuple[int, int]:
    if stated is None and given is None:
        raise FormatError(
            f"{where}: the calibration does not state the image size; give it with --image-size "
            "WIDTH HEIGHT"
        )
    size = _numbers(given if stated is None else stated, "image size", where)
    if size.shape != (2,):
        raise FormatError(f"{where}: expected a width and a height in pixels, got {size.tolist()}")
    IMAGE_SIZE.check(size, where, "image size")
    return int(size[0]), int(size[1])


def _distortion(value: Any, where: str) -> np.ndarray | None:
    if value is None:
        return None
    numbers = _numbers(value, "distortion", where).ravel()
    longest = _COEFFICIENTS[-1]
    if len(numbers) > longest and not numbers[longest:].any():
        numbers = numbers[:longest]
    if len(numbers) < _COEFFICIENTS[0]:
        numbers = np.pad(numbers, (0, _COEFFICIENTS[0] - len(numbers)))
    if len(numbers) not in _COEFFICIENTS:
        raise FormatError(
            f"{where}: expected up to 4, or 5 or 8 distortion coefficients (k1 k2 p1 p2 [k3 [k4 "
            f"k5 k6]]), got {len(numbers)}; calibrate without thin prism or tilt"
        )
    return numbers if numbers.any() else None


def _pose(parts: CameraFields, where: str) -> np.ndarray | None:
    if parts.pose is not None:
        pose = _numbers(parts.pose, "pose", where)
        pose = pose[None] if pose.ndim == 2 else pose
        if pose.ndim != 3 or pose.shape[1:] not in ((3, 4), (4, 4)) or len(pose) == 0:
            raise FormatError(f"{where}: expected poses of shape (4, 4), got {pose.shape}")
        rotation, translation = pose[:, :3, :3], pose[:, :3, 3]
    elif parts.rotation is None and parts.translation is None:
        return None
    elif parts.rotation is None or parts.translation is None:
        raise FormatError(f"{where}: expected both rotation and translation, got only one")
    else:
        turn = _numbers(parts.rotation, "rotation", where)
        if turn.size == 3:
            import cv2

            turn = np.asarray(cv2.Rodrigues(turn.reshape(3, 1))[0])
        translation = _numbers(parts.translation, "translation", where).reshape(1, -1)
        if turn.shape != (3, 3) or translation.shape != (1, 3):
            raise FormatError(
                f"{where}: expected a rotation of 3 or 3x3 numbers and a translation of 3, got "
                f"{turn.shape} and {translation.shape}"
            )
        rotation = turn[None]
    out = np.tile(np.eye(4), (len(rotation), 1, 1))
    out[:, :3, :3] = rotation
    # a translation may still be in millimetres: its range is checked when its unit is known
    check_pose(out, where, "rotation from world to camera")
    out[:, :3, 3] = translation
    return out


_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M")
_DISTORTION = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "dist", "D",
)  # fmt: skip
_WIDTH, _HEIGHT = (
    ("image_width", "image_Width", "width"),
    ("image_height", "image_Height", "height"),
)
_ROTATION, _TRANSLATION = ("rvec", "R"), ("tvec", "T")

_MATRIX_TEXT = re.compile(
    r"^([^\s:]+):\s*!!opencv-matrix\s+rows:\s*(\d{1,3})\s+cols:\s*(\d{1,3})\s+dt:\s*\S+\s+"
    r"data:\s*\[([^\]]*)\]",
    re.MULTILINE,
)
_MATRIX_NAME = re.compile(r"^([^\s:]+):\s*!!", re.MULTILINE)
_LIST_TEXT = re.compile(r"^([^\s:]+):[ \t]*((?:\r?\n[ \t]*-[ \t][^\n]*)+)", re.MULTILINE)
_SCALAR_TEXT = re.compile(r"^([^\s:%]+):[ \t]+(\S[^\n]*)$", re.MULTILINE)


def read_opencv_yaml(path: Path) -> dict[str, CameraFields]:
    """The cameras of a YAML file by name; `extri.yml` is looked for beside `intri.yml`.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or holds no camera matrix.
    """
    if path.name.lower() == "extri.yml" and path.with_name("intri.yml").is_file():
        path = path.with_name("intri.yml")
    values = _read(path)
    names = values.get("names")
    if not isinstance(names, list):
        matrices = [key for key in values if key.startswith("K_")]
        names = [key.removeprefix("K_") for key in matrices]
    if len(names) == 0:
        return {path.stem: _single(path, values)}
    beside = path.with_name("extri.yml")
    poses = _read(beside) if path.name.lower() == "intri.yml" and beside.is_file() else values
    if without := [name for name in names if f"K_{name}" not in values]:
        raise FormatError(f"{path}: expected K_{without[0]}, the matrix of camera {without[0]}")
    return {
        name: CameraFields(
            name=name,
            matrix=values[f"K_{name}"],
            size=_pair(values.get(f"W_{name}"), values.get(f"H_{name}")),
            distortion=values.get(f"dist_{name}", values.get(f"D_{name}")),
            rotation=_first(poses, (f"Rot_{name}", f"R_{name}")),
            translation=poses.get(f"T_{name}"),
        )
        for name in names
    }


def _single(path: Path, values: dict[str, Any]) -> CameraFields:
    matrix = _first(values, _MATRIX)
    if matrix is None:
        raise FormatError(
            f"{path}: expected camera_matrix, or names and K_<name> as in EasyMocap's intri.yml; "
            f"found {', '.join(values) or 'nothing'}"
        )
    if any(values.get(key) in (1.0, "true", "True") for key in ("fisheye_model", "fisheye")):
        raise FormatError(f"{path}: fisheye lenses are not read; undistort the keypoints first")
    return CameraFields(
        name=path.stem, matrix=matrix, size=_pair(_first(values, _WIDTH), _first(values, _HEIGHT)),
        distortion=_first(values, _DISTORTION), rotation=_first(values, _ROTATION),
        translation=_first(values, _TRANSLATION),
    )  # fmt: skip


def _first(values: dict[str, Any], keys: tuple[str, ...]) -> Any:
    return next((values[key] for key in keys if key in values), None)


def _pair(width: Any, height: Any) -> tuple[float, float] | None:
    if not isinstance(width, float) or not isinstance(height, float):
        return None
    return (width, height) if min(width, height) > 0 else None


def _read(path: Path) -> dict[str, Any]:
    """All top-level values: matrices, numbers, texts and lists of texts.

    OpenCV's own reader is not used: damaged files make it end the whole process.
    """
    text = decode(read_bytes(path, TABLE))
    values: dict[str, Any] = {}
    for name, rows, columns, data in _MATRIX_TEXT.findall(text):
        numbers = [_scalar(cell) for cell in data.replace("\n", " ").split(",")]
        if len(numbers) != int(rows) * int(columns) or any(isinstance(n, str) for n in numbers):
            raise FormatError(
                f"{path}: expected {rows} x {columns} numbers in {name}, but it is damaged"
            )
        values[name] = np.array(numbers, dtype=np.float64).reshape(int(rows), int(columns))
    if damaged := set(_MATRIX_NAME.findall(text)) - values.keys():
        raise FormatError(f"{path}: the matrix {', '.join(sorted(damaged))} is damaged")
    for name, items in _LIST_TEXT.findall(text):
        values[name] = [_unquoted(item) for item in re.split(r"\n\s*-\s*", items)[1:]]
    for name, stated in _SCALAR_TEXT.findall(text):
        value = stated.rstrip()
        if value.startswith("["):
            items = value.strip("[] ").split(",")
            values.setdefault(name, [_unquoted(item) for item in items if item.strip()])
        elif not value.startswith("!!"):
            values.setdefault(name, _scalar(value))
    return values


def _unquoted(text: str) -> str:
    return text.strip().strip("\"'")


def _scalar(text: str) -> float | str:
    try:
        return float(text.strip())
    except ValueError:
        return _unquoted(text)
