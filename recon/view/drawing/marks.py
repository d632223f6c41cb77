"""Discs, rings and lines over a picture, smooth at their edges."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.view.show.colours import Colour

BITS = 4
"""Bits of a pixel's fractions that OpenCV draws with."""
FAR = 1e5
"""Pixels beyond which no line is drawn: OpenCV counts in whole numbers."""
THICKNESS = 2
"""Thickness of lines and rings, pixels."""

Image = Float[np.ndarray, "height width 3"]
Places = Float[np.ndarray, "marks 2"]


def draw_discs(
    image: Image,
    places: Places,
    radius: float,
    colour: Colour,
    opacity: Float[np.ndarray, " marks"] | None = None,
) -> None:
    """Filled discs; `opacity` is 1 where it is not given."""
    cover = np.zeros(image.shape[:2], np.uint8)
    for k, place in enumerate(places):
        if abs(place).max() < FAR:
            level = 255 if opacity is None else round(255 * float(opacity[k]))
            cv2.circle(cover, _fixed(place), round(radius * 2**BITS), level, -1, cv2.LINE_AA, BITS)
    _blend(image, cover, colour)


def draw_rings(image: Image, places: Places, radius: float, colour: Colour) -> None:
    """Circles."""
    cover = np.zeros(image.shape[:2], np.uint8)
    for place in places:
        if abs(place).max() < FAR:
            size = round(radius * 2**BITS)
            cv2.circle(cover, _fixed(place), size, 255, THICKNESS, cv2.LINE_AA, BITS)
    _blend(image, cover, colour)


def draw_segments(image: Image, starts: Places, ends: Places, colour: Colour) -> None:
    """Straight lines."""
    cover = np.zeros(image.shape[:2], np.uint8)
    for start, end in zip(starts, ends, strict=True):
        if max(abs(start).max(), abs(end).max()) < FAR:
            cv2.line(cover, _fixed(start), _fixed(end), 255, THICKNESS, cv2.LINE_AA, BITS)
    _blend(image, cover, colour)


def _fixed(place: Float[np.ndarray, "2"]) -> tuple[int, int]:
    """OpenCV's fixed point; its first pixel has its centre at 0, ours at 0.5."""
    x, y = np.round((place - 0.5) * 2**BITS)
    return int(x), int(y)


def _blend(image: Image, cover: UInt8[np.ndarray, "height width"], colour: Colour) -> None:
    rows, columns = np.nonzero(cover)
    share = cover[rows, columns, None] / np.float32(255)
    image[rows, columns] += share * (np.array(colour, np.float32) - image[rows, columns])
