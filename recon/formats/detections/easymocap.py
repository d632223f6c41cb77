"""EasyMocap's `annots/<camera>/<frame>.json`: people with boxes and BODY_25 keypoints."""

from typing import Any

from recon.formats.detections.records import Row
from recon.formats.files.json_files import Frames, as_identity, flat_points, people_in


def is_easymocap(entry: Any) -> bool:
    """Whether what was written about a frame is EasyMocap's."""
    return isinstance(entry, dict) and isinstance(entry.get("annots"), list)


def easymocap_rows(frames: Frames, name: str) -> list[Row]:
    """Everybody in frames of EasyMocap's annotations.

    The confidence is the detector's, in [0, 1]; a negative one means missing.

    Raises:
        ValueError: when a frame has another form.
    """
    everybody = people_in(frames, "annots", name, "annots, as in EasyMocap")
    return [
        (
            number,
            flat_points(person.get("keypoints") or [], place),
            as_identity(person.get("personID", person.get("id")), place),
        )
        for number, person, place in everybody
    ]
