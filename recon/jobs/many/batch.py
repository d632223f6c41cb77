"""Many clips: in processes here or on a cluster; a log by which a run is resumed."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from recon.fitting.settings import FitSettings
from recon.jobs.many.clip_jobs import Job, fit_one, target
from recon.jobs.many.crew import TOGETHER, Crew, Run
from recon.jobs.many.manifest import BatchClip
from recon.jobs.many.subjects import shapes_of_subjects
from recon.jobs.many.workers import Failure, run_jobs
from recon.jobs.many.worklog import Record, open_log

FIT_VERSION = 12
"""Version of the method. It is raised when the same clip and settings give another motion, so that
results of older versions are made anew."""


def fit_all(
    clips: Sequence[BatchClip],
    out: Path,
    settings: FitSettings,
    processes: int,
    log: Path,
    work: Callable[[Job], Record] = fit_one,
    *,
    overwrite: bool = False,
    together: int = TOGETHER,
    run: Run = run_jobs,
) -> Iterator[Record]:
    """Fit every clip that is not done yet; yields one record per clip, logged as it ends.

    A clip is done when the log has it as ok, with a key of the same contents of everything that
    the result depends on, and the result is as it was written. All others are tried, also those
    that failed before. Whatever goes wrong with one clip is in its record alone.

    A process fits several clips side by side, of about one size in bytes, and minimises those of
    like length together, which takes less time; the results are those of one by one within the
    tolerances of the minimiser. Long clips come first, so that no process ends long after the
    others.

    Args:
        clips: with different names.
        out: folder for the results.
        settings: of all clips.
        processes: that work at a time.
        log: file of the records (`recon.jobs.many.worklog`).
        work: what is done for one clip.
        overwrite: whether results that are there and recon did not write may be replaced.
        together: frames that a process minimises together at most; 1 fits clips one by one.
        run: where processes run.

    Raises:
        ValueError: when a result would be written over an observation or a file of the settings,
            another run is writing to the log, or there is to be no process or no frame.
    """
    from recon.fitting.clip_inputs import settings_checksum

    crew = Crew(processes, together, run)
    _check_targets(clips, out, settings)
    out.mkdir(parents=True, exist_ok=True)
    common = settings_checksum(settings, FIT_VERSION)
    shapes = shapes_of_subjects(clips, settings, crew, log, common)
    with open_log(log) as lines:

        def job(clip: BatchClip) -> Job:
            known, shape = lines.records.get(clip.name, {}), shapes.get(clip.name)
            return Job(clip, target(out, clip), settings, common, known, overwrite, shape)

        groups = ([job(clip) for clip in group] for group in crew.groups(clips))
        for done, result in crew.work(work, groups):
            record = _failed(done, result) if isinstance(result, Failure) else result
            if record["status"] != "skipped":
                lines.append(record)
            yield record


def _failed(job: Job, failure: Failure) -> Record:
    record: Record = {
        "id": job.clip.name, "output": str(job.target), "status": failure.kind,
        "error": failure.reason,
    }  # fmt: skip
    return record | ({"traceback": failure.traceback} if failure.traceback else {})


def _check_targets(clips: Sequence[BatchClip], out: Path, settings: FitSettings) -> None:
    """Refuse to write a result of any clip over what any clip is made from."""
    named = (
        settings.camera,
        settings.camera_track,
        settings.masks,
        settings.body,
        Path(settings.weights),
    )
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
