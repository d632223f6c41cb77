"""What a process of a batch does for one clip."""

import time
from dataclasses import dataclass
from pathlib import Path

from recon.fitting.settings import FitSettings
from recon.formats.files.checksums import file_checksum, value_checksum
from recon.jobs.many.manifest import BatchClip
from recon.jobs.many.worklog import Record


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
