"""AlphaPose's JSON: one flat list of people, each with the name of its image."""

from pathlib import PurePath
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.formats.detections.records import Row
from recon.formats.json_files import (
    Frames,
    as_floats,
    as_identity,
    flat_points,
    frame_numbers,
    people_in,
)

_COCO_RANGE = 6.0
"""AlphaPose's scores run to 6 for COCO models, to 1 for others."""


def is_alphapose(value: Any) -> bool:
    """Whether a file is a flat list of people with an image each."""
    return (
        isinstance(value, list)
        and len(value) > 0
        and all(isinstance(one, dict) and "image_id" in one for one in value)
    )


def alphapose_rows(people: list[dict[str, Any]], name: str) -> tuple[list[int], list[Row]]:
    """The numbers of the frames between the first and the last image, and everybody in them.

    Where any score exceeds 1, all are divided by 6 and clipped, else they are taken as they are.

    Raises:
        ValueError: when somebody has no keypoints, or an image has no number.
    """
    images = sorted({str(person["image_id"]) for person in people})
    numbers = frame_numbers([PurePath(image).stem for image in images], name)
    by_image = dict(zip(images, numbers, strict=True))
    rows: list[Row] = []
    for person in people:
        image = str(person["image_id"])
        points = flat_points(person.get("keypoints") or [], f"{name}, image {image}")
        rows.append((by_image[image], points, as_identity(person.get("idx"), name)))
    scores = np.concatenate([points[:, 2] for _, points, _ in rows])
    if np.nanmax(scores, initial=0.0) > 1:
        scale = np.array([1.0, 1.0, _COCO_RANGE])
        rows = [(number, points / scale, identity) for number, points, identity in rows]
    rows.sort(key=lambda row: row[0])
    return sorted(numbers), rows


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
