"""DeepLabCut-style CSV: three or four header rows, then x, y, likelihood of every body part."""

import csv
import re
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.layouts import LAYOUTS, keypoint_names
from recon.core.limits import JSON, KEYPOINTS, PEOPLE, SAMPLES
from recon.formats.detections.records import Detections, Row, gather
from recon.formats.files.opening import decode, read_bytes

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
    """A body part's name as in `recon.core.layouts`: LHip, hip_left, "left hip" -> left_hip."""
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
