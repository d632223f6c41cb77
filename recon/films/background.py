"""Follows points of the background through a film, and detects a moving camera.

Corners (Harris and Stephens 1988), not edges, along which a point may slide, are followed by
pyramidal Lucas-Kanade flow in small grey images, and back again: a point that does not return to
where it was is lost. What lies on people is left out afterwards, when people are known.
"""

from dataclasses import dataclass, field
from typing import Any, cast

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from recon.detections.records import Background, Detections

_LONGEST_SIDE = 480
"""Longer side (pixels) to which images are reduced before points are followed."""
_MOST_POINTS, _FEWEST_POINTS = 120, 90
"""Most points followed at once, and number of points below which new ones are detected."""
_APART = 12
"""Least distance (pixels of the reduced image) of a newly detected point from all others."""
_CORNER, _CORNER_BLOCK, _CORNER_SHAPE = 0.001, 9, 0.1
"""Least corner strength as a share of the strongest, side (pixels) of its neighbourhood, and
Harris' k, which refuses structure tensors whose eigenvalues differ by more than about 8 times."""
_WINDOW, _LEVELS = (15, 15), 3
_MOST_RETURN_ERROR = 0.5
"""Largest error (pixels) of a point that is followed into the next image and back again."""
_BOX_MARGIN = 0.12
"""Margin around the box of a person's keypoints, over its longer side, for hair and clothes."""
_FEWEST_BEHIND = 8
"""Fewest background points per picture, and fewest long tracks, that tell of a camera's motion."""
_LONG_TRACK = 10
"""Fewest pictures of a point's track that tells whether the camera moves."""
_STILL_EXTENT = 0.006
"""Largest extent of a point's track before a still camera, over the image's longer side."""
_MOVING_SHARE = 0.7
"""Least share of the long tracks that exceed `_STILL_EXTENT` where the camera moves; those on
people who were not found, on shadows and on cars are fewer."""


@dataclass
class FollowedPoints:
    """Background points that are followed from picture to picture of a film."""

    frames: list[Int[np.ndarray, " points"]] = field(default_factory=list)
    numbers: list[Int[np.ndarray, " points"]] = field(default_factory=list)
    pixels: list[Float[np.ndarray, "points 2"]] = field(default_factory=list)
    """Positions in the images as they were given; each of the lists has one array per picture."""
    _grey: UInt8[np.ndarray, "height width"] | None = None
    _shot: int = -1
    _next: int = 0

    def follow(self, image: UInt8[np.ndarray, "height width 3"], frame: int, shot: int) -> None:
        """Follow the points into the next picture, and detect new ones; begin anew at a cut."""
        scale = max(1.0, max(image.shape[:2]) / _LONGEST_SIDE)
        size = tuple(max(1, round(side / scale)) for side in image.shape[1::-1])
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
        places, numbers = np.zeros((0, 2), np.float32), np.zeros(0, np.int64)
        if self.pixels and shot == self._shot and len(self.pixels[-1]) > 0:
            before = ((self.pixels[-1] + 0.5) / scale - 0.5).astype(np.float32)
            places, kept = self._tracked_into(grey, before)
            places, numbers = places[kept], self.numbers[-1][kept]
        if len(places) < _FEWEST_POINTS:
            fresh = _new_corners(grey, places)
            places = np.concatenate((places, fresh))
            numbers = np.concatenate((numbers, self._next + np.arange(len(fresh))))
            self._next += len(fresh)
        self._grey, self._shot = grey, shot
        self.frames.append(np.full(len(places), frame))
        self.numbers.append(numbers)
        self.pixels.append((places.astype(np.float64) + 0.5) * scale - 0.5)

    def _tracked_into(
        self, grey: UInt8[np.ndarray, "height width"], before: Float[np.ndarray, "points 2"]
    ) -> tuple[Float[np.ndarray, "points 2"], np.ndarray]:
        """Return positions in the next image, and which points lead back to where they began."""
        there, found, _ = _optical_flow(self._grey, grey, before)
        back, again, _ = _optical_flow(grey, self._grey, there)
        inside = ((there >= 0) & (there < grey.shape[::-1])).all(-1)
        returned = np.linalg.norm(back - before, axis=-1) < _MOST_RETURN_ERROR
        return there, (found[:, 0] > 0) & (again[:, 0] > 0) & inside & returned


def _optical_flow(image: Any, next_image: Any, places: np.ndarray) -> Any:
    return cv2.calcOpticalFlowPyrLK(
        image, next_image, places, cast(Any, None), winSize=_WINDOW, maxLevel=_LEVELS
    )


def _new_corners(
    grey: UInt8[np.ndarray, "height width"], places: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "corners 2"]:
    """Detect corners (pixels) of an image that are not close to points already followed."""
    free = np.full(grey.shape, 255, np.uint8)
    for x, y in places.round().astype(int).tolist():
        cv2.circle(free, (x, y), _APART, 0, -1)
    found = cv2.goodFeaturesToTrack(
        grey, _MOST_POINTS - len(places), _CORNER, _APART, mask=free, blockSize=_CORNER_BLOCK,
        useHarrisDetector=True, k=_CORNER_SHAPE,
    )  # fmt: skip
    return np.zeros((0, 2), np.float32) if found is None else found[:, 0]


def points_if_camera_moves(seen: Background, people: Detections) -> tuple[Background | None, str]:
    """Return points of the background if the camera moves, else None; and a note or "".

    The note says that there are too few points to tell; the camera then counts as still.

    Args:
        seen: all followed points, pixels of the film.
        people: everybody in the film, whose points are left out; with the size of its images.
    """
    assert people.image_size is not None
    outside = _without_people(seen, people)
    pictures = len(people.frame_numbers)
    if len(outside.frame) < _FEWEST_BEHIND * pictures:
        return None, (
            f"{len(outside.frame) / pictures:.0f} points of the background in a picture are too "
            "few to tell whether the camera moves: it is taken as standing still"
        )
    count = np.bincount(outside.point)
    low, high = np.full((len(count), 2), np.inf), np.full((len(count), 2), -np.inf)
    np.minimum.at(low, outside.point, outside.pixels)
    np.maximum.at(high, outside.point, outside.pixels)
    extent = np.linalg.norm(high - low, axis=-1)[count >= _LONG_TRACK]
    moved = extent > _STILL_EXTENT * max(people.image_size)
    moves = len(moved) >= _FEWEST_BEHIND and moved.mean() > _MOVING_SHARE
    return (outside if moves else None), ""


def _without_people(followed: Background, people: Detections) -> Background:
    """Drop points in people's boxes; a point that comes out of a box gets a new number."""
    order = np.lexsort((followed.frame, followed.point))
    frame, point, pixels = followed.frame[order], followed.point[order], followed.pixels[order]
    covered = np.zeros(len(frame), bool)
    by_frame = np.argsort(frame, kind="stable")
    for number, person, sure in zip(people.frame, people.pixels, people.confidence, strict=True):
        if not (sure > 0).any():
            continue
        low, high = person[sure > 0].min(0), person[sure > 0].max(0)
        margin = _BOX_MARGIN * (high - low).max()
        rows = by_frame[slice(*np.searchsorted(frame[by_frame], (number, number + 1)))]
        covered[rows] |= ((pixels[rows] > low - margin) & (pixels[rows] < high + margin)).all(1)
    parts = np.stack((point, np.cumsum(covered)))[:, ~covered]
    again = np.unique(parts, axis=1, return_inverse=True)[1].ravel()
    return Background(frame[~covered], again, pixels[~covered])
