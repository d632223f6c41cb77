"""Tables of labelled markers: OptiTrack Motive's .csv and Qualisys Track Manager's .tsv."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import JOINTS, SAMPLES, TEXT
from recon.core.units import Up, parse_unit
from recon.formats.text_tables import numbers, read_rows
from recon.formats.texts import decode, read_bytes
from recon.mocap.recording import MarkerRecording, settle_markers, stated_rate


def read_motive(path: Path, *, unit: str | None = None, up: Up | None = None) -> MarkerRecording:
    """Markers of a .csv file that Motive exported, format 1.2 and later.

    Those that Motive placed itself for rigid bodies and bones are taken where there are no others.
    Unlabelled ones are left out.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or has no markers, or its unit or axis cannot be told.
    """
    name, rows = path.name, read_rows(path, TEXT)
    start = next((k for k, row in enumerate(rows) if row[0] == "Frame"), 0)
    head = {row[1]: row for row in rows[1:start] if len(row) > 1}
    if rows[0][0] != "Format Version" or not {"Type", "Name"} <= head.keys() or start < 3:
        raise FormatError(
            f"{name}: expected Motive's table, with rows Type, Name and Frame below Format Version"
        )
    said = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    cells = list(zip(head["Type"], head["Name"], rows[start - 1], rows[start], strict=False))
    kinds = {kind for kind, _, what, _ in cells if what == "Position"}
    kind = next(
        (one for one in ("Marker", "Bone Marker", "Rigid Body Marker") if one in kinds), ""
    )
    columns = {
        (label, axis): k
        for k, (of, label, what, axis) in enumerate(cells)
        if of == kind and what == "Position" and not label.startswith("Unlabeled")
    }
    labels = [label for label, axis in columns if axis == "X"]
    if not kind or not labels:
        raise FormatError(
            f"{name}: expected positions of markers, got {', '.join(sorted(kinds)) or 'nothing'}; "
            "export markers from Motive"
        )
    JOINTS.check(len(labels), name, "Name")
    SAMPLES.check(len(rows) * len(labels), name)
    wanted = [columns.get((label, axis), -1) for label in labels for axis in "XYZ"]
    values = numbers(rows[start + 1 :], [1, *wanted], name, most=len(rows[start]))
    rate = said.get("Export Frame Rate") or said.get("Capture Frame Rate") or ""
    declared = parse_unit(said.get("Length Units", ""))
    return _settled(
        name, labels, values[:, 1:], rate, unit, up, declared, "y", float(values[0, 0])
    )


def read_qualisys(path: Path, *, unit: str | None = None, up: Up | None = None) -> MarkerRecording:
    """Markers of a .tsv file that Qualisys Track Manager exported; zeros are markers not seen.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or has no markers, or its unit or axis cannot be told.
    """
    name = path.name
    rows = [line.split("\t") for line in decode(read_bytes(path)).splitlines() if line.strip()]
    head = {row[0].strip(): row[1:] for row in rows if not _is_number(row[0])}
    labels = [label.strip() for label in head.get("MARKER_NAMES", ()) if label.strip()]
    if head.get("DATA_INCLUDED", [""])[0].strip() != "3D" or not labels:
        raise FormatError(
            f"{name}: expected Qualisys' table with DATA_INCLUDED 3D and MARKER_NAMES, got "
            f"{', '.join(head)[:80]}; export 3D data"
        )
    JOINTS.check(len(labels), name, "MARKER_NAMES")
    SAMPLES.check(len(rows) * len(labels), name)
    data = [row for row in rows if _is_number(row[0])]
    timed = "Frame" in head  # columns of frame and time come before the markers'
    first = 2 if timed else 0
    width = first + 3 * len(labels)
    cells = [[cell.strip() for cell in row[:width]] for row in data]
    values = numbers(cells, range(width), name, most=width)
    start = float(values[0, 1]) if timed and len(values) else 0.0
    rate = (head.get("FREQUENCY") or [""])[0]
    return _settled(name, labels, values[:, first:], rate, unit, up, "mm", "z", start)


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _settled(
    name: str,
    labels: Sequence[str],
    values: Float[np.ndarray, "time numbers"],
    rate: str,
    unit: str | None,
    up: Up | None,
    declared: str | None,
    custom: Up,
    start: float,
) -> MarkerRecording:
    """The markers in metres and z up; NaN and three zeros are markers not seen."""
    if len(values) == 0 or not _is_number(rate):
        raise FormatError(f"{name}: expected rows of frames and a frame rate, got {rate[:20]!r}")
    fps, said = stated_rate(float(rate or "nan"), name, "frame rate")
    raw = MarkerRecording(
        name=name,
        marker_names=tuple(labels),
        positions=values.reshape(len(values), len(labels), 3),
        visible=np.ones((len(values), len(labels)), bool),
        fps=fps,
        decisions=(said,),
        start_time=start if np.isfinite(start) else 0.0,
    )
    return settle_markers(raw, unit=unit, up=up, declared=declared, usual_up=custom)
