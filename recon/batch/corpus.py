"""Converts whole collections of recordings: one shape per skeleton, in parallel, resumable."""

import hashlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from recon.batch.collection import (
    SourceClip,
    clips_by_collection,
    contents_of_clips,
    recordings_left_out,
)
from recon.batch.corpus_jobs import (
    Row,
    Task,
    calibrate_group,
    convert_task,
    rejected_row,
    surveyed_clip,
    write_report,
)
from recon.batch.workers import Failure, run_jobs
from recon.batch.worklog import Record, WorkLog, open_log
from recon.body.model import BodyModel
from recon.formats.replacing import file_checksum, value_checksum
from recon.ingest import skeleton as solving
from recon.ingest import subject as calibrating
from recon.ingest.subject import SubjectModel

logger = logging.getLogger(__name__)

CONVERSION_VERSION = 7
"""Raised when the conversion gives other results, so that old outputs are made anew."""
_CALIBRATION_CLIPS = 200
_CALIBRATED_TOGETHER = 4
"""Skeletons for each process."""
_REPORT_EVERY = 20.0
"""Seconds."""


def convert_corpus(
    folder: str | Path,
    out: str | Path,
    *,
    processes: int = 2,
    body: str | Path | None = None,
    calibration: Callable[..., Any] = calibrate_group,
    overwrite: bool = False,
) -> list[Row]:
    """Convert every skeleton recording below a folder.

    Writes OUT/COLLECTION/CLIP.npz and CLIP.json, OUT/log.jsonl with a line per clip as it ends,
    and OUT/report.csv and report.json with a row per motion or rejected clip; `status` of a row
    says whether something went wrong. Markers and other recordings that are no clips are rejected.
    A recording with jumps is split at them; pieces under a second are rejected. Clips are kept as
    they are while nothing that they depend on changes: the content of the recording, its notes,
    the contents of those recordings of its skeleton from which its shape was calibrated (up to
    200), the body and the version of the conversion.

    Args:
        folder: with recordings, or with folders that hold a manifest.csv.
        out: folder to write to.
        processes: that work at once, one thread each.
        body: file of another body; None is the bundled one.
        calibration: finds what the clips of one skeleton have in common.
        overwrite: whether motions that are there and recon did not write may be replaced.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when nothing in it is a recording, a manifest is damaged, two recordings would
            have one output, or another run is writing to OUT.
    """
    found = clips_by_collection(Path(folder))
    left_out = recordings_left_out(Path(folder), found)
    if left_out:
        logger.warning(
            "%s: %d recordings were left out; %s says why: %s",
            folder, len(left_out), Path(out) / "report.csv",
            ", ".join(clip.name for clip, _ in left_out[:5]),
        )  # fmt: skip
    return convert_clips(
        found,
        out,
        processes=processes,
        body=body,
        calibration=calibration,
        overwrite=overwrite,
        left_out=[{**rejected_row(*one), "status": "rejected"} for one in left_out],
    )


def convert_clips(
    found: Sequence[Sequence[SourceClip]],
    out: str | Path,
    *,
    processes: int = 2,
    body: str | Path | None = None,
    calibration: Callable[..., Any] = calibrate_group,
    overwrite: bool = False,
    left_out: Sequence[Row] = (),
) -> list[Row]:
    """Convert the given clips of collections, as `convert_corpus` does.

    `left_out` are rows of other recordings for the report.

    Raises:
        ValueError: when another run is writing to OUT.
    """
    out = Path(out)
    settings = conversion_checksum(BodyModel.load(body))
    out.mkdir(parents=True, exist_ok=True)
    if not (out / "report.json").exists():
        write_report(out, [])
    with open_log(out / "log.jsonl") as log:
        every = [clip for clips in found for clip in clips]
        work = _Conversion(
            out, log, settings, processes, body, every, calibration, overwrite, left_out
        )
        for clips in found:
            work.convert(clips)
            logger.info("%s: done", clips[0].collection)
        work.report()
        return work.rows()


@dataclass
class _Conversion:
    """A running conversion of a corpus: its settings, log and the records of finished clips."""

    out: Path
    log: WorkLog
    settings: str
    processes: int
    body: str | Path | None
    clips: Sequence[SourceClip]
    """Clips of all collections."""
    calibrate: Callable[..., Any]
    """`calibrate_group`."""
    overwrite: bool
    left_out: Sequence[Row]
    """Rows of recordings that are no clips."""
    ended: dict[str, Record] = field(default_factory=dict)
    """What became of the clips, by their ids."""
    reported: float = 0.0
    """Time at which the report was written last."""

    def convert(self, clips: Sequence[SourceClip]) -> None:
        """Survey, calibrate and convert the clips of one collection."""
        surveyed: dict[str, tuple[str, str]] = {}
        jobs = ((content,) for content in contents_of_clips(clips))
        for (content,), found in run_jobs(surveyed_clip, jobs, self.processes):
            if isinstance(found, Failure):
                self._log_failure(content.clip, found)
            else:
                surveyed[content.clip.id] = found
        groups: dict[str, list[SourceClip]] = {}
        for clip in clips:
            # clips whose survey failed, or that were converted or failed since, are left out
            if clip.id in surveyed and clip.id not in self.ended:
                groups.setdefault(surveyed[clip.id][1], []).append(clip)
        checksums = {id_: checksum for id_, (checksum, _) in surveyed.items()}
        waiting = [
            job for group in groups.values() for job in self._group_if_waiting(group, checksums)
        ]
        # calibrate in small groups, so that a killed run loses only the calibrations of one group
        for k in range(0, len(waiting), _CALIBRATED_TOGETHER * self.processes):
            self._calibrate_and_convert(
                waiting[k : k + _CALIBRATED_TOGETHER * self.processes], checksums
            )

    def _calibrate_and_convert(
        self, waiting: Sequence["_WaitingClips"], checksums: Mapping[str, str]
    ) -> None:
        """Calibrate every group's skeleton, then convert and log the group's waiting clips."""
        tasks: dict[str, Task] = {}
        jobs = [(group.calibrated_from, self.body) for group in waiting]
        for (clips, _), subject in run_jobs(self.calibrate, jobs, self.processes):
            group = next(group for group in waiting if group.calibrated_from == clips)
            found = (
                self._calibrate_without_bad_clips(clips)
                if isinstance(subject, Failure)
                else subject
            )
            for clip, key in group.to_convert:
                if isinstance(found, SubjectModel):
                    tasks[clip.id] = self._task_of(clip, key, checksums[clip.id], found)
                elif isinstance(found, str):
                    self._log_result(
                        clip, {"outputs": {}, "rows": [rejected_row(clip, found)]}, key
                    )
                else:
                    reason = f"the shape of its subject could not be found: {found.reason}"
                    self._log_failure(clip, replace(found, reason=reason))
        calibrated = [task.clip for task in tasks.values()]
        work = ((tasks[content.clip.id], content) for content in contents_of_clips(calibrated))
        for (task, _), found in run_jobs(convert_task, work, self.processes):
            if isinstance(found, Failure):
                self._log_failure(task.clip, found)
            else:
                self._log_result(task.clip, found, task.key)

    def _calibrate_without_bad_clips(
        self, every: list[SourceClip]
    ) -> SubjectModel | str | Failure:
        """Calibrate without the clips that make a calibration fail, found by bisection."""
        good, suspected = list[SourceClip](), [every]
        result: SubjectModel | str | Failure = Failure(
            "error", "the calibration fails with every clip of the subject"
        )
        while suspected:
            halves = [half for clips in suspected for half in _halves(clips)]
            jobs = [(half, self.body) for half in halves]
            suspected = []
            for (half, _), found in run_jobs(self.calibrate, jobs, self.processes):
                if not isinstance(found, Failure):
                    good += half
                elif len(half) > 1:
                    suspected.append(half)
                else:
                    result = found
        # clips keep their given order, since a calibration depends on it
        kept = [clip for clip in every if clip in good]
        if kept:
            for _, found in run_jobs(self.calibrate, [(kept, self.body)], 1):
                result = found
        return result

    def _group_if_waiting(
        self, group: Sequence[SourceClip], checksums: Mapping[str, str]
    ) -> Iterator["_WaitingClips"]:
        """Yield a skeleton's clips that must be converted; nothing if all results are current."""
        calibration_clips = list(group[:: max(1, -(-len(group) // _CALIBRATION_CLIPS))])
        subject = value_checksum([checksums[clip.id] for clip in calibration_clips])
        left: list[tuple[SourceClip, str]] = []
        for clip in group:
            notes = [clip.subject, clip.action, clip.on_flat_ground, clip.reliable_contacts]
            key = value_checksum([self.settings, subject, checksums[clip.id], [clip.id, *notes]])
            known = self.log.records.get(clip.id, {})
            if known.get("key") == key and self._is_unchanged(clip, known):
                self.ended[clip.id] = known
            else:
                left.append((clip, key))
        if left:
            yield _WaitingClips(calibration_clips, left)

    def _is_unchanged(self, clip: SourceClip, known: Record) -> bool:
        """Whether the files that a former run wrote for this clip exist and are unchanged."""
        folder = self.out / clip.collection
        return known["status"] in ("ok", "rejected") and all(
            (folder / name).is_file() and file_checksum(folder / name) == checksum
            for name, checksum in known["outputs"].items()
        )

    def _task_of(self, clip: SourceClip, key: str, checksum: str, subject: SubjectModel) -> Task:
        piece_prefix = clip.name + "."
        return Task(
            clip,
            key,
            checksum,
            subject,
            self.out / clip.collection,
            self.settings,
            self.body,
            frozenset(
                other.name
                for other in self.clips
                if other.collection == clip.collection and other.name.startswith(piece_prefix)
            ),
            self.log.records.get(clip.id, {}).get("outputs", {}),
            self.overwrite,
        )

    def _log_failure(self, clip: SourceClip, failure: Failure) -> None:
        """Log a clip whose conversion failed."""
        rows = [rejected_row(clip, failure.reason)]
        self._log_clip(clip, {"id": clip.id, **failure.record, "outputs": {}, "rows": rows})

    def _log_result(self, clip: SourceClip, found: Record, key: str) -> None:
        """Log a clip that was converted or rejected."""
        status = "ok" if found["outputs"] else "rejected"
        self._log_clip(clip, {"id": clip.id, "status": status, "key": key, **found})

    def _log_clip(self, clip: SourceClip, record: Record) -> None:
        """Log a clip's record, and delete its files from a former run that are now obsolete."""
        folder = self.out / clip.collection
        former = self.log.records.get(clip.id, {}).get("outputs", {})
        for name in former.keys() - record["outputs"].keys():
            path = folder / name
            if path.is_file() and file_checksum(path) == former[name]:
                path.unlink()
                path.with_suffix(".json").unlink(missing_ok=True)
        self.log.append(record)
        self.ended[clip.id] = record
        if time.monotonic() > self.reported + _REPORT_EVERY:
            self.report()

    def rows(self) -> list[Row]:
        """The rows of the report for all clips so far, and for recordings that are no clips."""
        ended = [
            {**row, "status": record["status"]}
            for record in self.ended.values()
            for row in record["rows"]
        ]
        return [*ended, *self.left_out]

    def report(self) -> None:
        """Write the report; log a warning about motions whose recordings no longer exist."""
        write_report(self.out, self.rows())
        self.reported = time.monotonic()
        known = {clip.id for clip in self.clips}
        gone = [
            id_ for id_, r in self.log.records.items() if r.get("outputs") and id_ not in known
        ]
        if gone:
            logger.warning(
                "%s: motions of %d recordings that are not there any more were left: %s",
                self.out, len(gone), ", ".join(sorted(gone)[:5]),
            )  # fmt: skip


@dataclass(frozen=True)
class _WaitingClips:
    """Clips of one skeleton: those it is calibrated from, and those still to be converted."""

    calibrated_from: list[SourceClip]
    """Clips from which the skeleton is calibrated."""
    to_convert: list[tuple[SourceClip, str]]


def _halves(clips: Sequence[SourceClip]) -> list[list[SourceClip]]:
    middle = len(clips) // 2
    return [list(half) for half in (clips[:middle], clips[middle:]) if half]


def conversion_checksum(body: BodyModel) -> str:
    """Checksum of everything besides the recording on which a converted motion depends."""
    with resources.as_file(resources.files("recon") / "assets" / "skeletons.toml") as skeletons:
        known = file_checksum(skeletons)
    settings = (
        CONVERSION_VERSION,
        body.checksum,
        known,
        calibrating.CalibrationWeights(),
        calibrating.FRAMES,
        calibrating.FEET_WEIGHT,
        solving.BONES_WEIGHT,
        solving.REST_WEIGHT,
        solving.SOLVE_ITERATIONS,
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:16]
