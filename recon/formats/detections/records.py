"""What a 2D detector found in the images of one camera: any number of people per frame."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError
from recon.core.limits import FRAME_NUMBER, KEYPOINTS, PEOPLE, PERSON, PIXEL, SCORE
from recon.formats.detections.layout import settle_layout

Row = tuple[int, np.ndarray, int]
"""Frame number, (keypoints, 3) of x, y, confidence, and the person's number or -1."""


@dataclass(frozen=True)
class Detections:
    """People found by one producer in one view; one row per person and frame."""

    name: str
    """Name of the folder or file."""
    layout: str
    """One of `recon.core.layouts.LAYOUTS`."""
    frame_numbers: Int[np.ndarray, " frames"]
    """Frames that were looked at, increasing; also those without anybody."""
    frame: Int[np.ndarray, " rows"]
    """The frame number of each row; rows of a frame in the order of the file."""
    pixels: Float[np.ndarray, "rows points 2"]
    """Zero where the confidence is zero."""
    confidence: Float[np.ndarray, "rows points"]
    """Confidence from 0 (missing) to 1."""
    identity: Int[np.ndarray, " rows"]
    """The number the producer gave to a person, -1 for none."""
    decisions: tuple[str, ...] = ()
    """What was decided about the file and why."""


def gather(
    name: str,
    frame_numbers: Sequence[int],
    rows: Sequence[Row],
    *,
    layout: str | None = None,
    decisions: tuple[str, ...] = (),
) -> Detections:
    """Detections from rows as they were read.

    Confidences are clipped to [0, 1]. A keypoint is missing where its confidence is zero, or its
    place is NaN, infinite, (0, 0), or -1 in both coordinates.

    Raises:
        ValueError: when nobody was found at all, rows have different lengths, or the layout
            cannot be told.
    """
    rows = [row for row in rows if len(row[1]) > 0]
    if len(rows) == 0:
        raise FormatError(
            f"{name}: expected people, but all {len(frame_numbers)} frames are empty; run the "
            "detector again, or leave this view out"
        )
    lengths = sorted({len(row[1]) for row in rows})
    if len(lengths) > 1:
        raise FormatError(
            f"{name}: expected one number of keypoints for all people, got "
            f"{' and '.join(map(str, lengths))}"
        )
    _check_sizes(name, frame_numbers, rows)
    points = np.stack([row[1] for row in rows])
    SCORE.check(points[..., 2], name, "[person, keypoint]", seen=np.isfinite(points[..., 2]))
    points = cleaned(points)
    PIXEL.check(points[..., :2], name, "[person, keypoint, axis]")
    chosen, points, decision = settle_layout(points, layout, name)
    return Detections(
        name=name,
        layout=chosen,
        frame_numbers=np.array(frame_numbers, dtype=np.int64),
        frame=np.array([row[0] for row in rows], dtype=np.int64),
        pixels=points[..., :2],
        confidence=points[..., 2],
        identity=np.array([row[2] for row in rows], dtype=np.int64),
        decisions=(*decisions, decision),
    )


def _check_sizes(name: str, frame_numbers: Sequence[int], rows: Sequence[Row]) -> None:
    """Refuse numbers that no detector gives, before arrays are made of them.

    Raises:
        ValueError: naming file, quantity and what came.
    """
    FRAME_NUMBER.check(max(frame_numbers), name, "frame number")
    KEYPOINTS.check(len(rows[0][1]), name)
    PERSON.check(max(row[2] for row in rows), name, "number of the person")
    frame, people = Counter(row[0] for row in rows).most_common(1)[0]
    PEOPLE.check(people, name, f"frame {frame}")


def cleaned(points: Float[np.ndarray, "rows points 3"]) -> Float[np.ndarray, "rows points 3"]:
    """Confidences clipped to [0, 1]; all three numbers zero where a keypoint is missing."""
    finite = np.isfinite(points).all(-1)
    place = points[..., :2]
    nowhere = (place == 0).all(-1) | (place == -1).all(-1)
    seen = finite & ~nowhere & (points[..., 2] > 0)
    confidence = np.clip(np.where(seen, points[..., 2], 0.0), 0.0, 1.0)
    return np.concatenate((np.where(seen[..., None], place, 0.0), confidence[..., None]), -1)
