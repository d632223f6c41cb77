"""DeepLabCut-style CSV: three or four header rows, then x, y, likelihood of every body part."""

import csv
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from recon.core.errors import FormatError
from recon.core.limits import FRAMES, JSON, KEYPOINTS, PEOPLE, SAMPLES
from recon.core.skeleton import LAYOUTS, keypoint_names
from recon.formats.detections.records import Detections, Row, gather
from recon.formats.opening import decode, load_arrays, read_bytes

_HEADERS = ("scorer", "individuals", "bodyparts", "coords")
_NAME = 200
"""Characters at the end of an image's name among which its number is."""
_FEWEST = 4
"""Body parts that must be known by name."""
_WORDS = {
    "l": "left", "r": "right", "lft": "left", "rgt": "right", "sho": "shoulder", "elb": "elbow",
    "wri": "wrist", "kne": "knee", "kn": "knee", "ank": "ankle", "bigtoe": "big_toe",
    "smalltoe": "small_toe", "midhip": "mid_hip", "headtop": "head_top",
}  # fmt: skip


def read_deeplabcut(path: Path, *, layout: str | None = None) -> Detections:
    """Read a table of body parts; parts that the layout does not have are left out and named.

    Without `layout`, it is the one that has most of the parts by name, of equals the shortest.
    The confidence is the likelihood.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or too few body parts are known by name.
    """
    name = path.name
    try:
        table = list(csv.reader(decode(read_bytes(path, JSON)).splitlines()))
    except csv.Error as error:
        raise FormatError(f"{name}: expected a table of commas, but {error}") from error
    header = {row[0].strip().lower(): row[1:] for row in table[: len(_HEADERS)] if row}
    head = [key for key in _HEADERS if key in header]
    if not {"bodyparts", "coords"} <= header.keys():
        raise FormatError(f"{name}: expected DeepLabCut's header rows scorer, bodyparts, coords")
    PEOPLE.check(len(set(header.get("individuals", []))), name, "individuals")
    KEYPOINTS.check(len(set(header["bodyparts"])), name, "bodyparts")
    SAMPLES.check(max(len(table) * len(header["coords"]), 1), name)
    values, numbers = _values(table[len(head) :], len(header["coords"]), name)
    parts = [part.strip() for part in header["bodyparts"]]
    individuals = [one.strip() for one in header.get("individuals", ["one"] * len(parts))]
    columns = {
        key: column
        for column, key in enumerate(
            zip(individuals, parts, (c.strip().lower() for c in header["coords"]), strict=False)
        )
    }
    chosen, unknown = settle_parts(list(dict.fromkeys(parts)), layout, name)
    places = {normalised(part): part for part in parts}
    rows: list[Row] = []
    people = list(dict.fromkeys(individuals))
    for number, value in zip(numbers, values, strict=True):
        for identity, one in enumerate(people):
            points = np.zeros((len(keypoint_names(chosen)), 3))
            for k, keypoint in enumerate(keypoint_names(chosen)):
                for axis, coord in enumerate(("x", "y", "likelihood")):
                    column = columns.get((one, places.get(keypoint, ""), coord))
                    points[k, axis] = np.nan if column is None else value[column]
            if np.isfinite(points).all(-1).any():
                rows.append((number, points, identity))
    named = (f"body parts not in {chosen}: {', '.join(unknown)}",) if unknown else ()
    return gather(name, numbers, rows, layout=chosen, decisions=named)


def normalised(part: str) -> str:
    """A body part's name as in `recon.core.skeleton`: LHip, hip_left, "left hip" -> left_hip."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=^[LR])(?=[A-Z])", "_", part.strip())
    joined = re.sub(r"[^a-z0-9]+", "_", spaced.lower()).strip("_")
    joined = re.sub(r"^(left|right)(?=[a-z])", r"\1_", joined)
    words = [_WORDS.get(word, word) for word in joined.split("_")]
    side = [word for word in words if word in ("left", "right")]
    return "_".join(side + [word for word in words if word not in side])


def settle_parts(parts: list[str], layout: str | None, name: str) -> tuple[str, list[str]]:
    """The layout and the parts it does not have."""
    words = {normalised(part): part for part in parts}
    candidates = LAYOUTS if layout is None else {layout: keypoint_names(layout)}
    found = {key: len(words.keys() & set(LAYOUTS[key])) for key in candidates}
    best = max(candidates, key=lambda key: (found[key], -len(LAYOUTS[key])))
    known = words.keys() & set(LAYOUTS[best])
    if len(known) < _FEWEST:
        raise FormatError(
            f"{name}: only {len(known)} of its body parts are known by name; found "
            f"{', '.join(parts)}, expected names such as {', '.join(LAYOUTS[best][:8])}"
        )
    return best, [part for word, part in words.items() if word not in known]


def _values(rows: list[list[str]], width: int, name: str) -> tuple[np.ndarray, list[int]]:
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    values = np.full((len(rows), width), np.nan)
    numbers: list[int] = []
    for line, row in enumerate(rows):
        if len(row) > width + 1:
            raise FormatError(f"{name}: row {line} has {len(row)} cells, the header {width + 1}")
        try:
            cells = [float(cell) if cell.strip() else np.nan for cell in row[1:]]
        except ValueError as error:
            raise FormatError(f"{name}: expected numbers in row {line}, got {row[:4]}") from error
        values[line, : len(cells)] = cells
        last = re.search(r"(\d+)\D*$", Path(row[0]).stem[-_NAME:])
        numbers.append(int(last[1]) if last else line)
    if len(set(numbers)) < len(numbers) or numbers != sorted(numbers):
        raise FormatError(f"{name}: expected increasing frame numbers in the first column")
    return values, numbers


_FRAME = "frame_idx"
_COORDINATES = ("x", "y", "score")
_HEAD = 1 << 16


def is_sleap(path: Path) -> bool:
    """Whether a table begins as SLEAP's do."""
    with path.open("rb") as file:
        first = decode(file.read(_HEAD)).split("\n", 1)[0]
    names = [name.strip() for name in first.split(",")]
    return _FRAME in names and any(name.endswith(".x") for name in names)


def read_sleap(path: Path, *, layout: str | None = None) -> Detections:
    """Read the table; nodes that the layout does not have are left out and named.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or too few nodes are known by name.
    """
    name = path.name
    try:
        table = list(csv.reader(decode(read_bytes(path, JSON)).splitlines()))
    except csv.Error as error:
        raise FormatError(f"{name}: expected a table of commas, but {error}") from error
    head = [cell.strip() for cell in table[0]]
    columns = {column: k for k, column in enumerate(head)}
    nodes = [column[:-2] for column in head if column.endswith(".x")]
    SAMPLES.check(max(len(table) * len(nodes), 1), name)
    chosen, unknown = settle_parts(nodes, layout, name)
    places = {keypoint: k for k, keypoint in enumerate(keypoint_names(chosen))}
    known = {node: places[normalised(node)] for node in nodes if normalised(node) in places}
    rows: list[Row] = []
    for line, cells in enumerate(table[1:], 2):
        if not cells:
            continue
        if len(cells) != len(head):
            raise FormatError(f"{name}, line {line}: expected {len(head)} cells, got {len(cells)}")
        place_said = f"{name}, line {line}"
        person = np.zeros((len(keypoint_names(chosen)), 3))
        for node, place in known.items():
            person[place] = [
                _number(cells[columns[f"{node}.{one}"]], place_said)
                if f"{node}.{one}" in columns
                else 1.0
                for one in _COORDINATES
            ]
        track = re.search(r"(\d{1,9})$", cells[columns["track"]]) if "track" in columns else None
        number = _number(cells[columns[_FRAME]], place_said)
        if not number.is_integer() or number < 0:
            raise FormatError(f"{place_said}: expected the number of a frame, got {number}")
        number = int(number)
        rows.append((number, person, -1 if track is None else int(track.group(1))))
    numbers = sorted({row[0] for row in rows})
    said = (f"nodes left out: {', '.join(unknown)}",) if unknown else ()
    return gather(name, numbers, rows, layout=chosen, decisions=said)


def _number(cell: str, place: str) -> float:
    """A number; NaN of an empty cell, which a node has that was not found."""
    try:
        return float(cell) if cell.strip() else float("nan")
    except ValueError as error:
        raise FormatError(f"{place}: expected a number, got {cell[:20]!r}") from error


_KEYPOINTS = ("keypoints", "kpts", "keypoints_2d", "keypoints2d", "pred_keypoints")
_SCORES = ("scores", "keypoint_scores", "confidence", "conf")
_PIXELS = 10.0
"""Median coordinate from which on numbers are pixels: people are not so far away in metres."""


def holds_detections(path: Path) -> bool:
    """Whether a .npz holds 2D keypoints: two columns, or a third one that is a confidence."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    return _found(load_arrays(path)) is not None


def read_detection_arrays(path: Path, *, layout: str | None = None) -> Detections:
    """Read (frames, points, 2 or 3) or (frames, people, points, 2 or 3) with scores beside.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds no 2D keypoints or nobody.
    """
    arrays = load_arrays(path)
    values = _found(arrays)
    if values is None:
        raise FormatError(
            f"{path}: expected 2D keypoints as `keypoints` (frames, people, points, 2) with "
            f"`scores`, or (..., 3) with a confidence; got {', '.join(sorted(arrays))}"
        )
    FRAMES.check(len(values), path.name)
    PEOPLE.check(values.shape[1], path.name, "people")
    rows: list[Row] = [
        (frame, person, -1)
        for frame, people in enumerate(values)
        for person in people
        if np.isfinite(person).all(-1).any() and (person[:, 2] > 0).any()
    ]
    return gather(path.name, list(range(len(values))), rows, layout=layout)


def _found(
    arrays: dict[str, Shaped[np.ndarray, "..."]],
) -> Float[np.ndarray, "frames people points 3"] | None:
    """Pixels and confidence; None where the arrays are something else."""
    if "kind" in arrays:
        return None
    values = next((arrays[key] for key in _KEYPOINTS if key in arrays), None)
    if values is None or values.ndim not in (3, 4) or values.dtype.kind not in "fiu":
        return None
    values = np.asarray(values, dtype=np.float64)
    values = values[:, None] if values.ndim == 3 else values
    if values.size == 0 or values.shape[-1] not in (2, 3):
        return None
    scores = next((arrays[key] for key in _SCORES if key in arrays), None)
    if scores is not None and scores.dtype.kind in "fiu":
        scores = np.asarray(scores, dtype=np.float64).reshape(values.shape[0], -1)
        if scores.shape[1] == values.shape[1] * values.shape[2]:
            shaped = scores.reshape(values.shape[:3])
            return np.concatenate((values[..., :2], shaped[..., None]), -1)
    if values.shape[-1] == 2:
        seen = np.isfinite(values).all(-1, keepdims=True) & (values != 0).any(-1, keepdims=True)
        return np.concatenate((np.where(seen, values, 0.0), seen.astype(float)), -1)
    third, places = values[..., 2], np.abs(values[..., :2])
    finite = np.isfinite(values).all(-1)
    if not finite.any() or third[finite].min() < 0 or third[finite].max() > 1:
        return None
    return values if float(np.median(places[finite])) > _PIXELS else None
