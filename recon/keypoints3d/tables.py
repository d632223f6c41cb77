"""Reads 3D keypoints from tables (.csv, wide or long) and arrays (.npy, .npz)."""

import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import FRAMES, JOINTS, KEYPOINTS, SAMPLES, TEXT
from recon.core.units import METRES, parse_unit
from recon.formats.opening import load_array, load_arrays
from recon.formats.pickles import read_tree
from recon.formats.scan_times import consecutive_numbers
from recon.formats.text_tables import (
    numbers_of_columns,
    read_rows,
    refuse_repeated_columns,
    with_missing_frames,
)
from recon.keypoints3d.records import Points3D

_COORDINATE = re.compile(
    r"^(?P<name>.+?)[\s_.:\-]*[(\[]?(?P<axis>[xyzXYZ])[)\]]?(?:[\s_(\[]+(?:mm|cm|m)[)\]]?)?$"
)
"""Such as left_hip_x, "left hip (x)" and left_hip_x [mm]."""
_AXIS_FIRST = re.compile(r"^(?P<axis>[xyzXYZ])[\s_.:\-](?P<name>.+)$")
_TIME_OF_DAY = re.compile(r"(\d+):(\d\d?):(\d\d?(?:\.\d+)?)")
_KEYPOINT = ("keypoint", "landmark", "joint", "bodypart", "marker", "name", "point", "bone")
_FRAME = ("frame", "frame_number", "fnum", "frame_id", "index")
_TIME = ("timestamp", "time", "t", "seconds")
_TIME_UNIT = re.compile(r"[\s_(\[]+(?:s|secs?|seconds|[mun]s|msec|milliseconds)[)\]]?$")
"""Unit at the end of a column's name, as in time_ms; the size of the time steps tells it, too."""
_PERSON = re.compile(r"(?i)(?:person|track|body|subject|player|people)[\s_]?(?:id|nr|no)?")
_MIN_KEYPOINTS = 2
"""Keypoints with all three coordinates from which on a table is one of keypoints in space."""
_NAMES = ("names", "joint_names", "keypoint_names", "labels", "markers")
_RATES = ("fps", "frame_rate", "framerate", "rate")
_MIN_POINTS = 10
"""Points from which on an array may be a body's; fewer are three numbers of something else."""


def is_table_3d(header: Sequence[Sequence[str]]) -> bool:
    """Whether the first rows of a table name points with x, y and z."""
    if not header:
        return False
    first = [cell.lower() for cell in header[0]]
    if {"x", "y", "z"} <= set(first) and any(cell in _KEYPOINT for cell in first):
        return True
    if first[:1] == ["scorer"]:
        return any(row[0].lower() == "coords" and {"z", "Z"} & set(row) for row in header if row)
    return len(_xyz_columns(header[0])) >= _MIN_KEYPOINTS


def read_table(path: Path) -> Points3D:
    """Read a wide or long table of 3D keypoints.

    Wide ones have columns such as left_hip_x (DeepLabCut's and Anipose's header rows are joined to
    such), long ones a row for every frame and keypoint.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or names no points with x, y and z.
    """
    name = path.name
    rows = read_rows(path, TEXT)
    if len(rows) == 1 and is_table_3d(rows):
        raise FormatError(f"{name}: expected a row for every frame below the header, got none")
    if len(rows) < 2 or not is_table_3d(rows[:4]):
        raise FormatError(
            f"{name}: expected columns such as left_hip_x, left_hip_y, left_hip_z, or frame, "
            f"keypoint, x, y, z; got {', '.join(rows[0][:6]) if rows else 'nothing'}"
        )
    first = [cell.lower() for cell in rows[0]]
    if {"x", "y", "z"} <= set(first):
        return _read_long(rows[1:], first, name)
    if first[0] != "scorer":
        return _read_wide(rows[1:], rows[0], name)
    labels = {row[0].lower(): row[1:] for row in rows[:3]}
    if not {"bodyparts", "coords"} <= labels.keys():
        raise FormatError(f"{name}: expected DeepLabCut's header rows scorer, bodyparts, coords")
    pairs = zip(labels["bodyparts"], labels["coords"], strict=False)
    return _read_wide(rows[3:], ["", *(f"{part}_{axis}" for part, axis in pairs)], name)


def _read_wide(rows: list[list[str]], header: list[str], name: str) -> Points3D:
    columns = _xyz_columns(header)
    if rows and {parse_unit(cell) for cell in rows[0] if cell} <= METRES.keys():
        rows = rows[1:]  # this row is a second header, with units
    refuse_repeated_columns([cell for cell in header if _COORDINATE.match(cell)], name)
    JOINTS.check(len(columns), name, "header")
    SAMPLES.check((len(rows) + 1) * max(len(header), 1), name)
    _refuse_several_people(rows, header, name)
    needed = [k for axes in columns.values() for k in axes]
    cut = len(rows) > 1 and len(rows[-1]) < min(map(len, rows[:-1]))
    said = (f"the last row has {len(rows[-1])} of {len(header)} cells: left out as cut short",)
    rows = rows[: len(rows) - cut]
    values = numbers_of_columns(rows, needed, name, most=len(header)).reshape(len(rows), -1, 3)
    found, times = (_numbers_of_column(rows, header, words, name) for words in (_FRAME, _TIME))
    frames = np.zeros(0) if found is None or not np.isfinite(found).all() else found
    steps = np.diff(frames)
    if not (steps > 0).all():
        raise FormatError(
            f"{name}: expected frame numbers that increase, got {frames[1:][steps <= 0][0]:g} "
            f"after {frames[:-1][steps <= 0][0]:g}"
        )
    index, stepped = consecutive_numbers(np.floor(frames))
    said = (*said, *stepped) if cut else stepped
    if (steps == steps[:1]).all():
        return Points3D(name, values, tuple(columns), decisions=said).with_rate_of_times(times)
    positions, missing = with_missing_frames(values, index, name)
    return Points3D(name, positions, tuple(columns), decisions=said + missing).with_rate_of_times(
        None if times is None else np.interp(np.arange(len(positions)), index, times)
    )


def _read_long(rows: list[list[str]], header: list[str], name: str) -> Points3D:
    frames = _numbers_of_column(rows, header, (*_FRAME, ""), name)
    if frames is None:
        raise FormatError(f"{name}: expected a column `frame` beside keypoint, x, y, z")
    if not np.isfinite(frames).all():
        raise FormatError(f"{name}: expected the number of a frame in every row")
    point = next(header.index(key) for key in _KEYPOINT if key in header)
    axes = [header.index(axis) for axis in "xyz"]
    least = max(*axes, point) + 1
    values = numbers_of_columns(rows, axes, name, least=least, most=max(map(len, [header, *rows])))
    labels = [row[point] for row in rows]
    place = {one: k for k, one in enumerate(dict.fromkeys(labels))}
    known, at = np.unique(np.floor(frames), return_inverse=True)
    ticks, stepped = consecutive_numbers(known)
    count, index = int(ticks[-1]) + 1, ticks[at.reshape(-1)]
    FRAMES.check(count, name, "column frame")
    JOINTS.check(len(place), name, "column keypoint")
    SAMPLES.check(count * len(place), name)
    positions = np.full((count, len(place), 3), np.nan)
    for k, (frame, label) in enumerate(zip(index.tolist(), labels, strict=True)):
        spot = positions[frame, place[label]]
        if np.isfinite(spot).any():
            raise FormatError(
                f"{name}: frame {frames[k]:.0f} has {label!r} twice; expected the points of "
                "one person by one detector: write the rows of others to other files"
            )
        spot[:] = values[k]
    times = _numbers_of_column(rows, header, _TIME, name)
    first = np.unique(index, return_index=True)[1]
    return Points3D(name, positions, tuple(place), decisions=stepped).with_rate_of_times(
        None if times is None else np.interp(np.arange(count), ticks, times[first])
    )


def _refuse_several_people(rows: list[list[str]], header: list[str], name: str) -> None:
    """Refuse a wide table whose rows are of several people, by a column that names them."""
    for k, cell in enumerate(header):
        people = list(dict.fromkeys(row[k] for row in rows if row[k : k + 1] > [""]))
        if _PERSON.fullmatch(cell) and len(people) > 1:
            raise FormatError(
                f"{name}: expected one person, but the column {cell} has {', '.join(people[:5])}: "
                "write the rows of one of them to a file of its own, or leave the column out if "
                "these are one person"
            )


def _numbers_of_column(
    rows: list[list[str]], header: list[str], words: Sequence[str], name: str
) -> np.ndarray | None:
    """Return the numbers of the column that the first known of `words` names; None if none does.

    The name may end in a unit of time, and its case does not matter. Times of day and dates become
    seconds.
    """
    names = [_TIME_UNIT.sub("", cell.lower()) for cell in header]
    found = next((names.index(word) for word in words if word in names), None)
    if found is None:
        return None
    return numbers_of_columns(
        [[_time_in_seconds(cell) for cell in row[found : found + 1]] for row in rows],
        [0],
        name,
        most=1,
    )[:, 0]


def _time_in_seconds(cell: str) -> str:
    if match := _TIME_OF_DAY.fullmatch(cell):
        hours, minutes, seconds = map(float, match.groups())
        return str(3600 * hours + 60 * minutes + seconds)
    try:
        return str(datetime.fromisoformat(cell).timestamp()) if ":" in cell else cell
    except ValueError:
        return cell


def _xyz_columns(header: Sequence[str]) -> dict[str, tuple[int, int, int]]:
    """Column numbers of x, y and z, keyed by the point's name."""
    found: dict[str, dict[str, int]] = {}
    for k, cell in enumerate(header):
        if match := _COORDINATE.match(cell) or _AXIS_FIRST.match(cell):
            found.setdefault(match["name"], {})[match["axis"].lower()] = k
    whole = {name: axes for name, axes in found.items() if len(axes) == len("xyz")}
    return {name: (axes["x"], axes["y"], axes["z"]) for name, axes in whole.items()}


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
            f"{array.shape}; keypoints in pixels go into an .npz, keypoints=(frames, points, 3) "
            "of x, y and a confidence"
        )
    return Points3D(path.name, found)


def key_of_points(arrays: dict[str, np.ndarray]) -> str | None:
    """The key of the only array of shape (frames, points, 3) of a file, or None."""
    keys = [key for key, value in arrays.items() if as_points(value) is not None]
    return keys[0] if len(keys) == 1 else None


def read_arrays(path: Path) -> Points3D:
    """Read an .npz or .pkl file with one array (frames, points, 3), perhaps names and rate.

    Of AIST++'s points those are taken that its authors optimised.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or holds none or several such arrays.
    """
    arrays = load_arrays(path) if path.suffix.lower() == ".npz" else _arrays_in_tree(path)
    key = key_of_points(arrays)
    found = None if key is None else as_points(arrays[key])
    if found is None:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in sorted(arrays.items()))
        raise FormatError(
            f"{path}: expected one array of shape (frames, points, 3), got {shapes or 'nothing'}"
        )
    names = next((arrays[name] for name in _NAMES if name in arrays), np.zeros(0))
    named = names.dtype.kind in "US" and names.shape == found.shape[1:2]
    labels = tuple(names.astype(str).tolist()) if named else ()
    rate = next((arrays[name] for name in _RATES if name in arrays), np.zeros(0))
    told = rate.size == 1 and rate.dtype.kind in "fiu"
    return Points3D(path.name, found, labels).with_stated_rate(
        float(rate.reshape(())) if told else None
    )


def _arrays_in_tree(path: Path) -> dict[str, np.ndarray]:
    tree = read_tree(path)
    if "keypoints3d_optim" in tree:
        del tree["keypoints3d"]
    return {str(key): one for key, one in tree.items() if isinstance(one, np.ndarray)}


def as_points(array: np.ndarray) -> np.ndarray | None:
    """The array reshaped to (frames, points, 3); None if it is not one of points."""
    if array.dtype.kind not in "fiu":
        return None
    while array.ndim > 3 and 1 in array.shape[:2]:
        array = array[0] if array.shape[0] == 1 else array[:, 0]
    if array.ndim != 3 or array.shape[-1] not in (3, 4) or not KEYPOINTS.holds(array.shape[1]):
        return None
    square = array.shape[1:] in ((3, 3), (4, 4), (3, 4))
    return None if square or array.shape[1] < _MIN_POINTS else array[..., :3].astype(np.float64)
