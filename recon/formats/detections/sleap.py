"""SLEAP's analysis table (.csv): a row per instance, `NODE.x`, `NODE.y`, `NODE.score`."""

import csv
import re
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.layouts import keypoint_names
from recon.core.limits import JSON, SAMPLES
from recon.formats.detections.deeplabcut import normalised, settle_parts
from recon.formats.detections.records import Detections, Row, gather
from recon.formats.files.opening import decode, read_bytes

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
