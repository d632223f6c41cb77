"""Reads 2D keypoints in JSON: OpenPose, EasyMocap, MMPose, rtmlib, MediaPipe, AlphaPose.

A reader of one producer takes what a file says of a frame and gives everybody in it, or None where
another producer wrote it.
"""

from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.fingers import SIDES
from recon.detections.records import Detections, Row, detections_of_rows
from recon.formats.json_files import (
    Frames,
    as_floats,
    as_identity,
    flat_points,
    frame_numbers,
    listed_frames,
)

EXPECTED = (
    "OpenPose (people), EasyMocap (annots), MMPose or rtmlib (keypoints with scores), AlphaPose "
    "(image_id with keypoints) or MediaPipe (landmarks)"
)
"""What is read, in messages."""
_COCO_RANGE, _SURELY_TO_SIX = 6.0, 1.5
"""AlphaPose's scores run to 6 for COCO models, to 1 for others; and the score that a tenth of a
file's scores exceeds only where they run to 6."""
_LISTS = ("instance_info", "predictions", "frames")
"""Keys under which a file with all frames keeps them."""
_SCORES = ("keypoint_scores", "scores")
_LANDMARK_KEYS = ("pose_landmarks", "landmarks", "poseLandmarks")
_HAND_KEYS = tuple((f"{side}_hand_landmarks", f"{side}HandLandmarks") for side in SIDES)
LANDMARKS = 33
POINTS_OF_HAND = 21
_FRACTION = 2.0
"""Landmarks outside the image are guessed too, but seldom farther out than another image."""
People = list[tuple[Float[np.ndarray, "keypoints 3"], int]]
"""x, y and confidence of everybody in a frame, with their number or -1."""


def read_json_detections(
    value: Any, name: str, layout: str | None, image_size: tuple[int, int] | None
) -> Detections:
    """Read 2D keypoints of all people from the parsed content of one JSON file.

    Args:
        value: what the file holds.
        name: of the file, for messages.
        layout: which keypoints; None to tell it from them.
        image_size: width and height, pixels; needed for fractions of an image alone.

    Raises:
        ValueError: when no known producer wrote it so, or nobody is in it.
    """
    if is_alphapose(value):
        return _read_alphapose(value, name, layout)
    if isinstance(value, dict):
        value = next((value[key] for key in _LISTS if key in value), [value])
    if not isinstance(value, list):
        raise FormatError(f"{name}: expected {EXPECTED}")
    records = [one for one in value if isinstance(one, dict)]
    one_frame = all("keypoint_scores" in one for one in records) or all(
        {"x", "y"} <= one.keys() for one in records
    )
    if one_frame and 0 < len(records) == len(value):
        value = [value]
    return read_frames(listed_frames(value, name), name, layout, image_size)


def read_frames(
    frames: Frames, name: str, layout: str | None, image_size: tuple[int, int] | None
) -> Detections:
    """Read 2D keypoints of all people from JSON values, one per frame, of one detector."""
    reader = next(
        (
            candidate
            for _, entry in frames
            if entry
            for candidate in _FRAME_READERS
            if candidate(entry, name) is not None
        ),
        None,
    )
    if reader is None and not any(not entry for _, entry in frames):
        raise FormatError(f"{name}: expected {EXPECTED}")
    rows: list[Row] = []
    for number, entry in frames:
        if not entry or reader is None:
            continue
        place = f"{name}, frame {number}"
        people = reader(entry, place)
        if people is None and reader is not _people_of_mediapipe:
            raise FormatError(f"{place}: expected {_FRAME_READERS[reader]}")
        rows += [(number, points, identity) for points, identity in people or []]
    if reader is _people_of_mediapipe:
        rows, layout = _landmarks_in_pixels(rows, image_size, name), layout or "mediapipe33"
    return detections_of_rows(name, [number for number, _ in frames], rows, layout=layout)


def is_alphapose(value: Any) -> bool:
    """Whether parsed JSON is AlphaPose's format: a list of people, each with an `image_id`."""
    return (
        isinstance(value, list)
        and len(value) > 0
        and all(isinstance(one, dict) and "image_id" in one for one in value)
    )


def _read_alphapose(people: list[dict[str, Any]], name: str, layout: str | None) -> Detections:
    """Read 2D keypoints of AlphaPose, whose scores are at most 1, or 6 (of COCO models).

    They are divided by 6 if a tenth of them is above `_SURELY_TO_SIX`; else scores a little above
    1 become 1.
    """
    images = sorted({str(person["image_id"]) for person in people})
    numbers = frame_numbers([PurePath(image).stem for image in images], name)
    by_image = dict(zip(images, numbers, strict=True))
    rows: list[Row] = []
    for person in people:
        image = str(person["image_id"])
        points = flat_points(person.get("keypoints") or [], f"{name}, image {image}")
        rows.append((by_image[image], points, as_identity(person.get("idx"), name)))
    said: tuple[str, ...] = ()
    scores = np.concatenate([points[:, 2] for _, points, _ in rows])
    if np.quantile(np.append(scores[scores > 0], 0.0), 0.9, method="lower") > _SURELY_TO_SIX:
        said = (f"AlphaPose's confidences were divided by {_COCO_RANGE:g}, as many exceed 1",)
        scale = (1.0, 1.0, _COCO_RANGE)
        rows = [(number, points / scale, identity) for number, points, identity in rows]
    for _, points, _ in rows:
        points[:, 2] = points[:, 2].clip(max=1.0)
    rows.sort(key=lambda row: row[0])
    return detections_of_rows(name, sorted(numbers), rows, layout=layout, decisions=said)


def _people_of_openpose(entry: Any, source: str) -> People | None:
    people = _listed_people(entry, source, "people", "pose_keypoints_2d", ("person_id",))
    return people and [
        (
            _with_hands(points, [one.get(f"hand_{side}_keypoints_2d") for side in SIDES], source),
            number,
        )
        for (points, number), one in zip(people, entry["people"], strict=True)
    ]


def _with_hands(
    body: Float[np.ndarray, "keypoints 3"], hands: list[Any], source: str
) -> Float[np.ndarray, "more 3"]:
    """Append 21 keypoints of each hand to those of a body; a missing hand gives zeros.

    Raises:
        ValueError: when a hand has another number.
    """
    found = [flat_points(one or [], source) for one in hands]
    if len(body) == 0 or not any(map(len, found)):
        return body
    if any(len(one) not in (0, POINTS_OF_HAND) for one in found):
        raise FormatError(
            f"{source}: expected {POINTS_OF_HAND} keypoints of a hand, got "
            f"{' and '.join(str(len(hand)) for hand in found)}"
        )
    nothing = np.zeros((POINTS_OF_HAND, 3))
    return np.concatenate((body, *(one if len(one) else nothing for one in found)))


def _people_of_easymocap(entry: Any, source: str) -> People | None:
    """Read everybody's 2D keypoints in one frame of EasyMocap; None if it is no such frame."""
    return _listed_people(entry, source, "annots", "keypoints", ("personID", "id"))


def _listed_people(
    entry: Any, source: str, key: str, keypoints_key: str, identity_keys: tuple[str, ...]
) -> People | None:
    """Read a list of people under `key` whose keypoints are flat lists x, y, confidence, ..."""
    people = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(people, list):
        return None
    if not all(isinstance(one, dict) for one in people):
        raise FormatError(f"{source}: expected a list of people, each a record, in {key}")
    numbers = [next((one[k] for k in identity_keys if k in one), None) for one in people]
    return [
        (flat_points(one.get(keypoints_key) or [], source), as_identity(number, source))
        for one, number in zip(people, numbers, strict=True)
    ]


def _people_of_mmpose(entry: Any, source: str) -> People | None:
    """Read everybody's 2D keypoints in one frame of MMPose or rtmlib; None for other formats.

    Heatmap scores lie in [0, 1]; those of SimCC heads (RTMPose) are not normalised and clipped.
    """
    if isinstance(entry, dict):
        entry = entry.get("instances", [entry])
    while isinstance(entry, list) and len(entry) == 1 and isinstance(entry[0], list):
        entry = entry[0]
    if not isinstance(entry, list):
        return None
    people: People = []
    for person in entry:
        key = next((key for key in _SCORES if isinstance(person, dict) and key in person), None)
        if key is None or "keypoints" not in person:
            return None
        scores, pixels = as_floats(person[key], source), as_floats(person["keypoints"], source)
        if scores.size == 0:
            continue
        if pixels.ndim < 2 or pixels.shape[:-1] != scores.shape or pixels.shape[-1] != 2:
            raise FormatError(
                f"{source}: expected keypoints (..., K, 2) with scores (..., K), got "
                f"{pixels.shape} and {scores.shape}"
            )
        identity = as_identity(person.get("track_id", person.get("instance_id")), source)
        points = np.concatenate((pixels, scores[..., None]), -1)
        single = points.reshape(-1, *points.shape[-2:])
        people += [(one, identity if len(single) == 1 else -1) for one in single]
    return people


def _people_of_mediapipe(entry: Any, source: str) -> People | None:
    """Read everybody's landmarks in one frame of MediaPipe; None for other formats."""
    people = people_of_landmarks(entry, _LANDMARK_KEYS)
    if people is None or (people and not _has_axes(people[0], "xy")):
        return None
    found = [landmark_rows(person, "xy", source) for person in people]
    hands = [people_of_landmarks(entry, keys) for keys in _HAND_KEYS if isinstance(entry, dict)]
    if len(found) == 1 and any(hands):
        rows = [_flat_hand(one[0], source) if one else [] for one in hands]
        found = [_with_hands(found[0], rows, source)]
    return [(points, -1) for points in found]


def _flat_hand(hand: list[Any], source: str) -> list[Any]:
    """Flatten MediaPipe's hand landmarks to a list x, y, 1 (the confidence), x, y, 1, ..."""
    if not _has_axes(hand, "xy"):
        raise FormatError(f"{source}: expected landmarks of a hand with x and y")
    return [number for one in hand for number in (one["x"], one["y"], 1.0)]


def people_of_landmarks(entry: Any, keys: tuple[str, ...]) -> list[list[Any]] | None:
    """Return MediaPipe's landmarks by person, found under one of `keys`; None without them."""
    if isinstance(entry, dict):
        key = next((key for key in keys if key in entry), None)
        entry = None if key is None else entry[key] or []
    if not isinstance(entry, list):
        return None
    if entry and isinstance(entry[0], dict):
        return [entry]
    return [person for person in entry if isinstance(person, list) and len(person) > 0]


def landmark_rows(person: list[Any], axes: str, source: str) -> Float[np.ndarray, "33 numbers"]:
    """Convert a person's 33 landmark records of MediaPipe to rows: the `axes`, then visibility.

    Raises:
        ValueError: when there are not 33 of them, or axes are missing.
    """
    if len(person) != LANDMARKS or not _has_axes(person, axes):
        raise FormatError(
            f"{source}: expected {LANDMARKS} MediaPipe landmarks, each with {', '.join(axes)}, "
            f"got {len(person)} landmarks, or some without these; write all landmarks of a person"
        )
    rows = [[*(one[axis] for axis in axes), one.get("visibility", 1.0)] for one in person]
    return as_floats(rows, source)


def _has_axes(person: list[Any], axes: str) -> bool:
    return all(isinstance(one, dict) and set(axes) <= one.keys() for one in person)


def _landmarks_in_pixels(
    rows: list[Row], image_size: tuple[int, int] | None, name: str
) -> list[Row]:
    """Convert landmarks from fractions of the image to pixels, unless they are pixels already."""
    places = [np.abs(points[:LANDMARKS, :2]) for _, points, _ in rows]
    if not rows or np.median(np.nan_to_num(places)) > _FRACTION:
        return rows
    if image_size is None:
        raise FormatError(
            f"{name}: MediaPipe's landmarks are fractions of the image, whose size is unknown; "
            "give --image-size WIDTH HEIGHT, or a camera with --camera"
        )
    return [(number, points * (*image_size, 1.0), who) for number, points, who in rows]


_FRAME_READERS: dict[Callable[[Any, str], People | None], str] = {
    _people_of_openpose: "a list of people, as in OpenPose",
    _people_of_easymocap: "annots, as in EasyMocap",
    _people_of_mediapipe: "landmarks, as in MediaPipe",
    _people_of_mmpose: "keypoints and keypoint_scores of every instance",
}
"""Readers of a frame, and what they expect in every one, in messages."""
