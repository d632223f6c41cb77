"""AlphaPose's JSON: one flat list of people, each with the name of its image."""

from pathlib import PurePath
from typing import Any

import numpy as np

from recon.formats.detections.records import Row
from recon.formats.files.json_files import as_identity, flat_points, frame_numbers

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
