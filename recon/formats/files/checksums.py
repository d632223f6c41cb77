"""SHA-256 of files and folders, streamed: memory stays small whatever their size.

Contents are hashed with names, never with dates or with the folders above: a recording that was
copied elsewhere keeps its checksum, and one changed byte gives another.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

MISSING = "missing"
"""Stands for the checksum of a file that does not exist."""


def file_checksum(path: str | Path) -> str:
    """SHA-256 of a file's content in hexadecimal digits.

    Raises:
        OSError: when the file cannot be read; FileNotFoundError when there is none.
        ValueError: when the path is not a regular file; a pipe or device would never end.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: expected a file to hash, got a folder, pipe or device")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_checksum(files: Iterable[Path], folder: Path) -> str:
    """SHA-256 of files below a folder, in the order of their relative names, names included.

    Files that do not exist count as `MISSING`, so that the checksum changes when they appear.

    Raises:
        OSError, ValueError: as `file_checksum`, for a file that exists and cannot be read.
    """
    rows = sorted((file.relative_to(folder).as_posix(), file) for file in files)
    return value_checksum(
        [(name, file_checksum(file) if file.exists() else MISSING) for name, file in rows]
    )


def value_checksum(value: Mapping[str, Any] | list[Any]) -> str:
    """SHA-256 of a value made of texts, numbers, lists and mappings; mappings have no order."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=True)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
