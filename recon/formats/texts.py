"""Reads text files, also xz-compressed ones, their numbers, and TOML."""

import lzma
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, CALIBRATION, TEXT, Limit
from recon.formats.opening import existing_file, limit_when_unpacked


def read_bytes(path: Path, limit: Limit = TEXT) -> bytes:
    """Read a file, decompressed if its name ends in .xz; `read_binary` allows larger ones.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, damaged or too large for memory.
    """
    existing_file(path)
    if path.suffix.lower() != ".xz":
        limit.check(path.stat().st_size, path)
        return path.read_bytes()
    most = limit_when_unpacked(path, min(limit, TEXT, key=lambda one: one.high))
    try:
        with lzma.open(path) as file:
            data = file.read(int(most.high) + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise FormatError(f"{path}: expected xz-compressed data, but {error}") from error
    most.check(len(data), path)
    return data


def read_binary(path: Path) -> bytes:
    """Read a file of binary numbers, which take no more memory than the file."""
    return read_bytes(path, BINARY)


def decoded_text(data: bytes) -> str:
    """Decode bytes as UTF-16 or 32 if they have its mark, else as UTF-8, else as Latin-1."""
    if data[:4] in (b"\xff\xfe\0\0", b"\0\0\xfe\xff"):
        return data.decode("utf-32", errors="replace")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def with_decimal_points(text: str, comma: re.Pattern[str]) -> str:
    """Replace commas by points if a text has decimal commas (`comma` matches) and no points."""
    if "," not in text or re.search(r"\d\.\d", text) or not comma.search(text):
        return text
    return text.replace(",", ".")


_PIECE = 1 << 20
"""Number of characters that are parsed at a time."""
_LONGEST = 1000
"""Most characters of a number."""


def parsed_numbers(text: str | bytes, count: int, start: int = 0) -> np.ndarray:
    """Parse `count` numbers, separated by white space, from a position to the text's end.

    Raises:
        ValueError: when there are more or fewer, or something is no number.
    """
    values, filled = np.empty(count), 0
    while start < len(text):
        end = start + _PIECE
        stop = min(end + _LONGEST, len(text))
        while end < stop and not text[end : end + 1].isspace():
            end += 1
        words = text[start:end].split()
        if filled + len(words) > count:
            raise FormatError(f"expected {count} numbers, got more")
        values[filled : filled + len(words)] = [float(word) for word in words]
        filled, start = filled + len(words), end
    if filled < count:
        raise FormatError(f"expected {count} numbers, got {filled}")
    return values


_DEEP_KEY = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]+[ \t]*\.[ \t]*){20}")
"""Matches a dotted key of more than twenty parts, which tomllib parses in quadratic time."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables and values of a TOML file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, damaged, too large, or has keys of twenty parts or more.
    """
    text = decoded_text(read_bytes(path, CALIBRATION))
    if _DEEP_KEY.search(text):
        raise FormatError(f"{path}: expected keys of fewer than 20 parts, got a longer one")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # ValueError is also raised by an integer with too many digits for Python
        raise FormatError(f"{path}: expected TOML, but it is damaged ({error})") from error
