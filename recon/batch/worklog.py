"""Reads manifests of batches (clips to fit, a JSON object per line), and keeps their logs."""

import contextlib
import hashlib
import json
import os
import sys
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from recon.fitting.settings import FitSettings
from recon.formats.opening import files_of
from recon.formats.producers import FILMS

_EXPECTED = '{"id": "clip", "observations": ["clip.npz"]}'


@dataclass(frozen=True)
class BatchClip:
    """A clip to fit: one line of a manifest."""

    name: str
    observations: tuple[Path, ...]
    subject: str | None = None
    """The person who moves; clips of one subject share one shape. None: nobody was named."""


def read_manifest(path: Path) -> tuple[BatchClip, ...]:
    """Read a manifest: a JSON object per line, {"id": ..., "observations": [...]}.

    Each may have a `subject`, whose clips share one shape. Paths are relative to the manifest.
    Of a folder every film is a clip, named as the film without its ending.

    Raises:
        FileNotFoundError: when there is no such manifest.
        ValueError: when a line is not such an object or an id occurs twice; it is named.
    """
    if path.is_dir():
        return _films_in(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such manifest")
    try:
        # splitlines would also split at characters that JSON allows inside texts
        lines = path.read_text(encoding="utf-8-sig").split("\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected text in UTF-8, but {error}") from error
    clips: dict[str, tuple[int, BatchClip]] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        clip = _parsed_clip(line, path, number)
        # many file systems do not distinguish ids that differ only in case
        same = unicodedata.normalize("NFC", clip.name).casefold()
        if same in clips:
            before, other = clips[same]
            raise ValueError(
                f"{path}: expected different ids, but {other.name!r} in line {before} and "
                f"{clip.name!r} in line {number} would be written to one file; rename one"
            )
        clips[same] = number, clip
    if not clips:
        raise ValueError(f"{path}: expected {_EXPECTED} in a line for each clip, got no line")
    return tuple(clip for _, clip in clips.values())


def _films_in(folder: Path) -> tuple[BatchClip, ...]:
    """Return every film in a folder as a clip that is named after its file."""
    films = files_of(folder, FILMS)
    if not films:
        raise ValueError(
            f"{folder}: expected films in this folder ({', '.join(FILMS[:4])}, ...), or a file "
            f"with a line {_EXPECTED} per clip"
        )
    same = Counter(film.stem.casefold() for film in films)
    return tuple(
        BatchClip(film.stem if same[film.stem.casefold()] == 1 else film.name, (film,))
        for film in films
    )


def _parsed_clip(line: str, path: Path, number: int) -> BatchClip:
    """Parse the clip in one line of a manifest."""
    where = f"{path}, line {number}"
    try:
        row = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where}: expected {_EXPECTED}, got {line[:80]!r} ({error})") from error
    if not isinstance(row, dict) or not {"id", "observations"} <= row.keys():
        raise ValueError(f"{where}: expected {_EXPECTED}, got {line[:80]!r}")
    name, files = row["id"], row["observations"]
    if isinstance(name, int) and not isinstance(name, bool):
        name = str(name)
    files = files if isinstance(files, list) else [files]
    if not isinstance(name, str) or not all(isinstance(file, str) for file in files):
        raise ValueError(f"{where}: expected strings, as in {_EXPECTED}, got {line[:80]!r}")
    if name != Path(name).name or name in ("", ".", "..") or "\0" in name:
        raise ValueError(f"{where}: expected an id that can be a file name, got {name[:80]!r}")
    if foreign := [field.name for field in fields(FitSettings) if field.name in row]:
        raise ValueError(
            f"{where}: {', '.join(foreign)} cannot differ between clips of a batch; give them as "
            "options, and fit clips with other values in another batch"
        )
    subject = row.get("subject")
    if subject is not None and not (isinstance(subject, str | int) and str(subject).strip()):
        raise ValueError(f"{where}: expected a name as subject, got {subject!r:.80}")
    whose = None if subject is None else str(subject)
    return BatchClip(name, tuple(path.parent / file for file in files), whose)


def clips_of_shard(clips: Sequence[BatchClip], index: int, count: int) -> tuple[BatchClip, ...]:
    """Return the clips of part `index` when `count` runs share the clips of a manifest.

    A hash of the clip's id or subject decides, so parts are always the same.
    """
    if not 0 <= index < count:
        raise ValueError(f"--shard must be I/N with 0 <= I < N, got {index}/{count}")
    keys = (one.name if one.subject is None else f"subject {one.subject}" for one in clips)
    return tuple(
        clip
        for clip, key in zip(clips, keys, strict=True)
        if int(hashlib.sha256(key.encode()).hexdigest(), 16) % count == index
    )


Record = dict[str, Any]


@dataclass(frozen=True)
class WorkLog:
    """A JSON-lines log, locked for this process: the last record of every id, and `append`."""

    path: Path
    descriptor: int
    records: dict[str, Record] = field(default_factory=dict)
    """The last record of every id."""

    def append(self, record: Record) -> None:
        """Append a record, which has an `id`, as one line.

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
    """Context with an open log that no other process may write to.

    Raises:
        ValueError: when another process holds it.
        OSError: when it cannot be opened or written.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        _lock_file(descriptor, path)
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.ftruncate(descriptor, whole)
        yield WorkLog(path, descriptor, _last_records(data[:whole]))
    finally:
        os.close(descriptor)


def read_log(path: Path) -> dict[str, Record]:
    """The last record of every id in a log, which another process may be writing."""
    data = path.read_bytes() if path.is_file() else b""
    return _last_records(data[: data.rfind(b"\n") + 1])


def _last_records(data: bytes) -> dict[str, Record]:
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


def _lock_file(descriptor: int, path: Path) -> None:
    """Lock an open file against other processes; fail if another process has locked it."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ValueError(
            f"{path}: another run is writing to it; wait for its end, or give another OUT"
        ) from error
