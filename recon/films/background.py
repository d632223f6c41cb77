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
"""Pixels to which images are reduced."""
_MOST_POINTS, _FEWEST_POINTS = 120, 90
"""Points that are followed at once, and number below which new ones are looked for."""
_APART = 12
"""Pixels between two points."""
_CORNER, _CORNER_BLOCK, _CORNER_SHAPE = 0.001, 9, 0.1
"""Least strength of a corner as a share of the strongest, pixels of its neighbourhood, and Harris'
k, which refuses structure tensors whose eigenvalues differ by a factor above about 8."""
_WINDOW, _LEVELS = (15, 15), 3
_RETURN = 0.5
"""Pixels by which a point that is followed there and back may be off."""
_AROUND = 0.12
"""Share of a person's larger side by which their box is widened: hair, clothes, hands."""
_FEWEST_BEHIND = 8
"""Points of the background in most pictures without which nothing is told."""
_LONG = 10
"""Pictures through which a point is followed that tells whether the camera moves."""
_STAYS = 0.006
"""Share of the image's longer side within which the background of a still camera stays."""
_MOST_MOVE = 0.7
"""Share of the long followed points that leave their place where the camera moves; people who were
not found, shadows and cars are fewer."""


@dataclass
class FollowedPoints:
    """Points that are followed from picture to picture of a film."""

    frames: list[Int[np.ndarray, " points"]] = field(default_factory=list)
    numbers: list[Int[np.ndarray, " points"]] = field(default_factory=list)
    pixels: list[Float[np.ndarray, "points 2"]] = field(default_factory=list)
    """Of the images as they were given; a list has an item for every picture."""
    _grey: UInt8[np.ndarray, "height width"] | None = None
    _shot: int = -1
    _next: int = 0

    def step(self, image: UInt8[np.ndarray, "height width 3"], frame: int, shot: int) -> None:
        """Follow the points into the next picture; nothing is followed across a cut."""
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
            fresh = _corners(grey, places)
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
        """Places of the points in the next image, and which of them are found."""
        there, found, _ = _optical_flow(self._grey, grey, before)
        back, again, _ = _optical_flow(grey, self._grey, there)
        inside = ((there >= 0) & (there < grey.shape[::-1])).all(-1)
        returned = np.linalg.norm(back - before, axis=-1) < _RETURN
        return there, (found[:, 0] > 0) & (again[:, 0] > 0) & inside & returned


def _optical_flow(one: Any, other: Any, places: np.ndarray) -> Any:
    return cv2.calcOpticalFlowPyrLK(
        one, other, places, cast(Any, None), winSize=_WINDOW, maxLevel=_LEVELS
    )


def _corners(
    grey: UInt8[np.ndarray, "height width"], places: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "corners 2"]:
    """Corners of an image away from these places."""
    free = np.full(grey.shape, 255, np.uint8)
    for x, y in places.round().astype(int).tolist():
        cv2.circle(free, (x, y), _APART, 0, -1)
    found = cv2.goodFeaturesToTrack(
        grey, _MOST_POINTS - len(places), _CORNER, _APART, mask=free, blockSize=_CORNER_BLOCK,
        useHarrisDetector=True, k=_CORNER_SHAPE,
    )  # fmt: skip
    return np.zeros((0, 2), np.float32) if found is None else found[:, 0]


def moving_background(seen: Background, people: Detections) -> tuple[Background | None, str]:
    """The background behind the people of a film; None where the camera stands still.

    Also a note, where too few points tell; the camera is taken as standing still then.

    Args:
        seen: all followed points, pixels of the film.
        people: of the film, whose image size is known.
    """
    assert people.image_size is not None
    behind = _without_people(seen, people)
    pictures = len(people.frame_numbers)
    if len(behind.frame) < _FEWEST_BEHIND * pictures:
        return None, (
            f"{len(behind.frame) / pictures:.0f} points of the background in a picture are too "
            "few to tell whether the camera moves: it is taken as standing still"
        )
    count = np.bincount(behind.point)
    low, high = np.full((len(count), 2), np.inf), np.full((len(count), 2), -np.inf)
    np.minimum.at(low, behind.point, behind.pixels)
    np.maximum.at(high, behind.point, behind.pixels)
    extent = np.linalg.norm(high - low, axis=-1)[count >= _LONG]
    moved = extent > _STAYS * max(people.image_size)
    moves = len(moved) >= _FEWEST_BEHIND and moved.mean() > _MOST_MOVE
    return (behind if moves else None), ""


def _without_people(seen: Background, people: Detections) -> Background:
    """Points outside everybody's box; a point that a person covered gets a new number after it."""
    order = np.lexsort((seen.frame, seen.point))
    frame, point, pixels = seen.frame[order], seen.point[order], seen.pixels[order]
    covered = np.zeros(len(frame), bool)
    by_frame = np.argsort(frame, kind="stable")
    for number, person, sure in zip(people.frame, people.pixels, people.confidence, strict=True):
        if not (sure > 0).any():
            continue
        low, high = person[sure > 0].min(0), person[sure > 0].max(0)
        wide = _AROUND * (high - low).max()
        rows = by_frame[slice(*np.searchsorted(frame[by_frame], (number, number + 1)))]
        covered[rows] |= ((pixels[rows] > low - wide) & (pixels[rows] < high + wide)).all(1)
    parts = np.stack((point, np.cumsum(covered)))[:, ~covered]
    again = np.unique(parts, axis=1, return_inverse=True)[1].ravel()
    return Background(frame[~covered], again, pixels[~covered])
