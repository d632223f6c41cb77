"""Jobs of a corpus conversion: survey recordings, calibrate a skeleton, convert clips."""

import contextlib
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from recon.batch.collection import ClipContent, SourceClip, contents_of_clips, skeleton_key
from recon.batch.worklog import Record
from recon.body.model import BodyModel
from recon.core.visible import visible
from recon.formats.replacing import (
    clear_leftovers,
    file_checksum,
    temporary_path,
    write_text,
)
from recon.formats.text_tables import write_rows
from recon.ingest.conversion import Conversion, convert_skeletons, jump_frames
from recon.ingest.maps import recognise, right_handed_skeleton
from recon.ingest.subject import SubjectModel, calibrate
from recon.mocap.recording import SkeletonRecording

Row = dict[str, str | float | int | bool | None]


def rejected_row(clip: SourceClip, reason: str) -> Row:
    """Return a row of the report for a clip that was not converted, with the reason."""
    return {
        "collection": clip.collection,
        "clip": clip.name,
        "subject": clip.subject,
        "action": clip.action,
        "kept": False,
        "reason": reason,
    }


def write_report(out: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write OUT/report.csv and OUT/report.json, each atomically."""
    ordered = sorted(rows, key=lambda row: (str(row["collection"]), str(row["clip"])))
    shown = [
        {k: visible(v) if isinstance(v, str) else v for k, v in row.items()} for row in ordered
    ]
    write_rows(out / "report.csv", shown)
    write_text(out / "report.json", json.dumps(ordered, indent=1) + "\n")


SHORTEST_PIECE = 1.0
"""Seconds; what is left between jumps must last so long to be kept."""


@dataclass(frozen=True)
class Task:
    """A clip to convert, with its subject's calibration."""

    clip: SourceClip
    key: str
    """Checksum of all that the motion depends on."""
    checksum: str
    """Checksum of the content when it was surveyed."""
    subject: SubjectModel
    target: Path
    """Folder of the collection's outputs."""
    settings: str
    """Hash of what all conversions depend on."""
    body: str | Path | None
    taken: frozenset[str] = frozenset()
    """Names of other clips that a piece of this one could have."""
    known: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of its outputs of a former run, by name."""
    overwrite: bool = False
    """Whether motions that are there and recon did not write may be replaced."""


@dataclass(frozen=True)
class RecordingPiece:
    """A named part of a recording between two jumps, or a whole recording without jumps."""

    name: str
    recording: SkeletonRecording
    cut: str
    """What was cut off, for the report."""


def surveyed_clip(content: ClipContent) -> tuple[str, str]:
    """Read a recording; return its checksum and a key that is equal for equal skeletons.

    Raises:
        ValueError, OSError: when it cannot be read.
    """
    recording = content.read()
    return content.checksum(), skeleton_key(recording)


def calibrate_group(
    clips: Sequence[SourceClip], body_path: str | Path | None
) -> SubjectModel | str:
    """Calibrate one skeleton (shape, offsets, alignments) from some of its clips.

    Returns the reason as a text if the skeleton is unknown, or all clips are too short.
    """
    recordings: list[SkeletonRecording] = []
    for content in contents_of_clips(clips):
        # a clip that can no longer be read is left out here; its conversion reports the error
        with contextlib.suppress(ValueError):
            pieces, _ = split_at_jumps(content.clip, content.read())
            recordings += [piece.recording for piece in pieces]
    if not recordings:
        return "no clip of its skeleton lasts a second without jumps"
    try:
        skeleton = recognise(recordings[0])
    except ValueError as error:
        return str(error)
    recordings = [right_handed_skeleton(one, skeleton) for one in recordings]
    return calibrate(recordings, skeleton, _loaded_body(body_path))


def convert_task(task: Task, content: ClipContent) -> Record:
    """Convert a clip, and write each of its pieces with its row of the report.

    Returns `rows` of the report, one per piece and one for what was left out, and `outputs`:
    SHA-256 of every motion file, by its name in the collection's folder.

    Raises:
        ValueError: when the recording cannot be read, it is another than the one that was
            surveyed, or a piece has the name of another clip.
        FileExistsError: when a file that recon did not write is where one of its own belongs.
    """
    recording = content.read()
    if content.checksum() != task.checksum:
        raise ValueError(
            f"{task.clip.source}: it changed while the folder was converted; run again"
        )
    body = _loaded_body(task.body)
    turned = right_handed_skeleton(recording, task.subject.skeleton)
    pieces, rows = split_at_jumps(task.clip, turned)
    for piece in pieces:
        _check_target(task, piece)
    outputs: dict[str, str] = {}
    for piece in pieces:
        (conversion,) = convert_skeletons([piece.recording], task.subject, body)
        path, clip = task.target / f"{piece.name}.npz", task.clip
        path.parent.mkdir(parents=True, exist_ok=True)
        row: Row = {
            "collection": clip.collection,
            "clip": piece.name,
            "subject": clip.subject,
            "action": clip.action,
            "kept": True,
            **conversion.report,
            "flat": clip.on_flat_ground,
            "contacts": clip.reliable_contacts,
            "skeleton": task.subject.skeleton.name,
            "cut": piece.cut,
            "reason": " ".join(turned.decisions[len(recording.decisions) :]),
            "settings": task.settings,
        }
        outputs[f"{piece.name}.npz"] = _write_piece(path, conversion, row, body)
        rows.append(row)
    return {"outputs": outputs, "rows": rows}


def _write_piece(path: Path, conversion: Conversion, row: Row, body: BodyModel) -> str:
    """Write a motion and its row of the report atomically; returns the motion's checksum.

    The report comes first: there is never a motion without one, and a motion that a killed run
    left beside the report of its successor is known by it, too.
    """
    report_path, stage = path.with_suffix(".json"), temporary_path(path)
    for place in (path, report_path):
        clear_leftovers(place)
    try:
        stage.mkdir()
        motion = stage / "motion"  # no suffix: nobody shall take the unfinished file for a motion
        conversion.save(motion, body, contacts=bool(row["contacts"]))
        found = file_checksum(motion)
        noted = {**row, "checksum": found}
        noted["replaces"] = file_checksum(path) if path.exists() else None
        write_text(report_path, json.dumps(noted, indent=1) + "\n")
        os.replace(motion, path)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return found


def split_at_jumps(
    clip: SourceClip, recording: SkeletonRecording
) -> tuple[list[RecordingPiece], list[Row]]:
    """Cut a recording at jumps into pieces of at least 1 s; report shorter pieces in a row."""
    jumps = jump_frames(recording)
    edges = [0, *(jump + 1 for jump in jumps), recording.frames]
    runs = [(a, b) for a, b in pairwise(edges) if b > a]
    pieces: list[RecordingPiece] = []
    rejected: list[Row] = []
    for first, last in runs:
        if last - first < SHORTEST_PIECE * recording.fps:
            continue
        name = clip.name if len(runs) == 1 else f"{clip.name}.{first}"
        cut = "" if len(runs) == 1 else f"frames {first}:{last}, between {len(jumps)} jumps"
        pieces.append(RecordingPiece(name, recording.window(first, last), cut))
    kept = sum(piece.recording.frames for piece in pieces)
    if kept < recording.frames:
        between = f" between its {len(jumps)} jumps" if jumps else ""
        row = rejected_row(clip, f"shorter than a second{between}")
        frames = recording.frames - kept
        rejected.append(row | {"frames": frames, "fps": recording.fps, "n_glitch": len(jumps)})
    return pieces, rejected


@lru_cache(maxsize=1)
def _loaded_body(path: str | Path | None) -> BodyModel:
    """Load the body model from a file (None: the bundled one); cached per process."""
    return BodyModel.load(path)


def _check_target(task: Task, piece: RecordingPiece) -> None:
    """Refuse to write over another clip's output, or over what recon did not write."""
    if piece.name in task.taken:
        raise ValueError(
            f"{task.clip.source}: its piece between two jumps would be written as {piece.name}, "
            "which is the name of another recording; rename one of them"
        )
    path = task.target / f"{piece.name}.npz"
    if task.overwrite or not path.exists():
        return
    if file_checksum(path) not in {
        task.known.get(f"{piece.name}.npz"),
        *_reported_checksums(path),
    }:
        raise FileExistsError(
            f"{path} exists, and recon did not write it or it was changed since (its checksum "
            f"is not that in {path.with_suffix('.json').name}); move it away, give another OUT, "
            "or replace it by --overwrite"
        )


def _reported_checksums(path: Path) -> tuple[object, ...]:
    """Return the checksums in the .json report of a motion file; empty without a report."""
    report_path = path.with_suffix(".json")
    if not report_path.is_file():
        return ()
    try:
        row = json.loads(report_path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return ()
    if not isinstance(row, dict):
        return ()
    if "checksum" not in row and {"collection", "clip", "settings"} <= row.keys():
        # reports of version 0.1.0 have no checksum
        return (file_checksum(path),)
    return row.get("checksum"), row.get("replaces")
