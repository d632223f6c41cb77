"""OpenPose's JSON, one file per frame, also written by Pose2Sim and AlphaPose (`--format open`).

Pose2Sim's `pose-associated` files are the same; somebody without a match is an empty record.
"""

from typing import Any

from recon.formats.detections import Row
from recon.formats.json_files import Frames, as_identity, flat_points


def is_openpose(entry: Any) -> bool:
    """Whether what was written about a frame has OpenPose's envelope."""
    return isinstance(entry, dict) and isinstance(entry.get("people"), list)


def openpose_rows(frames: Frames, name: str) -> list[Row]:
    """Everybody in frames of OpenPose's JSON; an empty frame `{}` is one without people.

    The confidence is OpenPose's own, in [0, 1].

    Raises:
        ValueError: when a frame has another form.
    """
    rows: list[Row] = []
    for number, entry in frames:
        if not entry:
            continue
        if not is_openpose(entry) or not all(isinstance(one, dict) for one in entry["people"]):
            raise ValueError(f"{name}, frame {number}: expected a list of people, as in OpenPose")
        for person in entry["people"]:
            values = person.get("pose_keypoints_2d") or []
            points = flat_points(values, f"{name}, frame {number}")
            rows.append((number, points, as_identity(person.get("person_id"))))
    return rows
