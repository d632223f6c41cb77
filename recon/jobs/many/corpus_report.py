"""What became of the clips of a corpus: lines of its log, rows of its report."""

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from recon.formats.files.replacing import replacing
from recon.jobs.many.collection import SourceClip
from recon.jobs.many.workers import Failure
from recon.jobs.many.worklog import Record

Row = dict[str, str | float | int | bool | None]


@dataclass(frozen=True)
class Converted:
    """What became of a clip."""

    rows: list[Row]
    """Rows of the report: one per piece, and one for what was left out."""
    outputs: dict[str, str]
    """SHA-256 of every motion file, by its name in the collection's folder."""


def rejection(clip: SourceClip, reason: str) -> Row:
    """The row of a clip that has no motion."""
    return {
        "collection": clip.collection,
        "clip": clip.name,
        "subject": clip.subject,
        "action": clip.action,
        "kept": False,
        "reason": reason,
    }


def converted_record(clip: SourceClip, found: Converted, key: str) -> Record:
    """The line of the log of a clip that was worked on."""
    status = "ok" if found.outputs else "rejected"
    return {
        "id": clip.id, "status": status, "key": key, "outputs": found.outputs, "rows": found.rows,
    }  # fmt: skip


def rejected_record(clip: SourceClip, reason: str, key: str) -> Record:
    """The record of a clip that is known to be of no use."""
    return converted_record(clip, Converted([rejection(clip, reason)], {}), key)


def failed_record(clip: SourceClip, failure: Failure) -> Record:
    """The record of a clip with which something went wrong."""
    record: Record = {
        "id": clip.id, "status": failure.kind, "error": failure.reason, "outputs": {},
        "rows": [rejection(clip, failure.reason)],
    }  # fmt: skip
    return record | ({"traceback": failure.traceback} if failure.traceback else {})


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
