"""Reads and writes `manifest.csv` of a corpus: which trainings may use which seconds.

A corpus without a manifest, as `recon convert --all` writes it, teaches everything that it has:
all poses, steps on flat ground, contacts where its files have them.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from recon.benchmark.dataset import Splits
from recon.core.motion import MotionFile
from recon.formats.motions import load_motion
from recon.formats.text_tables import write_rows

MANIFEST = "manifest.csv"
Lesson = Literal["poses", "steps", "contacts", "shape"]
LESSONS: tuple[Lesson, ...] = ("poses", "steps", "contacts", "shape")


@dataclass(frozen=True)
class ManifestRow:
    """A stretch of one clip that is fit for the same trainings throughout."""

    clip: str
    collection: str
    first: int
    """First frame."""
    stop: int
    """Last frame + 1."""
    seconds: float
    poses: bool
    steps: bool
    """How one pose follows another, at what speed, on flat ground."""
    contacts: bool
    """Which joints carry weight."""
    shape: bool
    """The proportions of the body."""
    why: str
    """What speaks against the lessons that it does not teach, as words of `training.lessons`."""


def write_manifest(rows: Iterable[ManifestRow], corpus: Path) -> Path:
    """Write the manifest of a corpus atomically; returns its path."""
    path = corpus / MANIFEST
    write_rows(path, [
        {k: int(v) if isinstance(v, bool) else v for k, v in asdict(row).items()} for row in rows
    ])  # fmt: skip
    return path


def read_manifest(corpus: Path) -> dict[str, list[ManifestRow]] | None:
    """The rows of every clip; None where the corpus has no manifest.

    Raises:
        ValueError: when it is no manifest.
    """
    path = corpus / MANIFEST
    if not path.is_file():
        return None
    found: dict[str, list[ManifestRow]] = {}
    with path.open(newline="", encoding="utf-8") as file:
        for line, row in enumerate(csv.DictReader(file), 2):
            try:
                read = _parsed_row(row)
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{path}, line {line}: expected a row as `python -m training.conversion` "
                    f"writes it, got {dict(row)}"
                ) from error
            found.setdefault(read.clip, []).append(read)
    return found


def _parsed_row(row: Mapping[str, Any]) -> ManifestRow:
    lessons = {lesson: bool(int(row[lesson])) for lesson in LESSONS}
    return ManifestRow(
        row["clip"], row["collection"], int(row["first"]), int(row["stop"]),
        float(row["seconds"]), why=row["why"], **lessons,
    )  # fmt: skip


def stretches_to_teach(
    path: Path, rows: Sequence[ManifestRow] | None, lesson: Lesson, with_contacts: bool = True
) -> list[MotionFile]:
    """Load a clip's stretches that are fit for learning `lesson`, with contacts if reliable.

    Args:
        path: of the motion.
        rows: of the clip in the manifest; None is a corpus without one.
        lesson: what is to be learned. Neighbours that both teach it are one stretch, unless
            contacts are wanted and taught in one of them alone.
        with_contacts: whether contacts are wanted.
    """
    file = load_motion(path)
    if rows is None:
        return [file]
    runs: list[tuple[int, int, bool]] = []
    for row in (row for row in rows if getattr(row, lesson)):
        contacts = row.contacts and with_contacts
        if runs and runs[-1][1] == row.first and runs[-1][2] == contacts:
            runs[-1] = (runs[-1][0], row.stop, contacts)
        else:
            runs.append((row.first, row.stop, contacts))
    return [_cut_frames(file, first, stop, contacts) for first, stop, contacts in runs]


def _cut_frames(file: MotionFile, first: int, stop: int, contacts: bool) -> MotionFile:
    """Cut the frames `first` to `stop` - 1 out of a motion file, with contacts if wanted."""
    joints, touching = file.joints, file.contacts if contacts else None
    return MotionFile(
        file.motion.window(first, stop),
        joints=None if joints is None else joints[first:stop],
        contacts=None if touching is None else touching[first:stop],
    )


def minutes_by_part(rows: Sequence[ManifestRow], splits: Splits) -> list[dict[str, str | float]]:
    """Minutes and people of every collection and part, and minutes fit for each lesson.

    Clips in no part have the part "none".
    """
    parts = splits.parts([row.clip for row in rows])
    groups: dict[tuple[str, str], list[ManifestRow]] = {}
    for row in rows:
        groups.setdefault((row.collection, parts.get(row.clip, "none")), []).append(row)
    return [
        {
            "collection": collection,
            "part": part,
            "people": len({splits.subject(row.clip) for row in own}),
            "clips": len({row.clip for row in own}),
            "minutes": round(sum(row.seconds for row in own) / 60, 2),
            **{
                lesson: round(sum(row.seconds for row in own if getattr(row, lesson)) / 60, 2)
                for lesson in LESSONS
            },
        }
        for (collection, part), own in sorted(groups.items())
    ]
