"""OpenPose's JSON, one file per frame, also written by Pose2Sim and AlphaPose (`--format open`).

Pose2Sim's `pose-associated` files are the same; somebody without a match is an empty record.
"""

from typing import Any

from recon.formats.detections.records import Row
from recon.formats.files.json_files import Frames, as_identity, flat_points, people_in


def is_openpose(entry: Any) -> bool:
    """Whether what was written about a frame has OpenPose's envelope."""
    return isinstance(entry, dict) and isinstance(entry.get("people"), list)


def openpose_rows(frames: Frames, name: str) -> list[Row]:
    """Everybody in frames of OpenPose's JSON; an empty frame `{}` is one without people.

    The confidence is OpenPose's own, in [0, 1].

    Raises:
        ValueError: when a frame has another form.
    """
    everybody = people_in(frames, "people", name, "a list of people, as in OpenPose")
    return [
        (
            number,
            flat_points(person.get("pose_keypoints_2d") or [], place),
            as_identity(person.get("person_id"), place),
        )
        for number, person, place in everybody
    ]
