"""Writes files and arrays atomically, and removes files that killed processes left."""

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
    """Context with a temporary path that replaces the target if the block succeeds.

    Where the target is a symbolic link, the file that it leads to is replaced and the link stays.

    Raises:
        FileNotFoundError: when the folder does not exist.
    """
    real_path = Path(os.path.realpath(path))
    if not real_path.parent.is_dir():
        raise FileNotFoundError(f"{real_path.parent}: no such folder; create it first")
    beside = temporary_path(real_path)
    try:
        yield beside
        os.replace(beside, real_path)
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically: a reader finds the former file or the whole new one.

    Raises:
        FileNotFoundError: when the folder does not exist.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


_HOST = re.sub(r"[^A-Za-z0-9]", "", platform.node())[:32]
"""Name of this machine: folders are shared between machines, each with its own process numbers."""


def temporary_path(path: Path) -> Path:
    """Return the hidden path beside a file at which this process prepares its replacement."""
    return path.with_name(f".{path.name}.{_HOST}-{os.getpid()}.part")


def clear_leftovers(path: Path) -> None:
    """Remove temporary files that killed processes of this machine left for a path.

    Files of processes that still run, or of other machines, stay.
    """
    path = Path(os.path.realpath(path))
    pattern = glob.escape(f".{path.name}.{_HOST}-") + "*.part"
    for leftover in path.parent.glob(pattern):
        number = leftover.name.removesuffix(".part").rpartition("-")[2]
        if not number.isdigit() or _is_running(int(number)):
            continue
        if leftover.is_dir():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)


def save_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write numpy arrays as an .npz file; readers see the old file or the whole new one."""
    import numpy as np  # imported only when arrays are written, so that other commands start fast

    clear_leftovers(path)
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]


def _is_running(process_id: int) -> bool:
    """Whether a process with this number is running."""
    if os.name == "nt":
        return True  # on Windows os.kill(process, 0) would end the process
    try:
        os.kill(process_id, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


MISSING = "missing"
"""Stands for the checksum of a file that does not exist."""


def file_checksum(path: str | Path) -> str:
    """Compute SHA-256 of a file's content in hexadecimal digits.

    Raises:
        OSError: when the file cannot be read; FileNotFoundError when there is none.
        ValueError: when the path is not a regular file; a pipe or device would never end.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: expected a file, got a folder, pipe or device")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_checksum(files: Iterable[Path], folder: Path) -> str:
    """Compute SHA-256 of the contents and relative names of files below a folder, in any order.

    Files that do not exist count as `MISSING`, so that the checksum changes when they appear.

    Raises:
        OSError, ValueError: as `file_checksum`, for a file that exists and cannot be read.
    """
    rows = sorted((file.relative_to(folder).as_posix(), file) for file in files)
    return value_checksum(
        [(name, file_checksum(file) if file.exists() else MISSING) for name, file in rows]
    )


def value_checksum(value: Mapping[str, Any] | list[Any]) -> str:
    """Compute SHA-256 of nested texts, numbers, lists and mappings, whatever the order of keys."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=True)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
