"""Reads tables of labelled markers: Motive's .csv, Qualisys' .tsv and .trc; writes .trc.

TRC is written by OpenSim, OpenCap, Pose2Sim and Cortex, and here.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.coordinates import signed_axis
from recon.core.errors import FormatError
from recon.core.limits import FRAME_RATE, JOINTS, SAMPLES, TEXT, TIME
from recon.core.units import AXES, METRES, Axis, Up, parse_unit, snapped_rate, to_z_up
from recon.core.visible import visible
from recon.formats.replacing import write_text
from recon.formats.scan_times import MAX_OFF_FRAMES
from recon.formats.text_tables import (
    numbers_of_columns,
    read_rows,
    rows_of_whole_points,
    with_missing_frames,
)
from recon.formats.texts import decoded_text, read_bytes
from recon.mocap.recording import MarkerRecording, markers_in_metres, stated_rate


def read_motive(path: Path, *, unit: str | None = None, up: Up | None = None) -> MarkerRecording:
    """Read the markers of a .csv file that Motive exported (format 1.2 and later).

    Markers that Motive computed for rigid bodies and bones are taken if there are no others.
    Unlabelled markers are left out.

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
            "export markers from Motive, or BVH of the skeleton"
        )
    JOINTS.check(len(labels), name, "Name")
    SAMPLES.check(len(rows) * len(labels), name)
    wanted = [columns.get((label, axis), -1) for label in labels for axis in "XYZ"]
    data, width, notes = rows[start + 1 :], len(rows[start]), list[str]()
    if {what for _, _, what, _ in cells[2:]} == {"Position"}:
        data = list(rows_of_whole_points(data, 2, width, name, notes))
    values = numbers_of_columns(data, [0, 1, *wanted], name, most=width)
    rate = said.get("Export Frame Rate") or said.get("Capture Frame Rate") or ""
    declared = parse_unit(said.get("Length Units", ""))
    return _recording_in_metres(
        name, labels, values[:, 2:], rate, unit, up, declared, "y", values[:, :2], notes
    )


def read_qualisys(path: Path, *, unit: str | None = None, up: Up | None = None) -> MarkerRecording:
    """Read a .tsv file of Qualisys Track Manager; zeros are markers not seen.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or has no markers, or its unit or axis cannot be told.
    """
    name = path.name
    rows = [
        line.split("\t") for line in decoded_text(read_bytes(path)).splitlines() if line.strip()
    ]
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
    width, notes = first + 3 * len(labels), list[str]()
    stripped = ([cell.strip().replace(",", ".") for cell in row[:width]] for row in data)
    cells = list(rows_of_whole_points(stripped, first, width, name, notes))
    values = numbers_of_columns(cells, range(width), name, most=width)
    clock = values[:, :2] if timed else np.full((len(values), 2), np.nan)
    rate = (head.get("FREQUENCY") or [""])[0]
    return _recording_in_metres(
        name, labels, values[:, first:], rate, unit, up, "mm", "z", clock, notes
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".") or "nan")
    except ValueError:
        return False
    return True


def _number(cell: str) -> float:
    """Return the number that a cell holds, also with a decimal comma; NaN if it holds none."""
    return float(cell.replace(",", ".") or "nan") if _is_number(cell) else np.nan


def _recording_in_metres(
    name: str,
    labels: Sequence[str],
    values: Float[np.ndarray, "time numbers"],
    rate: str,
    unit: str | None,
    up: Up | None,
    declared: str | None,
    custom: Up,
    clock: Float[np.ndarray, "time 2"],
    notes: Sequence[str],
) -> MarkerRecording:
    """Make a recording in metres and z up of a table; NaN or three zeros mean not visible.

    Frame numbers and times are NaN where the table has none; the recording then starts at 0.
    """
    if len(values) == 0 or not _is_number(rate):
        raise FormatError(f"{name}: expected rows of frames and a frame rate, got {rate[:20]!r}")
    stated_rate(_number(rate), name, "frame rate")
    points, times, missing = _with_frames_of_times(
        values.reshape(len(values), len(labels), 3), clock, rate, name
    )
    fps, said = _frame_rate(rate, float(times[-1] - times[0]), len(points), name)
    raw = MarkerRecording(
        name=name,
        marker_names=tuple(labels),
        positions=points,
        visible=np.ones(points.shape[:2], bool),
        fps=fps,
        decisions=(said, *notes, *missing),
        start_time=float(times[0]) if np.isfinite(times[0]) else 0.0,
    )
    return markers_in_metres(raw, unit=unit, up=up, declared=declared, usual_up=custom)


_HEADER = 5
"""Lines before the numbers: type, keys, values, names, coordinates; a blank one may follow."""
_POSE2SIM = {f"{side}{joint}" for side in "LR" for joint in ("Hip", "Knee", "Ankle")}
"""Labels that all files of Pose2Sim have, whichever detector it used."""


def read_trc(path: Path, *, unit: str | None = None, up: Up | None = None) -> MarkerRecording:
    """Read a .trc file; a blank cell, NaN or three exact zeros are a marker not seen.

    Pose2Sim, which leaves out the blank line after the header, writes (y, z, x) of its cameras'
    world; this is undone first, so that its points stand where its calibration has them.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or its unit or up axis cannot be told.
    """
    name = path.name
    lines = decoded_text(read_bytes(path)).splitlines()
    if len(lines) <= _HEADER or not lines[0].lower().startswith("pathfiletype"):
        raise FormatError(f"{name}: expected a TRC file, five header lines from PathFileType on")
    header = dict(zip(lines[1].split(), lines[2].replace(",", ".").split(), strict=False))
    labels = _labels(lines[3])
    if not any(labels) or lines[3].split()[0].lower() != "frame#":
        raise FormatError(f"{name}: expected 'Frame# Time' and marker names in line 4")
    notes: list[str] = []
    clock, values, beyond = _parse_table(lines[_HEADER:], len(labels), name, notes)
    named = [k for k, label in enumerate(labels) if label]
    labels, values = [labels[k] for k in named], values[:, named]
    notes += [f"{beyond} columns of points without a label left out"] * (beyond > 0)
    rate, rows = header.get("DataRate", ""), len(values)
    values, times, missing = _with_frames_of_times(values, clock, rate, name)
    stated, found = header.get("NumFrames", "")[:9], max(rows, len(values))
    if stated.isdigit() and int(stated) > found:
        raise FormatError(
            f"{name}: expected {stated} frames (NumFrames), got {found}; the file is cut short: "
            "export or copy it again, or correct NumFrames in line 3"
        )
    if (np.diff(times) <= 0).any():
        notes.append("the column Time does not rise: frames are taken in the order of the file")
    custom: Up = "y"
    if set(labels) >= _POSE2SIM and lines[_HEADER].strip():
        notes.append("coordinates are y, z and x of Pose2Sim's world, whose z points up")
        values, custom = values[..., [2, 0, 1]], "z"
        if up is not None:
            up = signed_axis((AXES.index(up[0]) + 1) % 3, -1.0 if up.endswith("down") else 1.0)
    fps, note = _frame_rate(rate, float(times[-1] - times[0]), len(values), name)
    raw = MarkerRecording(
        name=name,
        marker_names=tuple(labels),
        positions=values,
        visible=np.ones(values.shape[:2], bool),
        fps=fps,
        decisions=(note, *notes, *missing),
        start_time=float(times[0]),
    )
    declared = parse_unit(header.get("Units", ""))
    return markers_in_metres(raw, unit=unit, up=up, declared=declared, usual_up=custom)


def _labels(line: str) -> list[str]:
    """Labels of the points in a TRC header; "" for a point without one.

    Each label stands above the first of its three columns; files with other gaps have no points
    without a label.
    """
    cells = [cell.strip() for cell in line.rstrip().split("\t")[2:]]
    if len(cells) > 1 and all(k % 3 == 0 for k, cell in enumerate(cells) if cell):
        return cells[::3]
    return [cell for cell in cells if cell]


def _parse_table(
    lines: list[str], markers: int, name: str, notes: list[str]
) -> tuple[Float[np.ndarray, "time 2"], Float[np.ndarray, "time markers 3"], int]:
    """Return frame numbers and times, coordinates, and how many more columns hold numbers."""
    width = 2 + 3 * markers
    JOINTS.check(markers, name, "line 4")
    SAMPLES.check(max(len(lines), 1) * markers, name)
    table = np.full((len(lines), width), np.nan)
    rows = beyond = 0
    split = (
        line.split("\t") if "\t" in line else line.split()
        for line in (one.replace(",", ".") for one in lines)  # decimal commas
        if line.strip()
    )
    for cells in rows_of_whole_points(split, 2, width, name, notes):
        try:
            row = [float(cell) if cell.strip() else np.nan for cell in cells]
        except ValueError as error:
            raise FormatError(f"{name}: expected numbers, got {' '.join(cells)[:60]!r}") from error
        more = [k for k in range(width, len(row)) if not np.isnan(row[k])]
        beyond = max(beyond, more[-1] + 1 - width if more else 0)
        table[rows, : len(row)] = row[:width]
        rows += 1
    table = table[:rows]
    if len(table) == 0 or np.isinf(table).any() or np.isnan(table[:, :2]).any():
        raise FormatError(f"{name}: expected rows of frame number, time and finite coordinates")
    TIME.check(table[:, 1], name, "column Time, row ")
    return table[:, :2], table[:, 2:].reshape(len(table), markers, 3), beyond


def _with_frames_of_times(
    values: Float[np.ndarray, "rows markers 3"],
    clock: Float[np.ndarray, "rows 2"],
    rate: str,
    name: str,
) -> tuple[Float[np.ndarray, "time markers 3"], Float[np.ndarray, " kept"], tuple[str, ...]]:
    """Leave out repeated rows, and insert frames that a table leaves out, by its times.

    Frames are inserted only if most steps are one frame of the stated rate, and all are whole
    ones. The times may be in another unit than seconds, in which most steps are one frame.

    Args:
        values: coordinates of every row.
        clock: frame number and time of every row; NaN where the table has none.
        rate: frames per second, as the file states it.
        name: of the file, for messages.

    Returns:
        Coordinates of every frame, times of the kept rows in seconds, and sentences that say so.
    """
    notes: tuple[str, ...] = ()
    again = np.array([False, *(np.diff(clock, axis=0) == 0).all(1)])
    if 0 < again.sum() < len(again) / 2:
        values, clock = values[~again], clock[~again]
        notes = (f"rows that repeat frame number and time are left out: {again.sum()}",)
    times, fps = clock[:, 1], _number(rate)
    if len(times) < 2 or not FRAME_RATE.holds(fps):
        return values, times, notes
    step = float(np.median(np.diff(times)))
    for unit, per_second in {"s": 1.0, "ms": 1e3, "microseconds": 1e6, "frames": fps}.items():
        frames = (times - times[0]) * (fps / per_second)
        index = np.rint(frames)
        if abs(step * fps / per_second - 1) > MAX_OFF_FRAMES:
            continue
        if unit != "s":
            notes += (f"times are in {unit}, by their steps of {step:g} and the frame rate",)
        if (np.abs(frames - index) <= MAX_OFF_FRAMES).all() and (np.diff(index) >= 1).all():
            values, missing = with_missing_frames(values, index, name)
            notes += missing
        return values, times / per_second, notes
    return values, times, notes


def _frame_rate(stated: str, span: float, frames: int, name: str) -> tuple[float, str]:
    """Return frames per second by the header, or by the times if these clearly contradict.

    Args:
        stated: text of the header.
        span: from the first to the last time, seconds.
        frames: number of frames, with those that the table leaves out.
        name: of the file, for messages.
    """
    header = _number(stated)
    measured = (frames - 1) / span if span > (frames - 1) / FRAME_RATE.high else 0.0
    if FRAME_RATE.holds(header) and (measured == 0 or abs(measured - header) <= 0.01 * header):
        return snapped_rate(header), f"{header:g} frames per second: stated by the file"
    if not FRAME_RATE.holds(measured):
        raise FormatError(f"{name}: neither the header nor the time column gives a frame rate")
    return snapped_rate(measured), (
        f"{measured:.4g} frames per second: by the time column, though the file states "
        f"{stated[:20]!r}"
    )


def write_trc(path: Path, recording: MarkerRecording, *, unit: str = "mm", up: Axis = "y") -> None:
    """Write markers as a TRC file, with blank cells where they are not visible.

    Args:
        path: file to write.
        recording: metres, z up.
        unit: of the numbers, one of `METRES` that the format knows.
        up: axis that points up in the file, as y does in OpenSim: the turn of `to_z_up`, undone.
    """
    values = recording.positions @ to_z_up(up) / METRES[unit]
    names, count, rate = recording.marker_names, recording.frames, f"{recording.fps:g}"
    values_line = [rate, rate, str(count), str(len(names)), unit, rate, "1", str(count)]
    shown = visible(path.name).replace("\n", " ")
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{shown}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame"
        "\tOrigNumFrames",
        "\t".join(values_line),
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)),
        "",
    ]
    for frame, (row, seen) in enumerate(zip(values, recording.visible, strict=True)):
        cells = [str(frame + 1), f"{recording.start_time + frame / recording.fps:.6f}"]
        for point, shown in zip(row.tolist(), seen.tolist(), strict=True):
            cells += [f"{x:.6f}" for x in point] if shown else ["", "", ""]
        lines.append("\t".join(cells))
    write_text(path, "\n".join(lines) + "\n")


def write_motive(path: Path, recording: MarkerRecording) -> None:
    """Write markers as a .csv file in Motive's table: metres, y up, blank where not visible."""
    names = [f"Unlabeled {n[1:]}" if n[:1] == "*" else n for n in recording.marker_names]
    names = ['"' + n.replace('"', '""') + '"' if set(n) & set(',"') else n for n in names]
    three = [name for name in names for _ in range(3)]
    rate = f"{recording.fps:g}"
    lines = [
        f"Format Version,1.23,Capture Frame Rate,{rate},Export Frame Rate,{rate},"
        "Length Units,Meters",
        "",
        ",".join(["", "Type", *["Marker"] * len(three)]),
        ",".join(["", "Name", *three]),
        ",".join(["", "", *["Position"] * len(three)]),
        ",".join(["Frame", "Time (Seconds)", *["X", "Y", "Z"] * len(names)]),
    ]
    values = recording.positions @ to_z_up("y")
    for frame, (row, seen) in enumerate(zip(values, recording.visible, strict=True)):
        cells = [str(frame), f"{recording.start_time + frame / recording.fps:.6f}"]
        for point, shown in zip(row.tolist(), seen.tolist(), strict=True):
            cells += [f"{x:.6f}" for x in point] if shown else ["", "", ""]
        lines.append(",".join(cells))
    write_text(path, "\n".join(lines) + "\n")
