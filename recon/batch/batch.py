"""Fits many clips in local processes or on a cluster; a log lets later runs resume."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch

from recon.api.fit import fit
from recon.batch.clips import shared_shape
from recon.batch.workers import Failure, Run, run_jobs
from recon.batch.worklog import BatchClip, Record, open_log
from recon.cli.films import draw_film_sheets, films_given
from recon.fitting.methods import prior_trait
from recon.fitting.settings import FitSettings
from recon.formats.outputs import Output, check_outputs, paths_in
from recon.formats.replacing import file_checksum, value_checksum
from recon.reading.inputs import clip_checksum, input_checksums, settings_checksum

Shape = tuple[float, ...]
"""Shape coefficients."""


@dataclass(frozen=True)
class FitJob:
    """The arguments of `fit_one`: a clip, settings, path of the result and last log record."""

    clip: BatchClip
    target: Path
    """Motion file to write."""
    settings: FitSettings
    settings_checksum: str
    """Checksum of the settings and the files they name
    (`recon.reading.inputs.settings_checksum`)."""
    known: Record
    """The last record of the clip, or nothing."""
    overwrite: bool = False
    """Whether a result that is there and recon did not write may be replaced."""
    shape: Shape | None = None
    """Coefficients that are held, those of the clip's subject; None estimates them."""


def fit_one(job: FitJob) -> Record:
    """Fit a clip unless the log has its result; returns the record for the log.

    Its status is `failed` when the fit met nan or inf; the last finite estimate is written then.

    Raises:
        ValueError, OSError: for bad input.
    """
    # checksums are taken before reading, so that the next run notices later changes
    paths, settings = job.clip.observations, job.settings
    key = clip_checksum(paths, job.settings_checksum)
    if job.shape is not None:
        key = value_checksum([key, *job.shape])
    record: Record = {"id": job.clip.name, "output": str(job.target)}
    if is_done(job, key):
        return record | {"status": "skipped"}
    began = time.perf_counter()
    check_outputs([Output(job.target)], paths_in((*paths, settings)), overwrite=job.overwrite)
    inputs = input_checksums({"observations": paths, **vars(settings)})
    held: dict[str, Any] = {} if job.shape is None else {"shape": list(job.shape)}
    result = fit(list(paths), **settings.arguments() | held)
    report = result.report(inputs, asdict(settings) | held)
    result.save(job.target, overwrite=job.overwrite, report=report)
    draw_film_sheets(films_given({"observations": paths}), job.target, settings)
    return record | {
        "status": "failed" if report["failed"] else "ok",
        "seconds": round(time.perf_counter() - began, 3),
        "key": key,
        "checksum": file_checksum(job.target),
    }


def is_done(job: FitJob, work_checksum: str) -> bool:
    """Whether the log records a good fit of unchanged inputs, whose result file is intact."""
    known = job.known
    same = known.get("status") == "ok" and known.get("key") == work_checksum
    return same and job.target.is_file() and known.get("checksum") == file_checksum(job.target)


def estimate_shape(job: FitJob) -> Record:
    """Estimate the body shape in one clip by a fit under the pose prior, or take it from the log.

    Raises:
        ValueError, OSError: for bad input.
    """
    key = clip_checksum(job.clip.observations, job.settings_checksum)
    if job.known.get("key") == key:
        return job.known
    quick = replace(job.settings, prior="pose", weights="open", method=None, physics=0.0)
    shape = fit(list(job.clip.observations), **quick.arguments()).motion.shape
    return {"id": job.clip.name, "key": key, "shape": shape.tolist()}


def shapes_of_subjects(
    clips: Sequence[BatchClip],
    settings: FitSettings,
    processes: int,
    log: Path,
    checksum: str,
    run: Run = run_jobs,
) -> dict[str, Shape]:
    """Estimate one body shape per subject from all its clips; return it for each of their ids.

    Each clip of a subject is fitted by the pose prior; the median of their coefficients is the
    subject's shape. Clips that cannot be fitted tell nothing; their own fit says why. What was
    found is logged beside the log of the fits, so that a run goes on where it stopped.

    Args:
        clips: of a manifest (`recon.batch.worklog.read_manifest`).
        settings: of all fits.
        processes: that work at a time.
        log: of the fits.
        checksum: of the settings and the files they name.
        run: where processes run.

    Raises:
        ValueError: when the prior completes cycles, which have shapes of their own.
    """
    named = [clip for clip in clips if clip.subject is not None]
    if not named:
        return {}
    if prior_trait(settings.prior, "completes"):
        raise ValueError(
            "subject: clips of one subject share a shape, but this prior finds one for each gait "
            "cycle; leave `subject` out of the manifest, or fit with another prior"
        )
    found: dict[str, list[torch.Tensor]] = {}
    names = {clip.name: str(clip.subject) for clip in named}
    with open_log(log.with_name(f"shapes-{log.name}")) as lines:
        jobs = (
            (FitJob(clip, log, settings, checksum, lines.records.get(clip.name, {})),)
            for clip in large_first(named)
        )
        for _, record in run(estimate_shape, jobs, processes):
            if not isinstance(record, Failure):
                lines.append(record)
                shape = torch.tensor(record["shape"])
                found.setdefault(names[record["id"]], []).append(shape)
    shared = {subject: tuple(shared_shape(own).tolist()) for subject, own in found.items()}
    return {name: shared[subject] for name, subject in names.items() if subject in shared}


FIT_VERSION = 21
"""Version of the method. It is raised when the same clip and settings give another motion, so that
results of older versions are made anew."""


def fit_all(
    clips: Sequence[BatchClip],
    out: Path,
    settings: FitSettings,
    processes: int,
    log: Path,
    work: Callable[[FitJob], Record] = fit_one,
    *,
    overwrite: bool = False,
    run: Run = run_jobs,
) -> Iterator[Record]:
    """Fit every clip that is not done yet; yields one record per clip, logged as it ends.

    A clip is done when the log has it as ok, with a key of the same contents of everything that
    the result depends on, and the result is as it was written. All others are tried, also those
    that failed before. Whatever goes wrong with one clip is in its record alone.

    Large files come first, so that no process ends long after the others.

    Args:
        clips: with different names.
        out: folder for the results.
        settings: of all clips.
        processes: that work at a time.
        log: file of the records (`recon.batch.worklog`).
        work: what is done for one clip.
        overwrite: whether results that are there and recon did not write may be replaced.
        run: where processes run.

    Raises:
        ValueError: when a result would be written over an observation or a file of the settings,
            another run is writing to the log, or there is to be no process.
    """
    if processes < 1:
        raise ValueError(f"expected at least one process, got {processes}")
    _check_targets(clips, out, settings)
    out.mkdir(parents=True, exist_ok=True)
    common = settings_checksum(settings, FIT_VERSION)
    shapes = shapes_of_subjects(clips, settings, processes, log, common, run)
    with open_log(log) as lines:

        def arguments_of_fit(clip: BatchClip) -> tuple[FitJob]:
            known, shape = lines.records.get(clip.name, {}), shapes.get(clip.name)
            target = out / f"{clip.name}.npz"
            return (FitJob(clip, target, settings, common, known, overwrite, shape),)

        for (done,), result in run(work, map(arguments_of_fit, large_first(clips)), processes):
            record = result
            if isinstance(result, Failure):
                record = {"id": done.clip.name, "output": str(done.target), **result.record}
            if record["status"] != "skipped":
                lines.append(record)
            yield record


def large_first(clips: Sequence[BatchClip]) -> list[BatchClip]:
    """Sort clips by kind of file, and those of one kind from large to small."""
    return sorted(clips, key=_kind_and_size, reverse=True)


def _kind_and_size(clip: BatchClip) -> tuple[str, int]:
    """Return suffix and size in bytes of the file of a clip's first observation.

    A folder gives "/" and its number of files; a missing file gives ("", 0).
    """
    if len(clip.observations) == 0:
        return "", 0
    path = clip.observations[0]
    try:
        if path.is_dir():
            return "/", sum(1 for _ in path.iterdir())
        return path.suffix.lower(), path.stat().st_size
    except OSError:
        return "", 0


def _check_targets(clips: Sequence[BatchClip], out: Path, settings: FitSettings) -> None:
    """Refuse results that would overwrite an input of any clip."""
    inputs = {file.resolve() for clip in clips for file in clip.observations}
    inputs |= {path.resolve() for path in paths_in(settings)}
    for clip in clips:
        result = out / f"{clip.name}.npz"
        for path in (result, result.with_name(result.name + ".json")):
            if path.resolve() in inputs or path.resolve().parent in inputs:
                raise ValueError(
                    f"{path}: the result of clip {clip.name!r} would be written over or among "
                    "inputs of the batch; give another folder for the results"
                )
