"""MediaPipe Pose as JSON: 33 landmarks per person, in fractions of the image."""

from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.formats.detections.records import Row
from recon.formats.files.json_files import Frames, as_floats

_KEYS = ("pose_landmarks", "landmarks", "poseLandmarks")
_LANDMARKS = 33
_FRACTION = 2.0
"""Landmarks outside the image are guessed too, but seldom farther out than another image."""


def is_mediapipe(entry: Any) -> bool:
    """Whether what was written about a frame is landmarks with x, y and a visibility."""
    people = _people(entry)
    return len(people) > 0 and all(
        isinstance(point, dict) and {"x", "y"} <= point.keys() for point in people[0]
    )


def mediapipe_rows(frames: Frames, image_size: tuple[int, int] | None, name: str) -> list[Row]:
    """Everybody in frames of landmarks, in pixels; the confidence is the visibility.

    Coordinates that all lie near [0, 1] are fractions of width and height, others are pixels.

    Raises:
        ValueError: when a frame has another form, or fractions come without an image size.
    """
    rows: list[Row] = [
        (number, _landmarks(person, f"{name}, frame {number}"), -1)
        for number, entry in frames
        for person in _people(entry)
    ]
    places = np.abs(np.concatenate([row[1][:, :2] for row in rows] or [np.zeros((1, 2))]))
    if np.median(np.nan_to_num(places)) > _FRACTION:
        return rows
    if image_size is None:
        raise FormatError(
            f"{name}: MediaPipe's landmarks are fractions of the image, whose size is unknown; "
            "give --image-size WIDTH HEIGHT, or a camera with --camera"
        )
    scale = np.array([*image_size, 1.0])
    return [(number, points * scale, identity) for number, points, identity in rows]


def _people(entry: Any) -> list[list[Any]]:
    """Landmarks by person, from a record or list of one person or of several."""
    if isinstance(entry, dict):
        entry = next((entry[key] for key in _KEYS if key in entry), None)
    if not isinstance(entry, list) or len(entry) == 0:
        return []
    if isinstance(entry[0], dict):
        return [entry]
    return [person for person in entry if isinstance(person, list) and len(person) > 0]


def _landmarks(person: list[Any], where: str) -> np.ndarray:
    if len(person) != _LANDMARKS or not all(
        isinstance(point, dict) and {"x", "y"} <= point.keys() for point in person
    ):
        raise FormatError(f"{where}: expected {_LANDMARKS} landmarks with x, y and visibility")
    return as_floats(
        [[point["x"], point["y"], point.get("visibility", 1.0)] for point in person], where
    )
