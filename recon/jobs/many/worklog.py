"""The log of a long work: one JSON object per line, appended as each part of it ends.

A line is written whole or, where the process was killed in it, is cut off when the log is opened
again. The last line of an id is what counts. Only one process at a time may write to a log.
"""

import contextlib
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Record = dict[str, Any]


@dataclass(frozen=True)
class WorkLog:
    """An open log."""

    path: Path
    descriptor: int
    records: dict[str, Record] = field(default_factory=dict)
    """The last record of every id."""

    def append(self, record: Record) -> None:
        """Write a record, whose `id` names what it is about, as one line.

        One that says the same as the last of its id but for its `seconds` is not written again.

        Raises:
            OSError: when it cannot be written.
        """
        if _without_time(record) == _without_time(self.records.get(record["id"], {})):
            return
        line = (json.dumps(record) + "\n").encode()
        end = os.fstat(self.descriptor).st_size
        try:
            written = os.write(self.descriptor, line)
        except OSError:
            os.ftruncate(self.descriptor, end)
            raise
        if written < len(line):
            os.ftruncate(self.descriptor, end)
            raise OSError(f"{self.path}: a line could not be written whole; is the disk full?")
        self.records[record["id"]] = record


@contextlib.contextmanager
def open_log(path: Path) -> Iterator[WorkLog]:
    """A log to read and to append to, held against other writers until the block ends.

    Raises:
        ValueError: when another process holds it.
        OSError: when it cannot be opened or written.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        _hold(descriptor, path)
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.ftruncate(descriptor, whole)
        yield WorkLog(path, descriptor, _records(data[:whole]))
    finally:
        os.close(descriptor)


def read_log(path: Path) -> dict[str, Record]:
    """The last record of every id of a log that somebody else may be writing to."""
    data = path.read_bytes() if path.is_file() else b""
    return _records(data[: data.rfind(b"\n") + 1])


def _records(data: bytes) -> dict[str, Record]:
    records: dict[str, Record] = {}
    for line in data.split(b"\n"):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(row, dict) and isinstance(row.get("id"), str):
            records[row["id"]] = row
    return records


def _without_time(record: Record) -> Record:
    return {key: value for key, value in record.items() if key != "seconds"}


def _hold(descriptor: int, path: Path) -> None:
    """Lock the file until it is closed, which a killed process does too."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ValueError(
            f"{path}: another run is writing to it; wait for its end, or give another OUT"
        ) from error
