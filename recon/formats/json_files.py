"""Reads JSON of other programs: one file per frame, or one file with all frames."""

import gc
import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import FRAME_NUMBER, JSON, PERSON, Limit
from recon.formats.opening import files_of
from recon.formats.texts import decoded_text, read_bytes

Frames = list[tuple[int, Any]]
"""Pairs of frame number, increasing, and the parsed JSON of that frame."""

_ENTRIES = Limit(
    "number of entries in JSON, where a list counts as two more and a dictionary as six", 0.0,
    1.2e7, "", "each takes fifty bytes in memory: cut the recording",
)  # fmt: skip
_JSON_FRAMES = Limit(
    "number of frames in a JSON file", 0.0, 1e6, "", "nine hours at 30 Hz: cut the recording"
)
_NUMBER_KEYS = ("frame_id", "frame", "frame_number", "frame_index", "frame_idx")
_SEARCHED = 200
"""Characters at the end of a file name in which the frame number is searched."""
_LAST_NUMBER = re.compile(r"(\d+)\D*$")


def read_json(path: Path) -> Any:
    """Read the value of a JSON file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty or damaged.
    """
    return parsed_json(path, read_bytes(path, JSON))


def parsed_json(path: Path, data: bytes) -> Any:
    """Parse the bytes of a JSON file.

    Raises:
        ValueError: when it is damaged or its parsed contents would not fit into memory.
    """
    _check_sizes([data], path)
    return _parsed(path, data)


def _check_sizes(parts: Sequence[bytes], source: Path) -> None:
    """Refuse JSON whose parsed contents would not fit into memory."""
    # text that is not ASCII usually takes two bytes per character in Python's memory
    JSON.check(sum(len(one) * (1 if one.isascii() else 2) for one in parts), source)
    sizes = ((b"[", 2), (b"null", 2), (b"{", 6), (b",", 1))
    _ENTRIES.check(sum(size * one.count(mark) for one in parts for mark, size in sizes), source)


def _parsed(path: Path, data: bytes) -> Any:
    # garbage collection would take most of the time, and JSON makes no reference cycles
    collects = gc.isenabled()
    gc.disable()
    try:
        return json.loads(decoded_text(data))
    except (RecursionError, ValueError) as error:
        # an error whose text already names the file is raised as it is
        if str(path) in str(error):
            raise
        broken = error if isinstance(error, json.JSONDecodeError) else None
        lines = broken and broken.msg == "Extra data" and broken.doc[broken.pos] in "[{"
        content = (
            "one value, but several follow each other: save each in its own file, or all in a list"
            if lines
            else "JSON, but it is damaged"
        )
        raise FormatError(f"{path}: expected {content} ({error})") from error
    finally:
        if collects:
            gc.enable()


def read_frame_folder(folder: Path) -> Frames:
    """Read the .json files of a folder, keyed by frame number.

    Raises:
        ValueError: when there are none, one is damaged, or their names do not number them.
    """
    paths = files_of(folder, (".json",))
    if len(paths) == 0:
        raise FormatError(f"{folder}: expected one .json file per frame, found none")
    JSON.check(sum(path.stat().st_size for path in paths), folder)
    numbers = frame_numbers([path.stem for path in paths], str(folder))
    found = [read_bytes(path, JSON) for path in paths]
    _check_sizes(found, folder)
    order = np.argsort(numbers, kind="stable").tolist()
    return [(numbers[k], _parsed(paths[k], found[k])) for k in order]


def frame_numbers(stems: Sequence[str], name: str) -> list[int]:
    """Return each file's frame number: the last number in its name that differs between names.

    Raises:
        ValueError: when a name has no number, or two have the same.
    """
    found = last_numbers(stems)
    if without := [stem for stem, number in zip(stems, found, strict=True) if number is None]:
        raise FormatError(
            f"{name}: expected a frame number in every file name, not {without[0]!r}"
        )
    numbers = [number for number in found if number is not None]
    FRAME_NUMBER.check(max(numbers), name)
    if len(set(numbers)) < len(numbers):
        twice = Counter(numbers).most_common(1)[0][0]
        same = [stem for stem, number in zip(stems, numbers, strict=True) if number == twice][:2]
        raise FormatError(
            f"{name}: expected one file per frame, but {' and '.join(same)} are both frame "
            f"{twice}; give each camera's files in a folder of their own (`recon register` finds "
            "where depth cameras stand)"
        )
    return numbers


def last_numbers(stems: Sequence[str]) -> list[int | None]:
    """Return the last number in each file's name, before an ending that all names share."""
    cut = 0 if len(stems) == 1 else len(_common_ending(stems).lstrip("0123456789"))
    found = [_LAST_NUMBER.search(stem[: len(stem) - cut][-_SEARCHED:]) for stem in stems]
    return [None if number is None else int(number[1]) for number in found]


def _common_ending(stems: Sequence[str]) -> str:
    length = 0
    for letters in zip(*(reversed(stem) for stem in stems), strict=False):
        if len(set(letters)) > 1:
            break
        length += 1
    return stems[0][len(stems[0]) - length :]


def listed_frames(entries: Sequence[Any], name: str) -> Frames:
    """Sort entries by the frame numbers that they state, or number them by position.

    Raises:
        ValueError: when only some entries state a number, or two state the same.
    """
    _JSON_FRAMES.check(len(entries), name)
    if strange := [one for one in entries if not isinstance(one, dict | list | None)]:
        raise FormatError(
            f"{name}: expected each frame as an object or a list, got {strange[0]!r:.40}"
        )
    stated = [_stated_frame_number(entry) for entry in entries]
    if all(number is None for number in stated):
        return list(enumerate(entries))
    numbers = [number for number in stated if number is not None]
    FRAME_NUMBER.check(max(numbers), name)
    if len(numbers) < len(entries) or len(set(numbers)) < len(numbers):
        raise FormatError(f"{name}: expected one entry per frame, each with its own frame number")
    return sorted(zip(numbers, entries, strict=True), key=lambda pair: pair[0])


def _stated_frame_number(entry: Any) -> int | None:
    if isinstance(entry, dict):
        for key in _NUMBER_KEYS:
            if isinstance(entry.get(key), int) and entry[key] >= 0:
                return entry[key]
    return None


def as_floats(value: Any, name: str) -> np.ndarray:
    """Convert nested lists of numbers to an array; null becomes NaN.

    Raises:
        ValueError: when they are no numbers, or rows have different lengths.
    """
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        text = repr(value)
        raise FormatError(
            f"{name}: expected numbers in rows of one length, got {text[:60]}"
        ) from error


def flat_points(value: Any, name: str) -> np.ndarray:
    """Return rows x, y, confidence of all keypoints, from a flat list or a list of triples.

    Raises:
        ValueError: when they are no triples.
    """
    numbers = as_floats(value, name)
    if numbers.size % 3 or numbers.ndim > 2 or (numbers.ndim == 2 and numbers.shape[1] != 3):
        raise FormatError(
            f"{name}: expected x, y, confidence of every keypoint, got {numbers.shape} numbers"
        )
    return numbers.reshape(-1, 3)


def as_identity(value: Any, name: str) -> int:
    """Parse a person's number, written as 7, [7], 7.0 or "7"; -1 if there is none.

    Raises:
        ValueError: when it is larger than any number of a person.
    """
    if isinstance(value, list):
        value = value[0] if len(value) == 1 else None
    try:
        number = int(value)
    except (TypeError, ValueError, OverflowError):
        return -1
    PERSON.check(max(number, -1), name, "number of the person")
    return max(number, -1)
