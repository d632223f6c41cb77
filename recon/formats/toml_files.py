"""TOML files of users, read in time linear in their length."""

import re
import tomllib
from pathlib import Path
from typing import Any

from recon.core.errors import FormatError
from recon.core.limits import CALIBRATION
from recon.formats.opening import decode, read_bytes

_DEEP_KEY = re.compile(r"(?<![\w\"'-])(?:[\w\"'-]+[ \t]*\.[ \t]*){20}")
"""A dotted key of more than twenty parts, for which tomllib takes the square of its length."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables and values of a file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, damaged, too large, or has keys of twenty parts or more.
    """
    text = decode(read_bytes(path, CALIBRATION))
    if _DEEP_KEY.search(text):
        raise FormatError(f"{path}: expected plain names, got a key of 20 parts or more")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # ValueError is also raised by numbers with more digits than Python converts
        raise FormatError(f"{path}: expected TOML, but it is damaged ({error})") from error
