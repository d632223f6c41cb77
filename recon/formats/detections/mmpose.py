"""MMPose's JSON and rtmlib's arrays: keypoints and their scores side by side."""

from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.formats.detections.records import Row
from recon.formats.files.json_files import Frames, as_floats, as_identity

_SCORES = ("keypoint_scores", "scores")


def is_mmpose(entry: Any) -> bool:
    """Whether what was written about a frame is a list of instances, or rtmlib's two arrays."""
    people = _instances(entry)
    return len(people) > 0 and all(
        isinstance(one, dict) and "keypoints" in one and any(key in one for key in _SCORES)
        for one in people
    )


def mmpose_rows(frames: Frames, name: str) -> list[Row]:
    """Everybody in frames of instances.

    Heatmap scores lie in [0, 1]; those of SimCC heads (RTMPose) are not normalised and are
    clipped there.

    Raises:
        ValueError: when a frame has another form.
    """
    rows: list[Row] = []
    for number, entry in frames:
        where = f"{name}, frame {number}"
        people = _instances(entry)
        if len(people) > 0 and not is_mmpose(entry):
            raise FormatError(f"{where}: expected keypoints and keypoint_scores of every instance")
        for person in people:
            scores = as_floats(next(person[key] for key in _SCORES if key in person), where)
            pixels = as_floats(person["keypoints"], where)
            if scores.size == 0:
                continue
            if pixels.ndim < 2 or pixels.shape[:-1] != scores.shape or pixels.shape[-1] != 2:
                raise FormatError(
                    f"{where}: expected keypoints (..., K, 2) with scores (..., K), got "
                    f"{pixels.shape} and {scores.shape}"
                )
            identity = as_identity(person.get("track_id", person.get("instance_id")), where)
            points = np.concatenate((pixels, scores[..., None]), -1)
            single = points.reshape(-1, *points.shape[-2:])
            rows += [(number, one, identity if len(single) == 1 else -1) for one in single]
    return rows


def _instances(entry: Any) -> list[Any]:
    """The people of a frame: `{"instances": [...]}`, a list, or one record of arrays."""
    if isinstance(entry, dict) and isinstance(entry.get("instances"), list):
        entry = entry["instances"]
    while isinstance(entry, list) and len(entry) == 1 and isinstance(entry[0], list):
        entry = entry[0]
    if isinstance(entry, list):
        return entry
    return [entry] if entry else []
