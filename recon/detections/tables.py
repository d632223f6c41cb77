"""Reads 2D keypoints from CSV tables of DeepLabCut and SLEAP, and from .npz files."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from recon.core.errors import FormatError
from recon.core.layouts import LAYOUTS, keypoint_names
from recon.core.limits import (
    FILM_FOCAL_LENGTH,
    FRAME_RATE,
    FRAMES,
    JSON,
    KEYPOINTS,
    PEOPLE,
    PIXEL,
    SAMPLES,
    Limit,
)
from recon.detections.records import (
    Background,
    Detections,
    Row,
    detections_of_rows,
    with_clipped_confidences,
)
from recon.formats.opening import load_arrays
from recon.formats.text_tables import (
    first_rows,
    numbers_of_columns,
    read_rows,
    refuse_repeated_columns,
)

_HEADERS = ("scorer", "individuals", "bodyparts", "coords")
_NAME = 200
"""Characters at the end of an image's name among which its number is."""
_FEWEST_KNOWN_PARTS = 4
"""Body parts that must be known by name."""
_WORDS = {
    "l": "left", "r": "right", "lft": "left", "rgt": "right", "sho": "shoulder", "elb": "elbow",
    "wri": "wrist", "kne": "knee", "kn": "knee", "ank": "ankle", "bigtoe": "big_toe",
    "smalltoe": "small_toe", "midhip": "mid_hip", "headtop": "head_top",
}  # fmt: skip


def read_deeplabcut(path: Path, layout: str | None = None) -> Detections:
    """Read DeepLabCut's CSV: header rows, then x, y, likelihood of every body part.

    Parts that the layout does not have are left out and named. Without `layout`, it is the one
    that has most of the parts by name, of equals the shortest. The confidence is the likelihood,
    or 1 where a table has none.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or too few body parts are known by name.
    """
    name = path.name
    header = {row[0].lower(): row[1:] for row in first_rows(path, len(_HEADERS)) if row}
    header = {key: header[key] for key in _HEADERS if key in header}
    if not {"bodyparts", "coords"} <= header.keys():
        raise FormatError(
            f"{name}: expected columns such as left_hip_x, left_hip_y, left_hip_z, or "
            "DeepLabCut's header rows scorer, bodyparts, coords"
        )
    # tables of labelled images begin with columns of the image's path, which have no header
    blank = next((k for k, part in enumerate(header["bodyparts"]) if part), 0)
    header = {key: cells[blank:] for key, cells in header.items()}
    parts, width = header["bodyparts"], len(header["coords"])
    individuals = header.get("individuals", ["one"] * len(parts))
    people = list(dict.fromkeys(individuals))
    PEOPLE.check(len(people), name, "individuals")
    KEYPOINTS.check(len(set(parts)), name, "bodyparts")
    rows = [row[blank:] for row in read_rows(path, JSON)[len(header) :]]
    SAMPLES.check(max(len(rows) * width, 1), name)
    values = numbers_of_columns(rows, range(1, width + 1), name, most=width + 1)
    found = [re.search(r"(\d+)\D*$", Path(row[0]).stem[-_NAME:]) for row in rows]
    frames = [int(number[1]) if number else line for line, number in enumerate(found)]
    if sorted(set(frames)) != frames:
        raise FormatError(f"{name}: expected increasing frame numbers in the first column")
    chosen, unknown = layout_of_parts(list(dict.fromkeys(parts)), layout, name)
    places = {plain_part_name(part): part for part in parts}
    kinds = [coordinate.lower() for coordinate in header["coords"]]
    triples = list(zip(individuals, parts, kinds, strict=False))
    refuse_repeated_columns([" ".join(triple) for triple in triples], name)
    columns = {triple: column for column, triple in enumerate(triples)}
    index = [
        [
            [columns.get((one, places.get(keypoint, ""), c), -1) for c in ("x", "y", "likelihood")]
            for keypoint in keypoint_names(chosen)
        ]
        for one in people
    ]
    points = np.pad(values, ((0, 0), (0, 1)), constant_values=np.nan)[:, index]
    if "likelihood" not in kinds:
        points[..., 2] = 1.0
    seen = np.argwhere(np.isfinite(points).all(-1).any(-1)).tolist()
    found_rows: list[Row] = [(frames[t], points[t, person], person) for t, person in seen]
    named = (f"body parts not in {chosen}: {', '.join(unknown)}",) if unknown else ()
    return detections_of_rows(name, frames, found_rows, layout=chosen, decisions=named)


def plain_part_name(part: str) -> str:
    """Convert a body part's name to recon's spelling: LHip, hip_left become left_hip."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=^[LR])(?=[A-Z])(?!EFT|IGHT)", "_", part.strip())
    joined = re.sub(r"[^a-z0-9]+", "_", spaced.lower()).strip("_")
    joined = re.sub(r"^(left|right)(?=[a-z])", r"\1_", joined)
    words = [_WORDS.get(word, word) for word in joined.split("_")]
    side = [word for word in words if word in ("left", "right")]
    return "_".join(side + [word for word in words if word not in side])


def layout_of_parts(parts: list[str], layout: str | None, name: str) -> tuple[str, list[str]]:
    """Return the layout that matches most of these part names, and the unmatched names."""
    parts_by_word = {plain_part_name(part): part for part in parts}
    candidates = LAYOUTS if layout is None else {layout: keypoint_names(layout)}
    matches = {key: len(parts_by_word.keys() & set(LAYOUTS[key])) for key in candidates}
    best = max(candidates, key=lambda key: (matches[key], -len(LAYOUTS[key])))
    known = parts_by_word.keys() & set(LAYOUTS[best])
    if len(known) < _FEWEST_KNOWN_PARTS:
        raise FormatError(
            f"{name}: only {len(known)} of its body parts are known by name; found "
            f"{', '.join(parts)}, expected names such as {', '.join(LAYOUTS[best][:8])}"
        )
    return best, [part for word, part in parts_by_word.items() if word not in known]


def is_sleap(path: Path) -> bool:
    """Whether a CSV table has the column names of SLEAP."""
    head = next(iter(first_rows(path, 1)), [])
    return "frame_idx" in head and any(name.endswith(".x") for name in head)


def read_sleap(path: Path, layout: str | None = None) -> Detections:
    """Read SLEAP's table of a row per person and frame; unknown nodes are left out and noted.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or too few nodes are known by name.
    """
    name = path.name
    head, *rows = read_rows(path, JSON)
    refuse_repeated_columns(head, name)
    columns = {column: k for k, column in enumerate(head)}
    nodes = [column[:-2] for column in head if column.endswith(".x")]
    SAMPLES.check((len(rows) + 1) * max(len(nodes), 1), name)
    chosen, unknown = layout_of_parts(nodes, layout, name)
    places = {keypoint: k for k, keypoint in enumerate(keypoint_names(chosen))}
    points = np.zeros((len(rows), len(places), 3))
    for node in nodes:
        k = places.get(plain_part_name(node))
        for axis, coordinate in enumerate(("x", "y", "score") if k is not None else ()):
            column = columns.get(f"{node}.{coordinate}")
            points[:, k, axis] = 1.0
            if column is not None:
                cells = numbers_of_columns(rows, [column], name, least=len(head), most=len(head))
                points[:, k, axis] = cells[:, 0]
    frames = numbers_of_columns(rows, [columns["frame_idx"]], name, most=len(head))[:, 0]
    if not (frames >= 0).all() or (frames % 1).any():
        raise FormatError(f"{name}: expected the number of a frame in every row of frame_idx")
    tracks = [row[columns["track"]] if "track" in columns else "" for row in rows]
    identity = [re.search(r"(\d{1,9})$", track) for track in tracks]
    found: list[Row] = [
        (int(frame), person, -1 if who is None else int(who[1]))
        for frame, person, who in zip(frames, points, identity, strict=True)
    ]
    said = (f"nodes left out: {', '.join(unknown)}",) if unknown else ()
    return detections_of_rows(
        name, sorted({row[0] for row in found}), found, layout=chosen, decisions=said
    )


_KEYPOINTS = ("keypoints", "kpts", "keypoints_2d", "keypoints2d", "pred_keypoints")
_SCORES = ("scores", "keypoint_scores", "confidence", "conf")
_PIXELS = 10.0
"""Median coordinate from which on numbers are pixels: people are not so far away in metres."""


def holds_detections(path: Path) -> bool:
    """Whether an .npz file holds 2D keypoints, with or without a third column of confidences."""
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    return _pixels_and_confidence(load_arrays(path)) is not None


def read_detection_arrays(path: Path, layout: str | None = None) -> Detections:
    """Read an .npz of 2D keypoints, (frames, points, 2 or 3) or (frames, people, points, 2 or 3).

    Files that `recon detect` wrote have frame numbers, everybody's number, the layout, the frame
    rate and the size of the images besides.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds no 2D keypoints or nobody.
    """
    arrays = load_arrays(path)
    values = _pixels_and_confidence(arrays)
    if values is None:
        raise FormatError(
            f"{path}: expected 2D keypoints as `keypoints` (frames, people, points, 2) with "
            f"`scores`, or (..., 3) with a confidence; got {', '.join(sorted(arrays))}"
        )
    FRAMES.check(len(values), path.name)
    PEOPLE.check(values.shape[1], path.name, "people")
    numbers, identity = _frame_and_person_numbers(arrays, values.shape[:2], path)
    there = np.asarray(np.isfinite(values).all(-1).any(-1) & (values[..., 2] > 0).any(-1))
    rows: list[Row] = [
        (int(numbers[frame]), values[frame, person], int(identity[frame, person]))
        for frame, person in np.argwhere(there)
    ]
    if layout is None and "layout" in arrays and str(arrays["layout"]) in LAYOUTS:
        layout = str(arrays["layout"])
    found = detections_of_rows(path.name, numbers.tolist(), rows, layout=layout)
    size = np.asarray(arrays.get("image_size", 0)).ravel()
    sized = size.dtype.kind in "iu" and len(size) == 2 and (size > 0).all()
    shots = np.asarray(arrays.get("shots", [])).ravel()
    cut = shots.dtype.kind in "iu" and (np.diff(shots) > 0).all()
    return replace(
        found,
        frame_rate=_number_within(arrays, "frame_rate", FRAME_RATE),
        stated_focal=_number_within(arrays, "stated_focal", FILM_FOCAL_LENGTH),
        image_size=(int(size[0]), int(size[1])) if sized else None,
        shots=tuple(shots.tolist()) if cut else (),
        hands=found.hands if "hands" not in arrays else _hand_keypoints(arrays, there, path),
        **_straight_lines(arrays, path),
        background=_background_points(arrays, path),
    )


def _number_within(
    arrays: Mapping[str, Shaped[np.ndarray, "..."]], key: str, within: Limit
) -> float | None:
    """Return a number from a file's arrays; None if it is absent or outside its limits."""
    value = np.asarray(arrays.get(key, np.nan)).ravel()
    sound = value.dtype.kind in "fiu" and len(value) == 1 and within.holds(value)
    return float(value[0]) if sound else None


def _hand_keypoints(
    arrays: dict[str, Shaped[np.ndarray, "..."]],
    kept: Bool[np.ndarray, "frames people"],
    path: Path,
) -> Float[np.ndarray, "rows 42 3"]:
    """Return the hand keypoints in a file, for the chosen frames and people.

    Raises:
        ValueError: when they are not numbers of the right shape.
    """
    hands, shape = np.asarray(arrays["hands"]), (*kept.shape, 42, 3)
    if hands.shape != shape or hands.dtype.kind != "f":
        raise FormatError(
            f"{path}: expected hands of shape {shape}, decimals, got {hands.dtype} {hands.shape}"
        )
    hands = with_clipped_confidences(hands[kept].astype(np.float64))
    PIXEL.check(hands[..., :2], path.name, "hands")
    return hands


def _background_points(
    arrays: dict[str, Shaped[np.ndarray, "..."]], path: Path
) -> Background | None:
    """Return the tracked background points in a file's arrays; None if it has none.

    Raises:
        ValueError: when they are not numbers of shapes that belong together.
    """
    if "background" not in arrays:
        return None
    pixels, which = np.asarray(arrays["background"]), np.asarray(arrays.get("background_of"))
    shaped = pixels.ndim == 2 and pixels.shape[1] == 2 and which.shape == pixels.shape
    whole = pixels.dtype.kind == "f" and which.dtype.kind in "iu"
    if not shaped or not whole or (which < 0).any() or (which[:, 1] >= len(which)).any():
        raise FormatError(
            f"{path}: expected background (N, 2), decimal numbers: pixels of tracked points; and "
            "background_of (N, 2), whole numbers: the frame of each row, and the number of its "
            "point, below N; got "
            f"{pixels.dtype} {pixels.shape} and {which.dtype} {which.shape}"
        )
    PIXEL.check(pixels, path.name, "background")
    return Background(which[:, 0], which[:, 1], pixels.astype(np.float64))


def _straight_lines(
    arrays: dict[str, Shaped[np.ndarray, "..."]], path: Path
) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Return the arrays of straight image segments and their frames in a file; {} if none.

    Raises:
        ValueError: when they are not numbers of shapes that belong together.
    """
    if "lines" not in arrays:
        return {}
    lines, frame = np.asarray(arrays["lines"]), np.asarray(arrays.get("lines_frame"))
    shaped = lines.shape[1:] == (2, 2) and frame.shape == lines.shape[:1]
    if not shaped or lines.dtype.kind != "f" or frame.dtype.kind not in "iu":
        raise FormatError(
            f"{path}: expected lines (N, 2, 2), decimal pixels of segments' ends, and lines_frame "
            f"(N), whole numbers, got {lines.dtype} {lines.shape} and {frame.dtype} {frame.shape}"
        )
    PIXEL.check(lines, path.name, "lines")
    return {"lines": lines.astype(np.float64), "lines_frame": frame}


def _frame_and_person_numbers(
    arrays: dict[str, Shaped[np.ndarray, "..."]], shape: tuple[int, int], path: Path
) -> tuple[Int[np.ndarray, " frames"], Int[np.ndarray, "frames people"]]:
    """Return a file's frame numbers, and its person numbers by frame (-1 for no number).

    Raises:
        ValueError: when there is not one for each, or frame numbers do not rise.
    """
    numbers = np.asarray(arrays.get("frame_numbers", np.arange(shape[0])))
    identity = np.asarray(arrays.get("identity", np.full(shape, -1)))
    whole = numbers.dtype.kind in "iu" and identity.dtype.kind in "iu"
    if not whole or numbers.shape != shape[:1] or identity.shape != shape:
        raise FormatError(
            f"{path}: expected whole numbers, frame_numbers of shape {shape[:1]} and identity of "
            f"{shape}, got {numbers.dtype} {numbers.shape} and {identity.dtype} {identity.shape}"
        )
    if (numbers < 0).any() or (np.diff(numbers.astype(np.int64)) <= 0).any():
        raise FormatError(
            f"{path}: expected frame_numbers of 0 or more, each larger than the one before"
        )
    return numbers, identity


def detection_arrays(found: Detections) -> dict[str, np.ndarray]:
    """Convert detections to the arrays of an .npz file, with one column per person.

    People without a number stand in the order of their frame.
    """
    frames = np.searchsorted(found.frame_numbers, found.frame)
    numbered = (found.identity >= 0).all()
    column = (
        np.unique(found.identity, return_inverse=True)[1]
        if numbered
        else np.arange(len(frames)) - np.searchsorted(frames, frames)
    )
    shape = (len(found.frame_numbers), int(column.max()) + 1, found.pixels.shape[1])
    out = {
        "keypoints": np.zeros((*shape, 2)),
        "scores": np.zeros(shape),
        "identity": np.full(shape[:2], -1),
        "frame_numbers": found.frame_numbers,
        "layout": np.array(found.layout),
    }
    out["keypoints"][frames, column] = found.pixels
    out["scores"][frames, column] = found.confidence
    out["identity"][frames, column] = found.identity
    if found.hands is not None:
        out["hands"] = np.zeros((*shape[:2], *found.hands.shape[1:]))
        out["hands"][frames, column] = found.hands
    for key, value in (
        ("frame_rate", found.frame_rate), ("image_size", found.image_size),
        ("stated_focal", found.stated_focal),
        ("shots", found.shots or None), ("lines", found.lines), ("lines_frame", found.lines_frame),
    ):  # fmt: skip
        if value is not None:
            out[key] = np.array(value)
    if (behind := found.background) is not None:
        out["background"] = behind.pixels
        out["background_of"] = np.column_stack((behind.frame, behind.point))
    return out


def _pixels_and_confidence(
    arrays: dict[str, Shaped[np.ndarray, "..."]],
) -> Float[np.ndarray, "frames people points 3"] | None:
    """Return x, y and confidence from a file's arrays; None if they are no 2D keypoints."""
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
