"""Whole collections at once: one shape per skeleton, clips in parallel, resumable."""

import hashlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from recon.batch.collection import SourceClip, collections
from recon.batch.corpus_jobs import (
    Converted,
    Row,
    Survey,
    Task,
    calibrate_group,
    convert_tasks,
    converted_record,
    failed_record,
    rejected_record,
    survey,
    write_report,
)
from recon.batch.workers import Failure, run_items, run_jobs
from recon.batch.worklog import Record, WorkLog, open_log
from recon.body.model import BodyModel
from recon.formats.replacing import file_checksum, value_checksum
from recon.ingest import skeleton as solving
from recon.ingest import subject as calibrating
from recon.ingest.subject import SubjectModel

logger = logging.getLogger(__name__)

CONVERSION_VERSION = 6
"""Raised when the conversion gives other results, so that old outputs are made anew."""
_SURVEYED_TOGETHER = 20
"""Files that a process looks at in a row."""
_CHUNK_FRAMES = 30000
"""Frames of an archive that a process converts in a row, so that it is read seldom."""
_CHUNK_CLIPS = 400
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
    says whether something went wrong. A recording with jumps is split at them; pieces under a
    second are rejected. Clips are kept as they are while nothing that they depend on changes:
    the content of the recording, its notes, the contents of those recordings of its skeleton from
    which its shape was calibrated (up to 200), the body and the version of the conversion.

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
    out = Path(out)
    found = collections(Path(folder))
    settings = config_hash(BodyModel.load(body))
    out.mkdir(parents=True, exist_ok=True)
    if not (out / "report.json").exists():
        write_report(out, [])
    with open_log(out / "log.jsonl") as log:
        every = [clip for clips in found for clip in clips]
        work = _Corpus(out, log, settings, processes, body, every, calibration, overwrite)
        for clips in found:
            work.convert(clips)
            logger.info("%s: done", clips[0].collection)
        work.report()
        return work.rows()


@dataclass
class _Corpus:
    """A conversion on its way."""

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
    ended: dict[str, Record] = field(default_factory=dict)
    """What became of the clips, by their ids."""
    reported: float = 0.0
    """Time at which the report was written last."""

    def convert(self, clips: Sequence[SourceClip]) -> None:
        """Survey, calibrate and convert one collection."""
        surveyed: dict[str, Survey] = {}
        for clip, found in run_items(survey, _in_rows(clips, _SURVEYED_TOGETHER), self.processes):
            if isinstance(found, Failure):
                self._end(clip, failed_record(clip, found))
            elif found.reason:
                self._end(clip, failed_record(clip, Failure("bad input", found.reason)))
            else:
                surveyed[clip.id] = found
        groups: dict[str, list[SourceClip]] = {}
        for clip in clips:
            # a clip that was found twice may have been surveyed and then failed
            if clip.id in surveyed and clip.id not in self.ended:
                groups.setdefault(surveyed[clip.id].skeleton, []).append(clip)
        waiting = [job for group in groups.values() for job in self._waiting(group, surveyed)]
        # some at a time, so that a run that is killed has not calibrated many for nothing
        for k in range(0, len(waiting), _CALIBRATED_TOGETHER * self.processes):
            self._convert(waiting[k : k + _CALIBRATED_TOGETHER * self.processes], surveyed)

    def _convert(self, waiting: Sequence["_Waiting"], surveyed: Mapping[str, Survey]) -> None:
        """Calibrate skeletons and convert clips of them."""
        tasks: list[Task] = []
        keys: dict[str, str] = {}
        for job, subject in run_jobs(self.calibrate, [one.job for one in waiting], self.processes):
            own = next(one for one in waiting if one.job == job)
            found = self._without_culprits(own) if isinstance(subject, Failure) else subject
            for clip, key in own.left:
                keys[clip.id] = key
                if isinstance(found, SubjectModel):
                    tasks.append(self._task(clip, surveyed[clip.id], found))
                elif isinstance(found, str):
                    self._end(clip, rejected_record(clip, found, key))
                else:
                    reason = f"the shape of its subject could not be found: {found.reason}"
                    self._end(clip, failed_record(clip, replace(found, reason=reason)))
        for task, found in run_items(convert_tasks, _chunks(tasks), self.processes):
            if isinstance(found, Converted):
                self._end(task.clip, converted_record(task.clip, found, keys[task.clip.id]))
            else:
                self._end(task.clip, failed_record(task.clip, found))

    def _without_culprits(self, group: "_Waiting") -> SubjectModel | str | Failure:
        """A calibration without the clips that make it fail, which are found by halving."""
        good, suspected = list[SourceClip](), [group.some]
        result: SubjectModel | str | Failure = Failure("error", "every clip of it makes it fail")
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
        # in their order, since a calibration depends on it
        kept = [clip for clip in group.some if clip in good]
        if kept:
            for _, found in run_jobs(self.calibrate, [(kept, self.body)], 1):
                result = found
        return result

    def _waiting(
        self, group: Sequence[SourceClip], surveyed: Mapping[str, Survey]
    ) -> Iterator["_Waiting"]:
        """The group of a skeleton, where some of its clips are to be converted."""
        some = list(group[:: max(1, -(-len(group) // _CALIBRATION_CLIPS))])
        subject = value_checksum([surveyed[clip.id].checksum for clip in some])
        left: list[tuple[SourceClip, str]] = []
        for clip in group:
            notes = [clip.id, clip.subject, clip.action, clip.flat, clip.contacts]
            key = value_checksum([self.settings, subject, surveyed[clip.id].checksum, notes])
            known = self.log.records.get(clip.id, {})
            if known.get("key") == key and self._is_whole(clip, known):
                self.ended[clip.id] = known
            else:
                left.append((clip, key))
        if left:
            yield _Waiting(some, left, self.body)

    def _is_whole(self, clip: SourceClip, known: Record) -> bool:
        """Whether all outputs of a former run are as they were written."""
        folder = self.out / clip.collection
        return known["status"] in ("ok", "rejected") and all(
            (folder / name).is_file() and file_checksum(folder / name) == checksum
            for name, checksum in known["outputs"].items()
        )

    def _task(self, clip: SourceClip, surveyed: Survey, subject: SubjectModel) -> Task:
        pieces = clip.name + "."
        return Task(
            clip,
            surveyed.checksum,
            subject,
            self.out / clip.collection,
            self.settings,
            self.body,
            frozenset(
                other.name
                for other in self.clips
                if other.collection == clip.collection and other.name.startswith(pieces)
            ),
            self.log.records.get(clip.id, {}).get("outputs", {}),
            self.overwrite,
        )

    def _end(self, clip: SourceClip, record: Record) -> None:
        """Log a clip; remove what a former run made of it and this one did not."""
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
        """The report so far."""
        return [
            {**row, "status": record["status"]}
            for record in self.ended.values()
            for row in record["rows"]
        ]

    def report(self) -> None:
        """Write the report, and say what lies in OUT without a recording."""
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
class _Waiting:
    """Clips of one skeleton that are to be converted, with their keys."""

    some: list[SourceClip]
    """Clips from which the skeleton is calibrated."""
    left: list[tuple[SourceClip, str]]
    body: str | Path | None

    @property
    def job(self) -> tuple[list[SourceClip], str | Path | None]:
        """Arguments of `calibrate_group`."""
        return self.some, self.body


def _halves(clips: Sequence[SourceClip]) -> list[list[SourceClip]]:
    middle = len(clips) // 2
    return [list(half) for half in (clips[:middle], clips[middle:]) if half]


def config_hash(body: BodyModel) -> str:
    """Changes whenever the same recording would give another motion."""
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


def _in_rows(clips: Sequence[SourceClip], count: int) -> Iterator[list[SourceClip]]:
    """Files some at a time, all clips of an archive together."""
    files = [clip for clip in clips if clip.member is None]
    for k in range(0, len(files), count):
        yield files[k : k + count]
    packed: dict[Path, list[SourceClip]] = {}
    for clip in clips:
        if clip.member is not None:
            packed.setdefault(clip.path, []).append(clip)
    yield from packed.values()


def _chunks(tasks: Sequence[Task]) -> Iterator[list[Task]]:
    """Files alone, clips of one archive many at a time."""
    chunk: list[Task] = []
    frames = 0
    for task in sorted(tasks, key=lambda task: str(task.clip.path)):
        if task.clip.member is None:
            yield [task]
            continue
        full = frames >= _CHUNK_FRAMES or len(chunk) >= _CHUNK_CLIPS
        if chunk and (full or chunk[0].clip.path != task.clip.path):
            yield chunk
            chunk, frames = [], 0
        stated = task.clip.notes.get("frames", "")
        frames += int(stated) if stated.isdigit() else _CHUNK_FRAMES // 8
        chunk.append(task)
    if chunk:
        yield chunk
