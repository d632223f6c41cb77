"""Words, legends and seams of sheets of pictures."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from recon.formats.files.opening import replacing
from recon.view.show.colours import FAINT, Colour

Picture = UInt8[np.ndarray, "_ _ 3"]

PAPER = 255
REGULAR, BOLD = 400, 650
GAP = 4
"""Pixels between pictures."""


def save_picture(path: Path, picture: Picture) -> None:
    """Write a PNG.

    Raises:
        FileNotFoundError: when the folder of `path` does not exist.
    """
    with replacing(path) as scratch:
        written, data = cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
        if not written:
            raise ValueError(f"could not encode a picture of shape {picture.shape} as PNG")
        scratch.write_bytes(data.tobytes())


def text_size(size: tuple[int, int]) -> int:
    """Height of the letters that suits a picture, pixels."""
    return min(max(10, min(size) // 26), 24)


def join(pictures: list[Picture], axis: int) -> Picture:
    """Side by side with a thin gap."""
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, PAPER, np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)][1:]
    return np.concatenate(parts, axis)


def legend_strip(entries: tuple[tuple[str, Colour], ...], width: int, text: int) -> Picture:
    """A white strip with as many lines as the entries need."""
    lines: list[list[tuple[str, Colour]]] = [[]]
    for entry in entries:
        if lines[-1] and _key_width((*lines[-1], entry), text) > width - text:
            lines.append([])
        lines[-1].append(entry)
    strip = np.full((text * (2 * len(lines) + 1), width, 3), PAPER, np.uint8)
    for k, line in enumerate(lines):
        _key(strip, tuple(line), text * (2 * k + 2) - text // 6, text)
    return strip


def _key(
    picture: Picture, entries: tuple[tuple[str, Colour], ...], baseline: int, text: int
) -> None:
    """Coloured discs with their words, along one line from the left."""
    x, radius = text, 0.42 * text
    for word, colour in entries:
        centre = (round((x + radius) * 16), round((baseline - 0.34 * text) * 16))
        cv2.circle(picture, centre, round(radius * 16), colour, -1, cv2.LINE_AA, shift=4)
        write_line(picture, word, (x + text * 4 // 3, baseline), text)
        x += _key_width(((word, colour),), text)


def _key_width(entries: tuple[tuple[str, Colour], ...], text: int) -> int:
    return sum(line_width(word, text) + text * 17 // 6 for word, _ in entries)


def write_line(
    picture: Picture,
    words: str,
    place: tuple[int, int],
    text: int,
    weight: int = REGULAR,
    colour: Colour = FAINT,
    right: bool = False,
) -> None:
    """Write one line whose baseline starts (or, with `right`, ends) at `place`."""
    start = (place[0] - line_width(words, text, weight) if right else place[0], place[1])
    cv2.putText(picture, words, start, colour, cv2.FontFace("sans"), text, weight)


def label(picture: Picture, words: str) -> None:
    """Write one line into the lower right corner."""
    height, width = picture.shape[:2]
    text = text_size((width, height))
    write_line(picture, words, (width - text // 2, height - text // 2), text, right=True)


def line_width(words: str, text: int, weight: int = REGULAR) -> int:
    """Width of a line in pixels, at `text` pixels high."""
    return cv2.getTextSize((0, 0), words, (0, 0), cv2.FontFace("sans"), text, weight)[2]
