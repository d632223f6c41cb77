"""Draws words, dots and legends on pictures, and joins pictures to sheets."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from recon.core.visible import visible
from recon.formats.replacing import replacing
from recon.view.scene import FAINT, INK, Colour

Picture = UInt8[np.ndarray, "_ _ 3"]

PAPER = 255
REGULAR, BOLD = 400, 650
"""Weights of the letters."""
GAP_PX = 4
"""Width of the gaps between joined pictures, pixels."""
FRACTION_BITS = 4
"""Number of fractional bits in the fixed-point positions with which OpenCV draws."""
FARTHEST_PX = 1e5
"""Largest coordinate that is drawn, pixels: OpenCV stores positions as 32-bit integers."""


def draw_dots(
    picture: Picture,
    places: Float[np.ndarray, "dots 2"],
    radius: float,
    colour: Colour,
    thickness: int = -1,
) -> None:
    """Draw discs or, with a thickness, rings; the first pixel's centre is at 0.5."""
    near = places[np.abs(places).max(1) < FARTHEST_PX]
    size = round(radius * 2**FRACTION_BITS)
    for x, y in fixed_point(near).tolist():
        cv2.circle(picture, (x, y), size, colour, thickness, cv2.LINE_AA, FRACTION_BITS)


def fixed_point(places: Float[np.ndarray, "*n 2"]) -> np.ndarray:
    """Convert pixels to OpenCV's fixed-point numbers, where the first pixel's centre is at 0."""
    return np.round((places - 0.5) * 2**FRACTION_BITS).astype(np.int32)


def save_picture(path: Path, picture: Picture) -> None:
    """Write a PNG file at compression level 4; level 9 takes 12 times as long for 6 % less.

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    with replacing(path) as scratch:
        written, data = cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 4])
        if not written:
            raise ValueError(f"could not encode a picture of shape {picture.shape} as PNG")
        scratch.write_bytes(data.tobytes())


def text_size(size: tuple[int, int]) -> int:
    """Return the height of letters, pixels, for a picture of a given width and height."""
    return min(max(10, min(size) // 26), 24)


def join(pictures: list[Picture], axis: int) -> Picture:
    """Join pictures along an axis with thin gaps; smaller ones are padded with white."""
    longest = max(picture.shape[1 - axis] for picture in pictures)
    parts: list[Picture] = []
    for picture in pictures:
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[axis] = (GAP_PX if parts else 0, 0)
        pad[1 - axis] = (0, longest - picture.shape[1 - axis])
        parts.append(np.pad(picture, pad, constant_values=PAPER))
    return np.concatenate(parts, axis)


def with_legend(picture: Picture, entries: Iterable[tuple[str, Colour]], text: int) -> Picture:
    """Add a legend below a picture: coloured discs with words, on several lines.

    Args:
        picture: the picture to explain.
        entries: words and their colours; repeated entries are written once.
        text: height of the letters, pixels.
    """
    width, x, line = picture.shape[1], text, 0
    placed: list[tuple[str, Colour, int, int]] = []
    for word, colour in dict.fromkeys(entries):
        wide = line_width(word, text) + text * 17 // 6
        if x > text and x + wide > width:
            x, line = text, line + 1
        placed.append((word, colour, x, text * (2 * line + 2) - text // 6))
        x += wide
    strip = np.full((text * (2 * line + 3), width, 3), PAPER, np.uint8)
    for word, colour, x, baseline in placed:
        centre = np.array([[x + 0.42 * text, baseline - 0.34 * text]]) + 0.5
        draw_dots(strip, centre, 0.42 * text, colour)
        write_line(strip, word, (x + text * 4 // 3, baseline), text)
    return np.concatenate([picture, strip])


def write_line(
    picture: Picture,
    words: str,
    place: tuple[int, int],
    text: int,
    weight: int = REGULAR,
    colour: Colour = FAINT,
) -> None:
    """Write one line of text whose baseline starts at `place`."""
    # OpenCV would abort the process at invalid Unicode, which file names may contain
    cv2.putText(picture, visible(words), place, colour, cv2.FontFace("sans"), text, weight)


def lighten_corners(picture: Picture, title: str, label: str) -> None:
    """Lighten a picture where a title and a label in the lower right corner will stand."""
    height, width = picture.shape[:2]
    text = text_size((width, height))
    wide = [line_width(words, text * 5 // 4) + 2 * text for words in (title, label)]
    for part in (picture[: 9 * text // 4, : wide[0]], picture[-2 * text :, -wide[1] :]):
        part[:] = cv2.addWeighted(part, 0.25, np.full_like(part, PAPER), 0.75, 0)


def write_title(picture: Picture, title: str) -> None:
    """Write a title into the upper left corner."""
    height, width = picture.shape[:2]
    text = text_size((width, height))
    write_line(picture, title, (text // 2, 3 * text // 2), text * 5 // 4, BOLD, INK)


def write_corner_label(picture: Picture, words: str) -> None:
    """Write one line of text into the lower right corner."""
    height, width = picture.shape[:2]
    text = text_size((width, height))
    place = (width - text // 2 - line_width(words, text), height - text // 2)
    write_line(picture, words, place, text)


def line_width(words: str, text: int) -> int:
    """Return the width of a line of text, pixels, with letters `text` pixels high."""
    return cv2.getTextSize((0, 0), visible(words), (0, 0), cv2.FontFace("sans"), text, REGULAR)[2]
