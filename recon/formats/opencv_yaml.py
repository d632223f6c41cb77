"""Reads calibrations in OpenCV's YAML, of one camera, or EasyMocap's `intri.yml`, `extri.yml`."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import CALIBRATION
from recon.formats.cameras import CameraFields
from recon.formats.texts import decoded_text, read_bytes

_MATRIX = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M")
_DISTORTION = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "dist", "D",
)  # fmt: skip
_WIDTH, _HEIGHT = (
    ("image_width", "image_Width", "width"),
    ("image_height", "image_Height", "height"),
)
_FISHEYE_MODELS = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4")
_ROTATION, _TRANSLATION = ("rvec", "R"), ("tvec", "T")

_KEY = re.compile(r"^[^\s:%-][^\s:]*:", re.MULTILINE)
"""Matches the key with which an entry begins; the entry ends before the next key."""
_MOST_ENTRIES = 10_000
"""Most entries that a file may have; a camera has about five."""
_MATRIX_TEXT = re.compile(
    r"([^\s:]+):\s*(?:!!opencv-matrix)?\s*rows:\s*(\d{1,3})\s+cols:\s*(\d{1,3})\s+"
    r"(?:dt:\s*\S+\s+)?data:\s*\[([^\]]*)\]"
)
"""Matches a matrix as OpenCV writes it, with a tag and a type, or as ROS does, without."""
_MATRIX_NAME = re.compile(r"([^\s:]+):\s*!!")
_LIST_TEXT = re.compile(r"([^\s:]+):[ \t]*((?:\r?\n[ \t]*-[ \t][^\n]*)+)")
_SCALAR_TEXT = re.compile(r"([^\s:]+):[ \t]+(\S[^\n]*)")


def read_opencv_yaml(path: Path) -> dict[str, CameraFields]:
    """Read the cameras of a YAML file, keyed by name; `intri.yml` also needs `extri.yml`.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or holds no camera matrix.
    """
    if path.name.lower() == "extri.yml" and path.with_name("intri.yml").is_file():
        path = path.with_name("intri.yml")
    values = _read_values(path)
    names = values.get("names")
    if not isinstance(names, list):
        matrices = [key for key in values if key.startswith("K_")]
        names = [key.removeprefix("K_") for key in matrices]
    if len(names) == 0:
        return {path.stem: _single_camera(path, values)}
    beside = path.with_name("extri.yml")
    poses = (
        _read_values(beside) if path.name.lower() == "intri.yml" and beside.is_file() else values
    )
    if len(set(names)) < len(names):
        raise FormatError(f"{path}: expected every camera's name once, got {', '.join(names)}")
    if without := [name for name in names if f"K_{name}" not in values]:
        raise FormatError(
            f"{path}: expected K_{without[0]}, the matrix of camera {without[0]}, which is missing"
        )
    return {
        name: CameraFields(
            name=name,
            matrix=values[f"K_{name}"],
            size=_size_in_pixels(values.get(f"W_{name}"), values.get(f"H_{name}")),
            distortion=values.get(f"dist_{name}", values.get(f"D_{name}")),
            rotation=_first_present(poses, (f"Rot_{name}", f"R_{name}")),
            translation=poses.get(f"T_{name}"),
        )
        for name in names
    }


def _single_camera(path: Path, values: dict[str, Any]) -> CameraFields:
    matrix = _first_present(values, _MATRIX)
    if matrix is None:
        raise FormatError(
            f"{path}: expected camera_matrix, or names and K_<name> as in EasyMocap's intri.yml; "
            f"found {', '.join(values) or 'nothing'}"
        )
    fisheye = any(values.get(key) in (1.0, "true", "True") for key in ("fisheye_model", "fisheye"))
    if fisheye or str(values.get("distortion_model")).lower() in _FISHEYE_MODELS:
        raise FormatError(f"{path}: fisheye lenses are not read; undistort the keypoints first")
    return CameraFields(
        name=path.stem, matrix=matrix,
        size=_size_in_pixels(_first_present(values, _WIDTH), _first_present(values, _HEIGHT)),
        distortion=_first_present(values, _DISTORTION), rotation=_first_present(values, _ROTATION),
        translation=_first_present(values, _TRANSLATION),
    )  # fmt: skip


def _first_present(values: dict[str, Any], keys: tuple[str, ...]) -> Any:
    return next((values[key] for key in keys if key in values), None)


def _size_in_pixels(width: Any, height: Any) -> tuple[float, float] | None:
    if not isinstance(width, float) or not isinstance(height, float):
        return None
    return (width, height) if min(width, height) > 0 else None


def _read_values(path: Path) -> dict[str, Any]:
    """Read all top-level values of a file: matrices, numbers, texts and lists of texts.

    OpenCV's own reader is not used: damaged files make it end the whole process.
    """
    text = decoded_text(read_bytes(path, CALIBRATION))
    starts = [found.start() for found in _KEY.finditer(text)]
    if len(starts) > _MOST_ENTRIES:
        raise FormatError(
            f"{path}: expected at most {_MOST_ENTRIES} entries of cameras, got {len(starts)}"
        )
    values: dict[str, Any] = {}
    for start, stop in zip(starts, [*starts[1:], len(text)], strict=False):
        name, value = _parsed_entry(path, text[start:stop])
        if name in values:
            raise FormatError(f"{path}: expected every entry once, got {name} twice")
        if value is not None:
            values[name] = value
    return values


def _parsed_entry(path: Path, text: str) -> tuple[str, Any]:
    """Parse one entry to its name and value; the value is None if there is none."""
    if found := _MATRIX_TEXT.match(text):
        name, rows, columns, data = found.groups()
        numbers = [_number_or_text(cell) for cell in data.replace("\n", " ").split(",")]
        if len(numbers) != int(rows) * int(columns) or any(isinstance(n, str) for n in numbers):
            raise FormatError(
                f"{path}: expected {rows} x {columns} numbers in {name}, but it is damaged"
            )
        return name, np.array(numbers, dtype=np.float64).reshape(int(rows), int(columns))
    if found := _MATRIX_NAME.match(text):
        raise FormatError(f"{path}: the matrix {found[1]} is damaged")
    if found := _LIST_TEXT.match(text):
        return found[1], [_unquoted(item) for item in re.split(r"\n\s*-\s*", found[2])[1:]]
    if found := _SCALAR_TEXT.match(text):
        value = found[2].rstrip()
        if value.startswith("["):
            items = value.strip("[] ").split(",")
            return found[1], [_unquoted(item) for item in items if item.strip()]
        return found[1], _number_or_text(value)
    return "", None


def _unquoted(text: str) -> str:
    return text.strip().strip("\"'")


def _number_or_text(text: str) -> float | str:
    try:
        return float(text.strip())
    except ValueError:
        return _unquoted(text)
