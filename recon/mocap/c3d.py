"""Reads optical markers from C3D files, by the user guide of 2021 (www.c3d.org).

The library ezc3d is not used, as it crashes on damaged files; tests compare both readers.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import JOINTS, SAMPLES
from recon.core.units import Up, parse_unit
from recon.formats.texts import read_binary
from recon.mocap.recording import MarkerRecording, markers_in_metres, stated_rate

BLOCK = 512
INTEL, DEC, MIPS = 84, 85, 86
_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters of POINT that list trajectories which are no points (Plug-in-Gait outputs)."""
_TYPES = {1: "u1", 2: "i2", 4: "f4"}
"""Parameter types by their size; -1 is text."""
_MOST_FRAMES = 0xFFFF
"""Largest number of a frame that the header can state."""
_POSE_NUMBERS = 17
"""Numbers per segment and frame: a matrix and its reliability."""
_ORIGINS = {
    "thigh": "hip", "shank": "knee", "foot": "ankle", "toes": "foot", "uarm": "shoulder",
    "larm": "elbow", "hand": "wrist",
}  # fmt: skip
"""The joint at the origin of every segment that has one."""
_SIDES = {"l": "left", "r": "right"}

Parameters = Mapping[str, np.ndarray | tuple[str, ...]]
"""The parameters of a group by their names."""


@dataclass(frozen=True)
class Header:
    """The header of a C3D file: where and how samples are stored."""

    processor: int
    points: int
    analog: int
    """Analog samples per frame of points."""
    first: int
    last: int
    scale: float
    """Units per integer; negative when numbers are stored as they are."""
    data_start: int
    """Block, from 1."""
    rate: float
    analog_rows: int
    """Samples of every analog channel per frame of points."""

    @property
    def byte_order(self) -> str:
        """Byte order of the file, as numpy and struct write it."""
        return ">" if self.processor == MIPS else "<"

    @property
    def frames(self) -> int:
        """Number of frames of points."""
        return self.last - self.first + 1

    @property
    def frame_bytes(self) -> int:
        """Bytes that a frame of points and analog samples takes."""
        return (4 * self.points + self.analog) * (4 if self.scale < 0 else 2)

    def held(self, data: bytes) -> int:
        """Return for how many frames a file's bytes have room."""
        room = len(data) - (self.data_start - 1) * BLOCK
        return max(0, room) // max(1, self.frame_bytes)


def read_c3d(path: Path, *, unit: str | None = None, up: Up | None = None) -> MarkerRecording:
    """Read the markers of a .c3d file; angles and forces among its points are left out.

    A marker is not visible where its residual is negative, or it is NaN or exactly the origin.
    The unit is POINT:UNITS; POINT:Y_SCREEN hints at the up axis but does not overrule the body.
    Files that hold poses of segments instead of points (group ROTATION) give joint centres.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or cut short, or its unit or up axis cannot be told.
    """
    data = read_binary(path)
    header, groups = read_head(data, path)
    try:
        if header.points == 0 and "ROTATION" in groups:
            raw = _joint_centres(data, header, groups, path)
        else:
            raw = _read_markers(data, header, groups, path)
    except (struct.error, IndexError) as error:
        # an offset that the file states points beyond its end
        raise FormatError(f"{path}: damaged C3D file, it ends before all promised data") from error
    point = groups.get("POINT", {})
    hint = " ".join(texts(point, "Y_SCREEN")).lower().lstrip("+") if header.points else "z"
    usual: Up | None = hint if hint in ("x", "y", "z") else None  # type: ignore[assignment]
    first = max(1, header.first)  # some files say 0
    if first > 1:
        said = f"frame {first} is the first, at {(first - 1) / raw.fps:.3f} s"
        raw = replace(raw, decisions=(*raw.decisions, said))
    raw = replace(raw, start_time=(first - 1) / raw.fps)
    units = texts(point, "UNITS")
    declared = parse_unit(" ".join(units if header.points else units[:1]))
    return markers_in_metres(raw, unit=unit, up=up, declared=declared, usual_up=usual)


def _read_markers(
    data: bytes, header: Header, groups: Mapping[str, Parameters], path: Path
) -> MarkerRecording:
    """Read the points other than a model's angles and forces, in the file's unit and axes."""
    point = groups.get("POINT", {})
    if header.points == 0:
        raise FormatError(f"{path}: expected a C3D file with points, but its header has none")
    if not point:
        raise FormatError(
            f"{path}: damaged C3D file, it has no parameters for POINT (labels, rate, unit)"
        )
    values, residuals = _read_points(data, header, path)
    names, chosen = chosen_points(header, groups)
    fps, said = stated_rate(positive_number(point, "RATE") or header.rate, path, "POINT:RATE")
    if not chosen:
        raise FormatError(f"{path}: expected markers, but all points are angles, forces and such")
    notes = [said]
    if header.last > _MOST_FRAMES:
        notes.append(f"{header.frames} frames by its parameters: its header counts to 65,535")
    elif header.last == _MOST_FRAMES and (more := header.held(data) - header.frames) > BLOCK:
        notes.append(
            "frames up to 65,535 are read, as the header counts no more and POINT:LONG_FRAMES is "
            f"missing; the file has room for {more} more"
        )
    if left := [name for k, name in enumerate(names) if k not in set(chosen)]:
        said = f"{len(left)} angles, forces and other outputs left out: {_first_names(left)}"
        notes.append(said)
    if header.analog > 0:
        channels = [name for name in texts(groups.get("ANALOG", {}), "LABELS") if name]
        notes.append(
            f"analog channels left out: {_first_names(channels) if channels else 'without names'}"
        )
    names = [names[k] for k in chosen]
    subjects = {name.split(":")[0] for name in names if ":" in name}
    # beside Bob:LASI, a marker LASI is on somebody else
    if len(subjects) == 1 and not {f"{min(subjects)}:{name}" for name in names} & set(names):
        names = [name.split(":", 1)[-1] for name in names]
        notes.append(f"subject {subjects.pop()}")
    return MarkerRecording(
        name=path.name,
        marker_names=tuple(names),
        positions=values[:, chosen],
        visible=residuals[:, chosen] >= 0,
        fps=fps,
        decisions=tuple(notes),
    )


def chosen_points(header: Header, groups: Mapping[str, Parameters]) -> tuple[list[str], list[int]]:
    """Names of all points, and indices of those that are positions, not angles or forces."""
    names = _point_labels(point := groups.get("POINT", {}), header.points)
    outputs = {label for key in _OUTPUTS for label in texts(point, key)}
    return names, [k for k, name in enumerate(names) if name not in outputs]


def _joint_centres(
    data: bytes, header: Header, groups: Mapping[str, Parameters], path: Path
) -> MarkerRecording:
    """Read segments' origins as joint centres (left_hip, ...), in the file's unit and axes.

    Raises:
        ValueError: when the data is cut short, or its segments are not known.
    """
    rotation, labels = groups["ROTATION"], texts(groups["ROTATION"], "LABELS")
    if not (start := int(positive_number(rotation, "DATA_START"))):
        raise FormatError(f"{path}: damaged C3D file, ROTATION:DATA_START is missing")
    raw = data[(start - 1) * BLOCK :]
    values = _doubles(raw[: len(raw) // 4 * 4], header.processor)
    rate = positive_number(rotation, "RATE") or positive_number(groups.get("POINT", {}), "RATE")
    fps, said = stated_rate(rate or header.rate, path, "ROTATION:RATE")
    frames = header.frames
    JOINTS.check(len(labels), path, "ROTATION:LABELS")
    SAMPLES.check(max(0, frames) * len(labels), path, "header")
    count = frames * len(labels) * _POSE_NUMBERS
    if frames < 1 or not labels or len(values) < count:
        raise FormatError(
            f"{path}: a C3D file of rotations promises {frames} frames of {len(labels)} segments, "
            f"{count} numbers in all; the file has {len(values)} and is cut short or damaged"
        )
    table = values[:count].reshape(frames, len(labels), _POSE_NUMBERS)
    joints: dict[int, str] = {}
    for k, label in enumerate(labels):
        side, _, segment = label.lower().removesuffix("_4x4").partition("_")
        if side in _SIDES and segment in _ORIGINS:
            joints[k] = f"{_SIDES[side]}_{_ORIGINS[segment]}"
    if len(joints) < len(_ORIGINS):
        raise FormatError(
            f"{path}: its points are poses of segments (group ROTATION), of which "
            f"{len(joints)} are known ({', '.join(labels[:8])}, ...); expected l_thigh_4X4, "
            "r_shank_4X4, ... as Theia3D writes them, or points"
        )
    known = table[:, list(joints)]
    left = [label for k, label in enumerate(labels) if k not in joints]
    return MarkerRecording(
        name=path.name,
        marker_names=tuple(joints.values()),
        positions=known[..., 12:15],
        visible=np.isfinite(known).all(-1) & (known[..., 16] >= 0),
        fps=fps,
        decisions=(
            said,
            f"no points but poses of segments (group ROTATION): the origins of {len(joints)} are "
            f"joint centres; left out: {', '.join(left) or 'none'}, and all rotations",
        ),
    )


def read_header(data: bytes, path: Path) -> Header:
    """Read the header of a file's bytes."""
    if len(data) < 2 * BLOCK or data[1] != 0x50 or data[0] == 0:
        raise FormatError(f"{path}: expected a C3D file, but its first block is no C3D header")
    processor = data[(data[0] - 1) * BLOCK + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise FormatError(f"{path}: damaged C3D file, its parameter section is missing")
    words = np.frombuffer(data, ">u2" if processor == MIPS else "<u2", 10, 2).tolist()
    scale, rate = _doubles(data[12:16] + data[20:24], processor).tolist()
    empty = words[0] == 0  # a file without points may state any scale
    if words[7] == 0 or not (empty or (np.isfinite(scale) and scale != 0)):
        raise FormatError(f"{path}: damaged C3D file, its header states no data and no scale")
    sizes = words[0], words[1], words[2], words[3]
    return Header(processor, *sizes, scale, words[7], rate, words[8])


def read_head(data: bytes, path: Path) -> tuple[Header, dict[str, Parameters]]:
    """Read the header of a file's bytes and the parameters of all groups, keyed by group name.

    First and last frame are those of TRIAL or POINT where the header's 16 bits cannot count them.
    """
    header = read_header(data, path)
    try:
        groups = read_parameters(data, header)
    except (struct.error, IndexError) as error:
        # an offset that the file states points beyond its end
        raise FormatError(f"{path}: damaged C3D file, it ends before all promised data") from error
    point, trial = groups.get("POINT", {}), groups.get("TRIAL", {})
    bounds = [trial.get(key) for key in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD")]
    pairs = [b for b in bounds if isinstance(b, np.ndarray) and b.size == 2]
    counts = [min(positive_number(point, key), 1e9) for key in ("LONG_FRAMES", "FRAMES")]
    stated = [(header.first, header.first + int(count) - 1) for count in counts]
    if len(pairs) == 2:
        with np.errstate(invalid="ignore"):  # damaged files may state NaN
            first, last = (int(np.uint16(b[0])) + (int(np.uint16(b[1])) << 16) for b in pairs)
        if header.last == _MOST_FRAMES:
            return replace(header, first=first, last=last), groups
        stated.append((first, last))
    for first, last in stated:
        if last > _MOST_FRAMES and header.frames < last - first + 1 <= header.held(data):
            header = replace(header, first=first, last=last)
    return header, groups


def _doubles(data: bytes, processor: int) -> np.ndarray:
    """Convert four-byte numbers, as one of C3D's three processors stores them, to doubles."""
    # damaged files may hold signalling NaNs, of which numpy would warn
    with np.errstate(invalid="ignore"):
        if processor != DEC:
            return np.frombuffer(data, ">f4" if processor == MIPS else "<f4").astype(np.float64)
        # VAX F numbers have swapped halves, and an exponent larger by two than IEEE's
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)
        bits = (halves[:, 0].astype(np.uint32) << 16) | halves[:, 1]
        values = bits.view(np.float32).astype(np.float64) / 4
        return np.where(bits & 0x7F800000, values, 0.0)


def read_parameters(data: bytes, header: Header) -> dict[str, Parameters]:
    """Read the parameters of all groups, keyed by group name."""
    place = (data[0] - 1) * BLOCK + 4
    groups: dict[int, str] = {}
    found: dict[int, dict[str, np.ndarray | tuple[str, ...]]] = {}
    while place + 2 <= len(data) and data[place] != 0:
        length, group = struct.unpack_from("bb", data, place)
        after = place + 2 + abs(length)
        name = data[place + 2 : after].decode("latin-1").strip().upper()
        step = struct.unpack_from(f"{header.byte_order}h", data, after)[0]
        if group < 0:
            groups[-group] = name
        else:
            found.setdefault(group, {})[name] = _read_parameter(data, after + 2, header)
        if step <= 0:
            break
        place = after + step
    return {groups.get(number, ""): values for number, values in found.items()}


def _read_parameter(data: bytes, place: int, header: Header) -> np.ndarray | tuple[str, ...]:
    size, rank = struct.unpack_from("bB", data, place)
    start = place + 2 + rank
    shape = data[place + 2 : start]
    raw = data[start : start + abs(size) * math.prod(shape)]
    if len(raw) < abs(size) * math.prod(shape) or len(shape) < rank:
        raise IndexError(start)
    if size == -1:
        width = shape[0] if rank > 0 else 1
        text = raw.decode("latin-1")
        return tuple(text[k : k + width].strip("\0 ") for k in range(0, len(text), width or 1))
    if size == 4:
        return _doubles(raw, header.processor)
    return np.frombuffer(raw, header.byte_order + _TYPES.get(size, "u1"))


def _read_points(data: bytes, header: Header, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read positions (frames, points, 3) in the file's unit, and residuals (negative: unseen)."""
    JOINTS.check(header.points, path, "header")
    # a frame holds the numbers of its points, then analog samples, which are not read here
    values = read_numbers(data, header, path, slice(4 * header.points))
    values = values.reshape(len(values), -1, 4)
    return values[..., :3] * (1.0 if header.scale < 0 else header.scale), values[..., 3]


def read_numbers(
    data: bytes, header: Header, path: Path, columns: slice, integer: str = "i2"
) -> np.ndarray:
    """Read columns of the block of points and analog data (frames, columns), unscaled."""
    real = header.scale < 0
    width, start = 4 * header.points + header.analog, (header.data_start - 1) * BLOCK
    frames = header.frames
    size = frames * header.frame_bytes
    if frames < 1 or start + size > len(data):
        raise FormatError(
            f"{path}: the C3D header promises {frames} frames of {header.points} points, "
            f"{start + size} bytes in all; the file has {len(data)}, which hold "
            f"{header.held(data)} frames, and is cut short or damaged"
        )
    SAMPLES.check(frames * header.points, path, "header")
    kind = header.byte_order + ("f4" if real else integer)
    table = np.frombuffer(data, kind, frames * width, start).reshape(frames, width)
    table = np.ascontiguousarray(table[:, columns])
    if not real:
        return table.astype(np.float64)
    return _doubles(table.tobytes(), header.processor).reshape(table.shape)


def positive_number(group: Parameters, key: str) -> float:
    """Return the number that a parameter states, or 0 if it is missing or not positive."""
    value = group.get(key)
    stated = isinstance(value, np.ndarray) and value.size == 1 and value.flat[0] > 0
    return float(value.flat[0]) if stated else 0.0  # type: ignore[union-attr]


def texts(group: Parameters, key: str) -> tuple[str, ...]:
    """Return the texts of a C3D parameter, or none if it is missing."""
    value = group.get(key, ())
    return value if isinstance(value, tuple) else ()


def _point_labels(point: Parameters, count: int) -> list[str]:
    labels = list(texts(point, "LABELS"))
    number = 2
    while f"LABELS{number}" in point:
        labels += texts(point, f"LABELS{number}")
        number += 1
    labels = labels[:count] + [""] * (count - len(labels))
    return [label or f"*{k + 1}" for k, label in enumerate(labels)]


def _first_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return ", ".join(names[:6]) + more
