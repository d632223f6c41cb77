"""Converts all recordings to one corpus; marks which seconds each training may use.

    python -m training.conversion DATA CORPUS

DATA is the folder of all real recordings. Clips that are there already are kept, as long as their
recording and the conversion are the same; a run that was cut goes on where it was. CORPUS gets
COLLECTION/CLIP.npz with notes beside (CLIP.json), `manifest.csv` (`training.manifest`) and
`minutes.csv`, which is logged, too.
"""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import tyro
from tyro.conf import Positional

from recon.batch.collection import SourceClip
from recon.batch.corpus import CONVERSION_VERSION, convert_clips
from recon.benchmark.dataset import SPLITS, Splits, clip_files, conversion_notes
from recon.body.model import BodyModel
from recon.formats.motions import load_motion
from recon.formats.replacing import file_checksum, value_checksum, write_text
from recon.formats.text_tables import write_rows
from recon.ingest.conversion import Conversion, convert_skeletons
from recon.ingest.maps import recognise
from recon.ingest.marker_conversion import convert_markers
from recon.ingest.subject import SubjectModel, calibrate
from recon.mocap.recording import SkeletonRecording
from training.lessons import Source, lesson_rows
from training.manifest import ManifestRow, minutes_by_part, write_manifest
from training.sources import (
    CMU_WINDOWS,
    HUMANOID,
    HUMANOID_MAP,
    clips_of_shared_skeleton,
    marker_clips,
    read_cmu_windows,
    read_humanoid,
    read_markers,
    skeleton_clips,
)

LOG = logging.getLogger("training")
_VERSION = 1
"""Raised when markers or humanoids are converted otherwise."""
_TOO_FAST = {
    "88": "its one flight falls at twice the acceleration of gravity",
    "118": "17 flights fall at 13 to 28 m/s², 19 in the median",
}
"""People of CMU whose motions play too fast, and how that shows."""
_Maker = Callable[[SourceClip, BodyModel], tuple[Conversion, bool]]
"""Converts a clip; also tells whether the bones are those of the person who moves."""


def convert(
    data: Positional[Path],
    out: Positional[Path],
    only: tuple[str, ...] = (),
    processes: int = 1,
) -> None:
    """Convert all recordings and note which seconds are fit for training.

    Args:
        data: folder of all real recordings.
        out: folder of the corpus.
        only: collections to convert, such as ui_prmd; none is all. The manifest has all clips that
            are there in any case.
        processes: that work at once.

    Raises:
        FileNotFoundError: when a folder or a manifest is missing.
        ValueError: when a manifest is damaged, or a name in `only` is no collection.
    """
    body = BodyModel.load()
    skeletons, markers = skeleton_clips(data), marker_clips(data)
    copied = {name: clips_of_shared_skeleton(data, name) for name in (HUMANOID, CMU_WINDOWS)}
    known = {clips[0].collection for clips in skeletons if clips} | copied.keys()
    known |= {clip.collection for clip in markers}
    if wrong := sorted(set(only) - known):
        raise ValueError(f"no collection {', '.join(wrong)}; there are {', '.join(sorted(known))}")
    asked = set(only) or known
    out.mkdir(parents=True, exist_ok=True)
    convert_changed([c for c in markers if c.collection in asked], out, body, _converted_markers)
    for name in asked & copied.keys():
        convert_changed(copied[name], out, body, _converter_of_skeleton(copied[name], body))
    if chosen := [clips for clips in skeletons if clips and clips[0].collection in asked]:
        convert_clips(chosen, out, processes=processes)
    write_usable_seconds(out, body)


def convert_changed(
    clips: Sequence[SourceClip],
    out: Path,
    body: BodyModel,
    convert_clip: _Maker,
) -> None:
    """Convert clips with the given function, unless they are converted already.

    A clip that cannot be converted is logged and left out.
    """
    for clip in clips:
        path = out / clip.collection / f"{clip.name}.npz"
        settings = [clip.id, file_checksum(clip.path), body.checksum, CONVERSION_VERSION, _VERSION]
        key = value_checksum([str(value) for value in settings])
        known = conversion_notes(path)
        if known.get("key") == key and path.is_file() and known["checksum"] == file_checksum(path):
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            found, own_bones = convert_clip(clip, body)
        except ValueError as error:
            LOG.warning("%s: left out: %s", clip.id, error)
            continue
        contacts = own_bones and not found.on_belt
        found.save(path, body, contacts=contacts)
        row = {
            "collection": clip.collection,
            "clip": clip.name,
            "subject": clip.subject,
            "action": clip.action,
            "kept": True,
            **found.report,
            "flat": True,
            "contacts": contacts,
            "residuals": _residuals_by_second(found),
            "decisions": found.decisions,
            "key": key,
            "checksum": file_checksum(path),
        }
        write_text(path.with_suffix(".json"), json.dumps(row, indent=1) + "\n")
        LOG.info("%s: %.1f mm", clip.id, found.report["residual_mm"])


def _converted_markers(clip: SourceClip, body: BodyModel) -> tuple[Conversion, bool]:
    return convert_markers(read_markers(clip), body), True


def _converter_of_skeleton(clips: Sequence[SourceClip], body: BodyModel) -> _Maker:
    """Make a function that converts clips of one skeleton, calibrated from all of them."""

    @cache
    def read_and_calibrate() -> tuple[dict[str, SkeletonRecording], SubjectModel]:
        if clips[0].collection == CMU_WINDOWS:
            every = read_cmu_windows(clips)
            skeleton = recognise(next(iter(every.values())))
        else:
            every = {clip.name: read_humanoid(clip.path) for clip in clips}
            skeleton = HUMANOID_MAP
        return every, calibrate(list(every.values()), skeleton, body)

    def converted(clip: SourceClip, body: BodyModel) -> tuple[Conversion, bool]:
        every, subject = read_and_calibrate()
        (found,) = convert_skeletons([every[clip.name]], subject, body)
        return found, False

    return converted


def _residuals_by_second(found: Conversion) -> list[float]:
    """Mean distance of markers from their predictions in every second of a clip, metres."""
    return [
        float(one.value)
        for one in found.diagnosis
        if one.code == "residual" and one.frames and one.value is not None
    ]


def write_usable_seconds(out: Path, body: BodyModel, splits: Path = SPLITS) -> list[ManifestRow]:
    """Write which seconds of a corpus trainings may use, and the minutes of each part.

    Args:
        out: folder of the corpus.
        body: whose motions it has.
        splits: who is held out, for the table of minutes.

    Raises:
        FileNotFoundError: when the corpus holds no motions.
    """
    parts, rows = Splits.load(splits), list[ManifestRow]()
    for name, path in clip_files(out).items():
        notes = conversion_notes(path)
        collection = str(notes.get("collection", path.parent.name))
        source = source_of(name, collection, parts.subject(name), notes)
        rows += lesson_rows(load_motion(path), source, body)
    write_manifest(rows, out)
    table = minutes_by_part(rows, parts)
    write_rows(out / "minutes.csv", table)
    for row in table:
        LOG.info("%s", ", ".join(f"{name} {value}" for name, value in row.items()))
    return rows


def source_of(clip: str, collection: str, person: str, notes: Mapping[str, Any]) -> Source:
    """A record of a clip's origin: its person, collection, true rate and reliability.

    Args:
        clip: its name in the corpus.
        collection: to which it belongs.
        person: who moves.
        notes: the notes beside the clip.
    """
    return Source(
        own_bones=bool(notes.get("contacts", True)),
        retargeted=collection == HUMANOID,
        true_rate=person not in _TOO_FAST,
        flat=bool(notes.get("flat", True)),
        clip=clip,
        collection=collection,
        residuals=tuple(notes.get("residuals", ())),
    )


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO)
    tyro.cli(convert, prog="python -m training.conversion")
