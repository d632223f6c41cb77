"""OpenCV's YAML: EasyMocap's `intri.yml` and `extri.yml`, or the calibration of one camera."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import TABLE
from recon.formats.cameras import CameraFields
from recon.formats.opening import decode, read_bytes

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
