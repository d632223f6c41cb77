"""Tables (wide or long) and arrays of 3D keypoints."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import FRAMES, JOINTS, KEYPOINTS, SAMPLES, TEXT
from recon.formats.keypoints3d.records import Points3D, rate_of
from recon.formats.opening import decode, load_array, load_arrays, read_bytes

_COORDINATE = re.compile(r"^(?P<name>.+?)[\s_.:\-]?(?P<axis>[xyzXYZ])$")
_KEYPOINT = ("keypoint", "landmark", "joint", "bodypart", "marker", "name", "point")
_FRAME = ("frame", "frame_number", "fnum", "frame_id", "index", "")
_TIME = ("timestamp", "time", "t", "seconds", "time_s", "timestamp_s")
_MIN_KEYPOINTS = 2
"""Keypoints with all three coordinates from which on a table is one of keypoints in space."""


def is_table_3d(header: Sequence[Sequence[str]]) -> bool:
    """Whether the first rows of a table name points with x, y and z."""
    first = [cell.strip().lower() for cell in header[0]] if header else []
    if {"x", "y", "z"} <= set(first) and any(cell in _KEYPOINT for cell in first):
        return True
    if first[:1] == ["scorer"]:
        coords = next((row for row in header if row and row[0].strip().lower() == "coords"), [])
        return "z" in {cell.strip().lower() for cell in coords}
    return len(_triples(header[0])) >= _MIN_KEYPOINTS if header else False


def head_of(path: Path, rows: int = 4) -> list[list[str]]:
    """The first rows of a table, without reading the rest.

    Raises:
        FileNotFoundError: when there is no such file.
    """
    with path.open("rb") as file:
        lines = [decode(line) for line, _ in zip(file, range(rows), strict=False)]
    try:
        return list(csv.reader(line.replace("\0", "") for line in lines))
    except csv.Error:
        return []


def read_table(path: Path) -> Points3D:
    """Read a table; which kind it is, its header tells.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or names no points with x, y and z.
    """
    name = path.name
    try:
        rows = list(csv.reader(decode(read_bytes(path, TEXT)).splitlines()))
    except csv.Error as error:
        raise FormatError(f"{name}: expected a table of commas, but {error}") from error
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    if len(rows) < 2 or not is_table_3d(rows[:4]):
        raise FormatError(
            f"{name}: expected columns such as left_hip_x, left_hip_y, left_hip_z, or frame, "
            f"keypoint, x, y, z; got {', '.join(rows[0][:6]) if rows else 'nothing'}"
        )
    first = [cell.strip().lower() for cell in rows[0]]
    if {"x", "y", "z"} <= set(first):
        return _long(rows, first, name)
    if first[0] == "scorer":
        rows = [_joined(rows), *rows[3:]]
    return _wide(rows, name)


def _wide(rows: list[list[str]], name: str) -> Points3D:
    header = [cell.strip() for cell in rows[0]]
    columns = _triples(header)
    JOINTS.check(len(columns), name, "header")
    SAMPLES.check(len(rows) * max(len(header), 1), name)
    positions = np.full((len(rows) - 1, len(columns), 3), np.nan)
    at = np.array(list(columns.values()))
    needed = sorted({int(k) for k in at.flat})
    values = np.full(len(header), np.nan)
    for line, row in enumerate(rows[1:]):
        if len(row) > len(header):
            raise FormatError(f"{name}: row {line} has {len(row)} cells, the header {len(header)}")
        values[:] = np.nan
        for k in needed:
            if k < len(row):
                values[k] = _number(row[k], name, line)
        positions[line] = values[at]
    timing = None
    lowered = [cell.lower() for cell in header]
    if (column := next((k for k, c in enumerate(lowered) if c in _TIME), None)) is not None:
        timing = rate_of([_number(row[column], name, 0) for row in rows[1:]], name)
    return _timed(Points3D(name, positions, tuple(columns)), timing)


def _long(rows: list[list[str]], header: list[str], name: str) -> Points3D:
    column = {cell: k for k, cell in enumerate(header)}
    point = next(column[key] for key in _KEYPOINT if key in column)
    frame = next((column[key] for key in _FRAME if key in column), None)
    if frame is None:
        raise FormatError(f"{name}: expected a column `frame` beside keypoint, x, y, z")
    names = list(dict.fromkeys(row[point].strip() for row in rows[1:] if len(row) > point))
    numbers = [int(_number(row[frame], name, k)) for k, row in enumerate(rows[1:])]
    first, last = min(numbers), max(numbers)
    FRAMES.check(last - first + 1, name, "column frame")
    JOINTS.check(len(names), name, "column keypoint")
    SAMPLES.check((last - first + 1) * len(names), name)
    place = {one: k for k, one in enumerate(names)}
    positions = np.full((last - first + 1, len(names), 3), np.nan)
    at = [column[axis] for axis in "xyz"]
    for line, (number, row) in enumerate(zip(numbers, rows[1:], strict=True)):
        if len(row) <= max(*at, point):
            raise FormatError(f"{name}: row {line} has {len(row)} cells, the header {len(header)}")
        spot = positions[number - first, place[row[point].strip()]]
        if np.isfinite(spot).any():
            raise FormatError(
                f"{name}: frame {number} has {row[point]!r} twice; expected one person and one "
                "model in the table: write the rows of one of them to a file of its own"
            )
        spot[:] = [_number(row[k], name, line) for k in at]
    timing = None
    if (time := next((column[key] for key in _TIME if key in column), None)) is not None:
        times = {n: _number(row[time], name, 0) for n, row in zip(numbers, rows[1:], strict=True)}
        if len(times) == last - first + 1:
            timing = rate_of([times[n] for n in sorted(times)], name)
    return _timed(Points3D(name, positions, tuple(names)), timing)


def _timed(points: Points3D, timing: tuple[float, float, str] | None) -> Points3D:
    if timing is None:
        return points
    fps, start, said = timing
    return Points3D(
        **{**vars(points), "fps": fps, "start_time": start, "decisions": (*points.decisions, said)}
    )


def _triples(header: Sequence[str]) -> dict[str, tuple[int, int, int]]:
    """Columns of x, y and z of every point that has all three, by name."""
    found: dict[str, dict[str, int]] = {}
    for k, cell in enumerate(header):
        if match := _COORDINATE.match(cell.strip()):
            found.setdefault(match["name"], {})[match["axis"].lower()] = k
    whole = {name: axes for name, axes in found.items() if len(axes) == len("xyz")}
    return {name: (axes["x"], axes["y"], axes["z"]) for name, axes in whole.items()}


def _joined(rows: list[list[str]]) -> list[str]:
    """One header of DeepLabCut's header rows: part_x, part_y, part_z."""
    header = {row[0].strip().lower(): row for row in rows[:3]}
    if not {"bodyparts", "coords"} <= header.keys():
        raise FormatError("expected DeepLabCut's header rows scorer, bodyparts, coords")
    parts, coords = header["bodyparts"], header["coords"]
    return ["frame", *(f"{p}_{c}" for p, c in zip(parts[1:], coords[1:], strict=False))]


def _number(cell: str, name: str, line: int) -> float:
    if not cell.strip():
        return float("nan")
    try:
        return float(cell)
    except ValueError as error:
        raise FormatError(f"{name}: expected a number in row {line}, got {cell[:40]!r}") from error


_NAMES = ("names", "joint_names", "keypoint_names", "labels", "markers")
_RATES = ("fps", "frame_rate", "framerate", "rate")
_MIN_POINTS = 10
"""Points from which on an array may be a body's; fewer are three numbers of something else."""


def read_array(path: Path) -> Points3D:
    """Read an .npy file with x, y, z of every point in every frame.

    An axis of persons or batches of length one is left out; a fourth number (a confidence) too.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, needs pickle, or has other axes.
    """
    array = load_array(path)
    found = as_points(array)
    if found is None:
        raise FormatError(
            f"{path}: expected numbers of shape (frames, points, 3), got {array.dtype} "
            f"{array.shape}"
        )
    return Points3D(path.name, found)


def holds_points(arrays: dict[str, np.ndarray]) -> str | None:
    """The key of the one array of shape (frames, points, 3) in an .npz file, or None."""
    keys = [key for key, value in arrays.items() if as_points(value) is not None]
    return keys[0] if len(keys) == 1 else None


def read_arrays(path: Path) -> Points3D:
    """Read an .npz file that holds one such array, with its names and rate where it has them.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or holds none or several such arrays.
    """
    arrays = load_arrays(path)
    key = holds_points(arrays)
    if key is None:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in sorted(arrays.items()))
        raise FormatError(
            f"{path}: expected one array of shape (frames, points, 3), got {shapes or 'nothing'}"
        )
    found = as_points(arrays[key])
    assert found is not None
    names = next((_texts(arrays[name]) for name in _NAMES if name in arrays), None)
    if names is not None and len(names) != found.shape[1]:
        names = None
    rate = next((arrays[name] for name in _RATES if name in arrays), None)
    told = rate is not None and rate.size == 1 and rate.dtype.kind in "fiu"
    fps = float(rate.reshape(())) if told and rate is not None else None
    said = () if fps is None else (f"{fps:g} frames per second: stated by the file",)
    return Points3D(path.name, found, names, fps=fps, decisions=said)


def as_points(array: np.ndarray) -> np.ndarray | None:
    """The array as (frames, points, 3), or None where it is none of that kind."""
    if array.dtype.kind not in "fiu":
        return None
    while array.ndim > 3 and 1 in array.shape[:2]:
        array = array[0] if array.shape[0] == 1 else array[:, 0]
    if array.ndim != 3 or array.shape[-1] not in (3, 4) or not KEYPOINTS.holds(array.shape[1]):
        return None
    square = array.shape[1:] in ((3, 3), (4, 4), (3, 4))
    return None if square or array.shape[1] < _MIN_POINTS else array[..., :3].astype(np.float64)


def _texts(array: np.ndarray) -> tuple[str, ...] | None:
    if array.dtype.kind not in "US" or array.ndim != 1:
        return None
    return tuple(array.astype(str).tolist())
