"""What 3D keypoints of other programs hold, and what is assumed of them."""

from typing import Any

from recon.body.model import BodyModel
from recon.formats.keypoints3d.records import Points3D
from recon.reading.keypoints3d import settled

_ANY_RATE = 30.0
"""Frames per second with which nothing is told but times."""


def describe_points(points: Points3D) -> dict[str, Any]:
    """Keypoints, sizes, rate and decisions; without a rate, all that does not depend on it.

    Raises:
        ValueError: when layout, unit or axis cannot be told; the message says what was found.
    """
    file = settled(points, BodyModel.load(), fps=points.fps or _ANY_RATE)
    asked = () if points.fps is not None else ("no frame rate: give --frame-rate to fit",)
    return {
        "format": "3D keypoints",
        "frames": len(file.positions),
        "points": len(file.names),
        "fps": points.fps,
        "start_time": file.start_time,
        "missing": float(1 - file.visible.mean()),
        "units": "metres, z up" if file.level else "metres, frame of a camera turned to z up",
        "placed": file.placed,
        "ground_known": file.ground_known,
        "names": list(file.names),
        "decisions": [*file.decisions, *asked],
    }
