"""Reads the focal length that a phone wrote into its film.

Apple's phones state the focal length of the lens that would show as much on 35 mm film, in a
metadata item of the film or of its track of pictures ("Metadata atom" of the QuickTime File
Format). FFmpeg does not show those of tracks.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from recon.core.limits import FILM_FOCAL_LENGTH

_KEY = b"com.apple.quicktime.camera.focal_length.35mm_equivalent"
_MAX_INDEX = 1 << 26
"""Largest index of a film (box `moov`) that is read, bytes; that of hours has some millions."""
_MAX_BOXES = 10_000
"""Most boxes of a file that are looked at."""
_HOLDERS = {b"trak", b"udta", b"meta"}
"""Kinds of boxes in an index that hold metadata, directly or in boxes of these kinds."""
_TEXT, _NUMBERS = 1, {21: "i", 22: "u", 23: "f", 24: "f", 65: "i", 66: "i", 67: "i",
                      74: "i", 75: "u", 76: "u", 77: "u", 78: "u"}  # fmt: skip
"""Apple's well-known types of values: text in UTF-8, and big-endian numbers."""


def stated_focal_length(path: Path) -> tuple[float | None, str]:
    """Return the focal length (mm, for 35 mm film) that a film states, or None; and a note.

    The note is empty where the film states none, or is not in QuickTime or MP4 format; else it
    tells the value, or why it is not used.
    """
    with path.open("rb") as file:
        values = [
            one
            for index in _contents_of_moov(file)
            for one in _focal_length_values(index, 0, len(index), depth=0)
        ]
    if not values:
        return None, ""
    numbers = {_number_of_metadata(kind, raw) for kind, raw in values}
    if len(numbers) == 1 and (focal := numbers.pop()) is not None:
        if FILM_FOCAL_LENGTH.holds(focal):
            return focal, f"the camera states a focal length of {focal:.4g} mm for 35 mm film"
        return None, (
            f"the camera states a focal length of {focal:.4g} mm for 35 mm film, which no lens "
            "has that films people: it is not used"
        )
    return None, "the camera states a focal length that cannot be read, or several: it is not used"


def _contents_of_moov(file: BinaryIO) -> Iterator[bytes]:
    """Yield the contents of the indices (boxes `moov`) of a QuickTime or MP4 file."""
    for _ in range(_MAX_BOXES):
        header = file.read(8)
        if len(header) < 8:
            return
        size, kind = struct.unpack(">I4s", header)
        if size == 1:
            longer = file.read(8)
            size = int.from_bytes(longer) - 8 if len(longer) == 8 else 0
        if kind == b"moov" and 8 <= size <= _MAX_INDEX:
            yield file.read(size - 8)
        elif size >= 8:
            file.seek(size - 8, 1)
        else:  # the last box, whose size is left out, or bytes that are no box
            return


def _boxes(data: bytes, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield the kind, and first and end byte of the content, of each box in part of an index."""
    for _ in range(_MAX_BOXES):
        if start + 8 > end:
            return
        size = int.from_bytes(data[start : start + 4])
        if size < 8 or start + size > end:
            return
        yield data[start + 4 : start + 8], start + 8, start + size
        start += size


def _focal_length_values(
    data: bytes, start: int, end: int, *, depth: int
) -> Iterator[tuple[int, bytes]]:
    """Yield the type and bytes of each focal length that is stated in part of an index."""
    boxes = list(_boxes(data, start, end))
    spans = {kind: (first, last) for kind, first, last in boxes}
    if {b"keys", b"ilst"} <= spans.keys():
        yield from _focal_length_items(data, spans[b"keys"], spans[b"ilst"])
    for kind, first, last in boxes:
        if kind in _HOLDERS and depth < len(_HOLDERS):
            # ISO's `meta` begins with a version, QuickTime's does not
            iso = kind == b"meta" and data[first : first + 4] == bytes(4)
            yield from _focal_length_values(data, first + 4 * iso, last, depth=depth + 1)


def _focal_length_items(
    data: bytes, keys: tuple[int, int], items: tuple[int, int]
) -> Iterator[tuple[int, bytes]]:
    """Yield the type and bytes of each metadata item whose key is the focal length's."""
    names = [data[first:last] for _, first, last in _boxes(data, keys[0] + 8, keys[1])]
    for number, first, last in _boxes(data, *items):
        place = int.from_bytes(number)
        if not 1 <= place <= len(names) or names[place - 1] != _KEY:
            continue
        for kind, start, end in _boxes(data, first, last):
            if kind == b"data" and end - start > 8:
                yield int.from_bytes(data[start : start + 4]), data[start + 8 : end]


def _number_of_metadata(kind: int, raw: bytes) -> float | None:
    """Decode a metadata value as a number; return None if it is not a number."""
    try:
        if kind == _TEXT:
            return float(raw.decode().strip("\0 ").removesuffix("mm"))
        number_type = _NUMBERS.get(kind)
        if number_type == "f":
            return float(struct.unpack(">f" if len(raw) == 4 else ">d", raw)[0])
        if number_type is not None and len(raw) <= 8:
            return float(int.from_bytes(raw, signed=number_type == "i"))
    except (ValueError, struct.error):
        pass
    return None
