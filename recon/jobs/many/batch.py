"""Many clips: processes here, a cluster through shards; a log by which a run is resumed."""

import hashlib
import json
import time
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from recon.fitting.settings import FitSettings
from recon.formats.files.checksums import file_checksum, value_checksum
from recon.jobs.many.subjects import shapes_of_subjects
from recon.jobs.many.workers import Failure, run_jobs
from recon.jobs.many.worklog import Record, open_log

FIT_VERSION = 2
"""Version of the method. It is raised when the same clip and settings give another motion, so that
results of older versions are made anew."""

_EXPECTED = '{"id": "clip", "observations": ["clip.npz"]}'


@dataclass(frozen=True)
class BatchClip:
    """One line of a manifest."""

    name: str
    observations: tuple[Path, ...]
    subject: str | None = None
    """The person who moves; clips of one subject share one shape. None: nobody was named."""


def read_manifest(path: Path) -> tuple[BatchClip, ...]:
    """The clips of a manifest: a JSON object per line, {"id": ..., "observations": [...]}.

    Each may have a `subject`, whose clips share one shape. Paths are relative to the manifest.

    Raises:
        FileNotFoundError: when there is no such manifest.
        ValueError: when a line is not such an object or an id occurs twice; it is named.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such manifest")
    try:
        # not splitlines: it would part texts at signs that JSON allows inside them
        lines = path.read_text(encoding="utf-8-sig").split("\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected text in UTF-8, but {error}") from error
    clips: dict[str, tuple[int, BatchClip]] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        clip = _clip(line, path, number)
        # ids that differ by case alone are one file on many systems
        same = unicodedata.normalize("NFC", clip.name).casefold()
        if same in clips:
            before, other = clips[same]
            raise ValueError(
                f"{path}: ids occur twice: {other.name!r} in line {before} and {clip.name!r} in "
                f"line {number} would be one file"
            )
        clips[same] = number, clip
    return tuple(clip for _, clip in clips.values())


def _clip(line: str, path: Path, number: int) -> BatchClip:
    """The clip of one line."""
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
        raise ValueError(f"{where}: expected texts, as in {_EXPECTED}, got {line[:80]!r}")
    if name != Path(name).name or name in ("", ".", "..") or "\0" in name:
        raise ValueError(f"{where}: an id names a file, so not {name[:80]!r}")
    if foreign := [field.name for field in fields(FitSettings) if field.name in row]:
        raise ValueError(
            f"{where}: {', '.join(foreign)} cannot differ between clips of a batch; give such "
            "settings as options, and clips with others in a batch of their own"
        )
    subject = row.get("subject")
    if subject is not None and not (isinstance(subject, str | int) and str(subject).strip()):
        raise ValueError(f"{where}: expected a name as subject, got {subject!r:.80}")
    whose = None if subject is None else str(subject)
    return BatchClip(name, tuple(path.parent / file for file in files), whose)


def shard(clips: Sequence[BatchClip], index: int, count: int) -> tuple[BatchClip, ...]:
    """The clips of one of `count` equal workers: the same every time.

    They are told apart by a hash of the id; clips of one subject stay together.
    """
    if not 0 <= index < count:
        raise ValueError(f"--shard is I/N with 0 <= I < N, got {index}/{count}")
    return tuple(
        clip
        for clip in clips
        if int(hashlib.sha256(_kept_together(clip).encode()).hexdigest(), 16) % count == index
    )


def _kept_together(clip: BatchClip) -> str:
    return clip.name if clip.subject is None else f"subject {clip.subject}"


@dataclass(frozen=True)
class Job:
    """All that a process needs to fit one clip."""

    clip: BatchClip
    target: Path
    """Motion file to write."""
    settings: FitSettings
    settings_checksum: str
    """Checksum of the settings and the files they name
    (`recon.fitting.clip_inputs.settings_checksum`)."""
    known: Record
    """The last record of the clip, or nothing."""
    overwrite: bool = False
    """Whether a result that is there and recon did not write may be replaced."""
    shape: tuple[float, ...] | None = None
    """Coefficients that are held, those of the clip's subject; None estimates them."""


def fit_all(
    clips: Sequence[BatchClip],
    out: Path,
    settings: FitSettings,
    processes: int,
    log: Path,
    work: Callable[[Job], Record] | None = None,
    *,
    overwrite: bool = False,
) -> Iterator[Record]:
    """Fit every clip that is not done yet; yields one record per clip, logged as it ends.

    A clip is done when the log has it as ok, with a key of the same contents of everything that
    the result depends on, and the result is as it was written. All others are tried, also those
    that failed before. Whatever goes wrong with one clip is in its record alone.

    Args:
        clips: with different names.
        out: folder for the results.
        settings: of all clips.
        processes: clips at a time.
        log: file of the records (`recon.jobs.many.worklog`).
        work: what is done for one clip; default: `fit_one`.
        overwrite: whether results that are there and recon did not write may be replaced.

    Raises:
        ValueError: when a result would be written over an observation or a file of the settings,
            or another run is writing to the log.
    """
    from recon.fitting.clip_inputs import settings_checksum

    _check_targets(clips, out, settings)
    out.mkdir(parents=True, exist_ok=True)
    common = settings_checksum(settings, FIT_VERSION)
    shapes = shapes_of_subjects(clips, settings, processes, log, common)
    with open_log(log) as lines:
        jobs = (
            (
                Job(
                    clip,
                    target(out, clip),
                    settings,
                    common,
                    known,
                    overwrite,
                    shapes.get(clip.name),
                ),
            )
            for clip in clips
            for known in [lines.records.get(clip.name, {})]
        )
        for (job,), result in run_jobs(work or fit_one, jobs, processes):
            record = _failed(job, result) if isinstance(result, Failure) else result
            if record["status"] != "skipped":
                lines.append(record)
            yield record


def fit_one(job: Job) -> Record:
    """Fit a clip unless that was done; the record says what was done, to what, with what result.

    Raises:
        ValueError, OSError: for bad input.
    """
    from recon.fitting.clip_inputs import clip_checksum

    # before anything is read: what changes from now on is found out by the next run
    key = clip_checksum(job.clip.observations, job.settings_checksum)
    if job.shape is not None:
        key = value_checksum([key, *job.shape])
    record: Record = {"id": job.clip.name, "output": str(job.target)}
    if is_done(job, key):
        return record | {"status": "skipped"}
    from recon.jobs.fit import fit_files

    began = time.perf_counter()
    report = fit_files(
        job.clip.observations, job.target, job.settings, shape=job.shape, overwrite=job.overwrite
    )
    return record | {
        "status": "failed" if report["failed"] else "ok",
        "seconds": round(time.perf_counter() - began, 3),
        "key": key,
        "checksum": file_checksum(job.target),
    }


def is_done(job: Job, key: str) -> bool:
    """Whether the log knows the same work as done, and its result is there as it was written."""
    known = job.known
    same = known.get("status") == "ok" and known.get("key") == key
    return same and job.target.is_file() and known.get("checksum") == file_checksum(job.target)


def target(out: Path, clip: BatchClip) -> Path:
    """The file to which the motion of a clip is written."""
    return out / f"{clip.name}.npz"


def _failed(job: Job, failure: Failure) -> Record:
    record: Record = {
        "id": job.clip.name, "output": str(job.target), "status": failure.kind,
        "error": failure.reason,
    }  # fmt: skip
    return record | ({"traceback": failure.traceback} if failure.traceback else {})


def _check_targets(clips: Sequence[BatchClip], out: Path, settings: FitSettings) -> None:
    """Refuse to write a result of any clip over what any clip is made from."""
    named = (settings.camera, settings.masks, settings.body, Path(settings.weights))
    inputs = {file.resolve() for clip in clips for file in clip.observations}
    inputs |= {path.resolve() for path in named if path is not None}
    for clip in clips:
        result = target(out, clip)
        for path in (result, result.with_name(result.name + ".json")):
            if path.resolve() in inputs or path.resolve().parent in inputs:
                raise ValueError(
                    f"{path}: the result of clip {clip.name!r} would be written over or among "
                    "inputs of the batch; give another folder for the results"
                )
