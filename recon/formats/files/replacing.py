"""Files that are replaced in one step, and what killed processes leave of them."""

import contextlib
import glob
import os
import platform
import re
import shutil
from collections.abc import Iterator
from pathlib import Path


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
        if not number.isdigit() or _runs(int(number)):
            continue
        if leftover.is_dir():
            shutil.rmtree(leftover, ignore_errors=True)
        else:
            leftover.unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Whether there is a process of this number."""
    if os.name == "nt":
        return True  # there, asking with signal 0 would end it
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
