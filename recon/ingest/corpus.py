"""Whole collections at once: one shape per skeleton, clips in parallel, resumable."""

import csv
import hashlib
import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import torch

from recon.body import BodyModel
from recon.formats.files import replacing
from recon.ingest import solve as solving
from recon.ingest import subject as calibrating
from recon.ingest.collection import Clip, collections, read_clips, skeleton_key
from recon.ingest.conversion import convert_skeletons, glitches
from recon.ingest.skeletons import recognise
from recon.ingest.subject import SubjectModel, calibrate
from recon.recording import SkeletonRecording

logger = logging.getLogger(__name__)

VERSION = 2
"""Raised when the conversion gives other results, so that old outputs are made anew."""
SHORTEST = 1.0
"""Seconds; what is left between jumps must last so long to be kept."""
_BATCH_FRAMES = 6000
"""Frames of one batch, padding included."""
_CHUNK_FRAMES = 30000
"""Frames of one job, about a minute."""
_CHUNK_CLIPS = 400
_CALIBRATION_CLIPS = 200

Row = dict[str, str | float | int | bool | None]


@dataclass(frozen=True)
class Piece:
    """A recording, or what lies between two jumps of one."""

    clip: Clip
    name: str
    recording: SkeletonRecording
    cut: str
    """What was cut off, for the report."""


def convert_corpus(
    folder: str | Path, out: str | Path, *, processes: int = 2, body: str | Path | None = None
) -> list[Row]:
    """Convert every skeleton recording below a folder.

    Writes OUT/COLLECTION/CLIP.npz, and OUT/report.csv and report.json with one row per clip.
    A recording with jumps is split at them; pieces under a second are rejected. Outputs that are
    there already, made with the same settings and body, are kept.

    Args:
        folder: with recordings, or with folders that hold a manifest.csv.
        out: folder to write to.
        processes: that work at once, one thread each.
        body: file of another body; None is the bundled one.

    Raises:
        FileNotFoundError: when the folder or a file of its manifest is missing.
        ValueError: when nothing in it is a recording of a skeleton.
    """
    if processes < 1:
        raise ValueError(f"expected at least one process, got {processes}")
    out = Path(out)
    settings = config_hash(BodyModel.load(body))
    rows: list[Row] = []
    for clips in collections(Path(folder)):
        target = out / clips[0].collection
        target.mkdir(parents=True, exist_ok=True)
        with ProcessPoolExecutor(processes, get_context("spawn"), initializer=_one_thread) as pool:
            groups, unread = _by_skeleton(clips, pool)
            rows += unread
            pending: list[list[Clip]] = []
            for group in groups:
                found = {c.name: _finished(target / f"{c.name}.npz", settings) for c in group}
                rows += [row for row in found.values() if row is not None]
                pending.append([clip for clip in group if found[clip.name] is None])
            waiting = [(g, p) for g, p in zip(groups, pending, strict=True) if p]
            calibrated = pool.map(
                partial(calibrate_group, body_path=body), [group for group, _ in waiting]
            )
            jobs: list[Future[list[Row]]] = []
            for (_, clips_left), subject in zip(waiting, list(calibrated), strict=True):
                if isinstance(subject, str):
                    rows += [_rejection(clip, subject) for clip in clips_left]
                    continue
                jobs += [
                    pool.submit(convert_chunk, chunk, subject, target, settings, body)
                    for chunk in _chunks(clips_left)
                ]
            write_report(out, rows)
            for job in as_completed(jobs):
                rows += job.result()
                write_report(out, rows)
        logger.info("%s: done", clips[0].collection)
    return rows


def calibrate_group(clips: Sequence[Clip], body_path: str | Path | None) -> SubjectModel | str:
    """Shape, offsets and alignments of one skeleton, from up to 200 of its clips.

    Or why there is none: nobody knows the skeleton, or no clip is whole.
    """
    some = list(clips[:: max(1, -(-len(clips) // _CALIBRATION_CLIPS))])
    recordings = [
        piece.recording
        for clip, recording in read_clips(some)
        if isinstance(recording, SkeletonRecording)
        for piece in split(clip, recording)[0]
    ]
    if not recordings:
        return "no clip of its skeleton lasts a second without jumps"
    try:
        skeleton = recognise(recordings[0])
    except ValueError as error:
        return str(error)
    return calibrate(recordings, skeleton, BodyModel.load(body_path))


def convert_chunk(
    clips: Sequence[Clip],
    subject: SubjectModel,
    target: Path,
    settings: str,
    body_path: str | Path | None,
) -> list[Row]:
    """Some clips of one skeleton, in batches of like length."""
    body = BodyModel.load(body_path)
    rows: list[Row] = []
    pieces: list[Piece] = []
    for clip, recording in read_clips(list(clips)):
        if isinstance(recording, str):
            rows.append(_rejection(clip, recording))
            continue
        kept, rejected = split(clip, recording)
        rows += rejected
        for piece in kept:
            row = _finished(target / f"{piece.name}.npz", settings)
            if row is None:
                pieces.append(piece)
            else:
                rows.append(row)
    for batch in _batches(pieces):
        rows += convert_batch(batch, subject, body, target, settings)
    return rows


def convert_batch(
    batch: Sequence[Piece], subject: SubjectModel, body: BodyModel, target: Path, settings: str
) -> list[Row]:
    """Clips of one batch, each written beside its row of the report."""
    rows: list[Row] = []
    found = convert_skeletons([piece.recording for piece in batch], subject, body)
    for piece, conversion in zip(batch, found, strict=True):
        clip, path = piece.clip, target / f"{piece.name}.npz"
        conversion.save(path, body, contacts=clip.contacts)
        row: Row = {
            "collection": clip.collection,
            "clip": piece.name,
            "subject": clip.subject,
            "action": clip.action,
            "kept": True,
            **conversion.report,
            "flat": clip.flat,
            "contacts": clip.contacts,
            "skeleton": subject.skeleton.name,
            "cut": piece.cut,
            "reason": "",
            "settings": settings,
        }
        with replacing(path.with_suffix(".json")) as beside:
            beside.write_text(json.dumps(row, indent=1) + "\n", encoding="utf-8")
        rows.append(row)
    return rows


def split(clip: Clip, recording: SkeletonRecording) -> tuple[list[Piece], list[Row]]:
    """What of a recording is whole: the runs between jumps that last a second or more."""
    jumps = glitches(recording)
    edges = [0, *(jump + 1 for jump in jumps), recording.frames]
    runs = [(a, b) for a, b in pairwise(edges) if b > a]
    pieces: list[Piece] = []
    rejected: list[Row] = []
    for first, last in runs:
        if last - first < SHORTEST * recording.fps:
            continue
        name = clip.name if len(runs) == 1 else f"{clip.name}.{first}"
        cut = "" if len(runs) == 1 else f"frames {first}:{last}, between {len(jumps)} jumps"
        pieces.append(Piece(clip, name, recording.window(first, last), cut))
    kept = sum(piece.recording.frames for piece in pieces)
    if kept < recording.frames:
        between = f" between its {len(jumps)} jumps" if jumps else ""
        row = _rejection(clip, f"shorter than a second{between}")
        frames = recording.frames - kept
        rejected.append(row | {"frames": frames, "fps": recording.fps, "n_glitch": len(jumps)})
    return pieces, rejected


def _rejection(clip: Clip, reason: str) -> Row:
    return {
        "collection": clip.collection,
        "clip": clip.name,
        "subject": clip.subject,
        "action": clip.action,
        "kept": False,
        "reason": reason,
    }


def config_hash(body: BodyModel) -> str:
    """Changes whenever the same recording would give another motion."""
    settings = (
        VERSION,
        body.checksum,
        calibrating.CalibrationWeights(),
        calibrating.FRAMES,
        calibrating.FEET_WEIGHT,
        solving.BONES_WEIGHT,
        solving.REST_WEIGHT,
        solving.ITERATIONS,
    )
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:16]


def write_report(out: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """OUT/report.csv and OUT/report.json, in one step each."""
    ordered = sorted(rows, key=lambda row: (str(row["collection"]), str(row["clip"])))
    columns = list(dict.fromkeys(key for row in ordered for key in row))
    with replacing(out / "report.csv") as beside, beside.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(ordered)
    with replacing(out / "report.json") as beside:
        beside.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")


def _finished(path: Path, settings: str) -> Row | None:
    """The report row of an output that need not be made again."""
    beside = path.with_suffix(".json")
    if not path.is_file() or not beside.is_file():
        return None
    row = json.loads(beside.read_text(encoding="utf-8"))
    return row if row.get("settings") == settings else None


def _by_skeleton(clips: Sequence[Clip], pool: Executor) -> tuple[list[list[Clip]], list[Row]]:
    """Clips that share names and lengths of bones, and rows of those that cannot be read."""
    groups: dict[str, list[Clip]] = {}
    unread: list[Row] = []
    parts = [list(clips[k : k + _CHUNK_CLIPS]) for k in range(0, len(clips), _CHUNK_CLIPS)]
    for found in pool.map(_skeleton_keys, parts):
        for clip, key, reason in found:
            if key:
                groups.setdefault(key, []).append(clip)
            else:
                unread.append(_rejection(clip, reason))
    return list(groups.values()), unread


def _skeleton_keys(clips: list[Clip]) -> list[tuple[Clip, str, str]]:
    """Every clip with the key of its skeleton, or without and why."""
    return [
        (clip, "", found) if isinstance(found, str) else (clip, skeleton_key(found), "")
        for clip, found in read_clips(clips)
    ]


def _chunks(clips: Sequence[Clip]) -> Iterator[list[Clip]]:
    """Clips for one job each: short ones many at a time, so that archives are read seldom."""
    chunk: list[Clip] = []
    frames = 0
    for clip in clips:
        stated = clip.notes.get("frames", "")
        frames += int(stated) if stated.isdigit() else _CHUNK_FRAMES // 8
        chunk.append(clip)
        if frames >= _CHUNK_FRAMES:
            yield chunk
            chunk, frames = [], 0
    if chunk:
        yield chunk


def _batches(pieces: Sequence[Piece]) -> Iterator[list[Piece]]:
    """Pieces of one rate and like length."""
    batch: list[Piece] = []
    for piece in sorted(pieces, key=lambda p: (p.recording.fps, -p.recording.frames, p.name)):
        first = batch[0].recording if batch else piece.recording
        full = (len(batch) + 1) * first.frames > _BATCH_FRAMES
        if batch and (full or first.fps != piece.recording.fps):
            yield batch
            batch = []
        batch.append(piece)
    if batch:
        yield batch


def _one_thread() -> None:
    torch.set_num_threads(1)
