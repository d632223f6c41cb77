"""2D keypoints as arrays (.npz): `keypoints` of every frame, with `scores` or a third column."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from recon.core.errors import FormatError
from recon.core.limits import FRAMES, PEOPLE
from recon.formats.detections.records import Detections, Row, gather
from recon.formats.files.opening import load_arrays

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
