"""Atomic writing of files and arrays, and removal of files that killed processes left."""

import contextlib
import glob
import hashlib
import json
import os
import platform
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside the target, moved onto it when the block ends well and removed when not.

    Where the target is a symbolic link, the file that it leads to is replaced and the link stays.

    Raises:
        FileNotFoundError: when the folder does not exist.
    """
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target.parent}: no such folder; create it first")
    beside = part_of(target)
    try:
        yield beside
        os.replace(beside, target)
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, in one step: a reader finds the former file or the whole new one.

    Raises:
        FileNotFoundError: when the folder does not exist.
    """
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")


_HOST = re.sub(r"[^A-Za-z0-9]", "", platform.node())[:32]
"""Name of this machine: folders are shared between machines, each with its own process numbers."""


def part_of(path: Path) -> Path:
    """The place where this process prepares what replaces a path: a hidden name beside it."""
    return path.with_name(f".{path.name}.{_HOST}-{os.getpid()}.part")


def clear_leftovers(path: Path) -> None:
    """Remove what killed processes of this machine had prepared for a path.

    What belongs to a process that still runs, or to another machine, stays.
    """
    path = Path(os.path.realpath(path))
    pattern = glob.escape(f".{path.name}.{_HOST}-") + "*.part"
    for leftover in path.parent.glob(pattern):
        number = leftover.name.removesuffix(".part").rpartition("-")[2]
        if not number.isdigit() or _process_runs(int(number)):
            continue
        if leftover.is_dir():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)


def save_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write numpy arrays as an .npz file; readers see the old file or the whole new one."""
    import numpy as np  # a command line that is refused need not wait for it

    clear_leftovers(path)
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]


def _process_runs(process: int) -> bool:
    """Whether there is a process of this number."""
    if os.name == "nt":
        return True  # on Windows os.kill would end the process
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


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
