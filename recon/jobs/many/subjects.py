"""Clips of one subject share one shape: all of them tell it, and it is held in each."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from recon.fitting.priors import traits
from recon.fitting.settings import FitSettings
from recon.jobs.many.crew import Crew
from recon.jobs.many.manifest import BatchClip
from recon.jobs.many.workers import Failure
from recon.jobs.many.worklog import Record, open_log

Shape = tuple[float, ...]
"""Shape coefficients."""


def shapes_of_subjects(
    clips: Sequence[BatchClip], settings: FitSettings, crew: Crew, log: Path, checksum: str
) -> dict[str, Shape]:
    """The shape that every clip of a subject is fitted with, by the clip's id.

    Each clip of a subject is fitted by the pose prior; the median of their coefficients is the
    subject's shape. Clips that cannot be fitted tell nothing; their own fit says why. What was
    found is logged beside the log of the fits, so that a run goes on where it stopped.

    Args:
        clips: of a manifest (`recon.jobs.many.manifest.read_manifest`).
        settings: of all fits.
        crew: who works at a time.
        log: of the fits.
        checksum: of the settings and the files they name.

    Raises:
        ValueError: when the prior completes cycles, which have shapes of their own.
    """
    known = [clip for clip in clips if clip.subject is not None]
    if not known:
        return {}
    if traits(settings.prior).completes:
        raise ValueError(
            "subject: cycles are completed with shapes of their own; leave `subject` out of the "
            "manifest, or fit with another prior"
        )
    found: dict[str, list[Shape]] = {}
    names = {clip.name: str(clip.subject) for clip in known}
    for record in _shapes(known, settings, crew, log, checksum):
        found.setdefault(names[record["id"]], []).append(tuple(record["shape"]))
    shared = {subject: _shared(shapes) for subject, shapes in found.items()}
    return {name: shared[subject] for name, subject in names.items() if subject in shared}


def _shapes(
    clips: Sequence[BatchClip], settings: FitSettings, crew: Crew, log: Path, checksum: str
) -> Iterator[Record]:
    """A record with the shape of every clip that can be fitted."""
    with open_log(log.with_name(f"shapes-{log.name}")) as lines:
        groups = (
            [ShapeJob(one, settings, checksum, lines.records.get(one.name, {})) for one in group]
            for group in crew.groups(clips)
        )
        for _, result in crew.work(estimate_shape, groups):
            if not isinstance(result, Failure):
                lines.append(result)
                yield result


@dataclass(frozen=True)
class ShapeJob:
    """All that a process needs to find the shape that one clip tells."""

    clip: BatchClip
    settings: FitSettings
    settings_checksum: str
    known: Record
    """The last record of the clip's shape, or nothing."""


def estimate_shape(job: ShapeJob) -> Record:
    """The shape that one clip tells, unless the log has it already; done in a process.

    Raises:
        ValueError, OSError: for bad input.
    """
    from recon.fitting.clip_inputs import clip_checksum

    key = clip_checksum(job.clip.observations, job.settings_checksum)
    if job.known.get("key") == key:
        return job.known
    from recon.jobs.fit import fitted

    first = replace(job.settings, prior="pose", weights="open", method=None, physics=0.0)
    result = fitted(job.clip.observations, first)
    return {"id": job.clip.name, "key": key, "shape": result.motion.shape.tolist()}


def _shared(shapes: Sequence[Shape]) -> Shape:
    import torch

    from recon.api.many import shared_shape

    return tuple(shared_shape([torch.tensor(shape) for shape in shapes]).tolist())
