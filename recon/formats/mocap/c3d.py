"""C3D: optical markers (Vicon, Qualisys, OptiTrack). The format: www.c3d.org, user guide 2021.

Read here and not through ezc3d because that crashes the process on damaged files; the two are
compared in the tests.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import FRAME_RATE, JOINTS, SAMPLES
from recon.core.units import Axis, parse_unit, snapped_rate
from recon.formats.mocap.recording import MarkerRecording, settle_markers
from recon.formats.opening import read_binary

_NUMBERS = 17
"""Numbers per segment and frame: a matrix and its reliability."""
_ORIGINS = {
    "thigh": "hip", "shank": "knee", "foot": "ankle", "toes": "foot", "uarm": "shoulder",
    "larm": "elbow", "hand": "wrist",
}  # fmt: skip
"""The joint at the origin of every segment that has one."""
_SIDES = {"l": "left", "r": "right"}
_ENDING = "_4x4"


def joint_centres(
    values: Float[np.ndarray, " numbers"],
    labels: Sequence[str],
    frames: int,
    path: Path,
    fps: float,
) -> MarkerRecording:
    """Joint centres, named left_hip, right_knee, ..., in the file's unit and axes.

    Args:
        values: numbers from the beginning of the data on.
        labels: of the segments, in their order.
        frames: how many there are.
        path: for messages.
        fps: frames per second.

    Raises:
        ValueError: when the data is cut short, or its segments are not known.
    """
    JOINTS.check(len(labels), path, "ROTATION:LABELS")
    SAMPLES.check(max(0, frames) * len(labels), path, "header")
    count = frames * len(labels) * _NUMBERS
    if frames < 1 or not labels or len(values) < count:
        raise FormatError(
            f"{path}: a C3D file of rotations promises {frames} frames of {len(labels)} segments, "
            f"{count} numbers in all; the file has {len(values)} and is cut short or damaged"
        )
    table = values[:count].reshape(frames, len(labels), _NUMBERS)
    joints = {k: name for k, label in enumerate(labels) if (name := _joint(label)) is not None}
    if len(joints) < len(_ORIGINS):
        raise FormatError(
            f"{path}: its points are poses of segments (group ROTATION), of which "
            f"{len(joints)} are known ({', '.join(labels[:8])}, ...); expected l_thigh_4X4, "
            "r_shank_4X4, ... as Theia3D writes them, or points"
        )
    origins = table[:, list(joints), 12:15]
    visible = np.isfinite(table[:, list(joints)]).all(-1) & (table[:, list(joints), 16] >= 0)
    visible &= (origins != 0).any(-1)
    used = [labels[k] for k in joints]
    left = [label for label in labels if label not in used]
    return MarkerRecording(
        name=path.name,
        marker_names=tuple(joints.values()),
        positions=np.where(visible[..., None], origins, 0.0),
        visible=visible,
        fps=fps,
        decisions=(
            f"{fps:g} frames per second: stated by the file",
            f"no points but poses of segments (group ROTATION): the origins of {len(used)} are "
            f"joint centres; left out: {', '.join(left) or 'none'}, and all rotations",
        ),
    )


def _joint(label: str) -> str | None:
    """left_hip of l_thigh_4X4; None for segments whose origin is no joint of ours."""
    side, _, segment = label.lower().removesuffix(_ENDING).partition("_")
    if side not in _SIDES or segment not in _ORIGINS:
        return None
    return f"{_SIDES[side]}_{_ORIGINS[segment]}"


_BLOCK = 512
_INTEL, _DEC, _MIPS = 84, 85, 86
_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters of POINT that list trajectories which are no points (Plug-in-Gait outputs)."""
_TYPES = {1: "u1", 2: "i2", 4: "f4"}
"""Parameter types by their size; -1 is text."""

_Parameter = np.ndarray | tuple[str, ...]


@dataclass(frozen=True)
class _Header:
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


def read_c3d(path: Path, *, unit: str | None = None, up: Axis | None = None) -> MarkerRecording:
    """Read the markers of a .c3d file; angles, forces and the like among them are left out.

    A marker is not visible where its residual is negative, or it is NaN or exactly the origin.
    The unit is POINT:UNITS; POINT:Y_SCREEN hints at the up axis but does not overrule the body.
    Files that hold poses of segments instead of points (group ROTATION) give joint centres.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or cut short, or its unit or up axis cannot be told.
    """
    data = read_binary(path)
    try:
        processor, header = _read_header(data, path)
        groups = _read_parameters(data, processor)
        point, trial = groups.get("POINT", {}), groups.get("TRIAL", {})
        if header.points == 0 and "ROTATION" in groups:
            return _read_rotations(data, processor, header, groups, path, unit, up)
        if header.points == 0:
            raise FormatError(f"{path}: expected a C3D file with points, but its header has none")
        if not point:
            raise FormatError(
                f"{path}: damaged C3D file, it has no parameters for POINT (labels, rate, unit)"
            )
        values, residuals = _read_points(data, processor, header, trial, path)
    except (struct.error, IndexError) as error:
        # an offset in the file leads out of it
        raise FormatError(f"{path}: damaged C3D file, it ends where more was promised") from error
    names = _labels(point, header.points)
    outputs = {label for key in _OUTPUTS for label in _texts(point, key)}
    chosen = [k for k, name in enumerate(names) if name not in outputs]
    rate = header.rate
    stated = point.get("RATE")
    if isinstance(stated, np.ndarray) and stated.size == 1 and stated.flat[0] > 0:
        rate = float(stated.flat[0])
    FRAME_RATE.check(rate, path, "POINT:RATE")
    if not chosen:
        raise FormatError(f"{path}: expected markers, but all points are angles, forces and such")
    values, residuals = values[:, chosen], residuals[:, chosen]
    visible = np.isfinite(values).all(-1) & (residuals >= 0) & (values != 0).any(-1)
    fps = snapped_rate(rate)
    notes = [f"{fps:g} frames per second: stated by the file"]
    left = [name for name in names if name in outputs]
    if left:
        notes.append(f"{len(left)} angles, forces and other outputs left out: {_shortened(left)}")
    if header.analog > 0:
        channels = [name for name in _texts(groups.get("ANALOG", {}), "LABELS") if name]
        notes.append(
            f"analog channels left out: {_shortened(channels) if channels else 'without names'}"
        )
    first = _first_frame(header, trial)
    if first > 1:
        notes.append(f"frame {first} is the first, at {(first - 1) / fps:.3f} s")
    short, note = _without_subject([names[k] for k in chosen])
    raw = MarkerRecording(
        name=path.name,
        marker_names=tuple(short),
        positions=np.where(visible[..., None], values, 0.0),
        visible=visible,
        fps=fps,
        decisions=(*notes, *note),
        start_time=(first - 1) / fps,
    )
    declared = parse_unit(" ".join(_texts(point, "UNITS")))
    hint = " ".join(_texts(point, "Y_SCREEN")).lower().lstrip("+")
    axis: Axis | None = hint if hint in ("x", "y", "z") else None  # type: ignore[assignment]
    return settle_markers(raw, unit=unit, up=up, declared=declared, usual_up=axis)


def _read_header(data: bytes, path: Path) -> tuple[int, _Header]:
    if len(data) < 2 * _BLOCK or data[1] != 0x50 or data[0] == 0:
        raise FormatError(f"{path}: expected a C3D file, but its first block is no C3D header")
    processor = data[(data[0] - 1) * _BLOCK + 3]
    if processor not in (_INTEL, _DEC, _MIPS):
        raise FormatError(f"{path}: damaged C3D file, its parameter section is missing")
    words = np.frombuffer(data, ">u2" if processor == _MIPS else "<u2", 10, 2).tolist()
    scale, rate = _floats(data[12:16] + data[20:24], processor).tolist()
    header = _Header(words[0], words[1], words[2], words[3], scale, words[7], rate)
    empty = header.points == 0  # then the scale says nothing
    if header.data_start == 0 or not (empty or (np.isfinite(scale) and scale != 0)):
        raise FormatError(f"{path}: damaged C3D file, its header states no data and no scale")
    return processor, header


def _floats(data: bytes, processor: int) -> np.ndarray:
    """Four-byte numbers of the three processors, as double precision."""
    # NaN of the signalling kind, which damage may make, is no reason for a warning
    with np.errstate(invalid="ignore"):
        if processor == _INTEL:
            return np.frombuffer(data, "<f4").astype(np.float64)
        if processor == _MIPS:
            return np.frombuffer(data, ">f4").astype(np.float64)
        # VAX F: the halves are swapped and the exponent is biased by two more than IEEE's
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)
        bits = (halves[:, 0].astype(np.uint32) << 16) | halves[:, 1]
        values = bits.view(np.float32).astype(np.float64) / 4
        return np.where(bits & 0x7F800000, values, 0.0)


def _read_parameters(data: bytes, processor: int) -> dict[str, dict[str, _Parameter]]:
    """Parameters of all groups that have any, by the names of the groups."""
    place = (data[0] - 1) * _BLOCK + 4
    order = ">" if processor == _MIPS else "<"
    groups: dict[int, str] = {}
    found: dict[int, dict[str, _Parameter]] = {}
    while place + 2 <= len(data) and data[place] != 0:
        length, group = struct.unpack_from("bb", data, place)
        length = abs(length)
        name = data[place + 2 : place + 2 + length].decode("latin-1").strip().upper()
        after = place + 2 + length
        step = struct.unpack_from(f"{order}h", data, after)[0]
        if group < 0:
            groups[-group] = name
        else:
            found.setdefault(group, {})[name] = _parameter(data, after + 2, processor)
        if step <= 0:
            break
        place = after + step
    return {groups.get(number, ""): values for number, values in found.items()}


def _parameter(data: bytes, place: int, processor: int) -> _Parameter:
    size, rank = struct.unpack_from("bB", data, place)
    shape = data[place + 2 : place + 2 + rank]
    count = math.prod(shape)
    start = place + 2 + rank
    raw = data[start : start + abs(size) * count]
    if len(raw) < abs(size) * count or len(shape) < rank:
        raise IndexError(start)
    if size == -1:
        width = shape[0] if rank > 0 else 1
        text = raw.decode("latin-1")
        return tuple(text[k : k + width].strip("\0 ") for k in range(0, len(text), width or 1))
    if size == 4:
        return _floats(raw, processor)
    return np.frombuffer(raw, (">" if processor == _MIPS else "<") + _TYPES.get(size, "u1"))


def _read_points(
    data: bytes, processor: int, header: _Header, trial: dict[str, _Parameter], path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the file's unit, frames x points x 3, and residuals (negative: not seen)."""
    real = header.scale < 0
    width, start = 4 * header.points + header.analog, (header.data_start - 1) * _BLOCK
    frames = _frame_count(header, trial)
    size = frames * width * (4 if real else 2)
    if frames < 1 or start + size > len(data):
        whole = max(0, len(data) - start) // max(1, width * (4 if real else 2))
        raise FormatError(
            f"{path}: the C3D header promises {frames} frames of {header.points} points, "
            f"{start + size} bytes in all; the file has {len(data)}, which hold {whole} frames, "
            "and is cut short or damaged"
        )
    JOINTS.check(header.points, path, "header")
    SAMPLES.check(frames * header.points, path, "header")
    kind = "f4" if real else "i2"
    order = ">" if processor == _MIPS else "<"
    table = np.frombuffer(data, order + kind, frames * width, start).reshape(frames, width)
    # analog samples stand behind the points of every frame
    table = np.ascontiguousarray(table[:, : 4 * header.points])
    values = _floats(table.tobytes(), processor) if real else table.astype(np.float64)
    values = values.reshape(frames, -1, 4)
    return values[..., :3] * (1.0 if real else header.scale), values[..., 3]


def _read_rotations(
    data: bytes,
    processor: int,
    header: _Header,
    groups: dict[str, dict[str, _Parameter]],
    path: Path,
    unit: str | None,
    up: Axis | None,
) -> MarkerRecording:
    """Joint centres of a file of segments' poses."""
    rotation, trial = groups["ROTATION"], groups.get("TRIAL", {})
    place = rotation.get("DATA_START")
    if not isinstance(place, np.ndarray) or place.size != 1:
        raise FormatError(f"{path}: damaged C3D file, ROTATION:DATA_START is missing")
    raw = data[(int(place.flat[0]) - 1) * _BLOCK :]
    stated = rotation.get("RATE", groups.get("POINT", {}).get("RATE"))
    rate = float(stated.flat[0]) if isinstance(stated, np.ndarray) and stated.size else header.rate
    FRAME_RATE.check(rate, path, "ROTATION:RATE")
    fps, first = snapped_rate(rate), _first_frame(header, trial)
    found = joint_centres(
        _floats(raw[: len(raw) // 4 * 4], processor), _texts(rotation, "LABELS"),
        _frame_count(header, trial), path, fps,
    )  # fmt: skip
    found = replace(found, start_time=(first - 1) / fps)
    declared = parse_unit(" ".join(_texts(groups.get("POINT", {}), "UNITS")[:1]))
    return settle_markers(found, unit=unit, up=up, declared=declared, usual_up="z")


def _frame_count(header: _Header, trial: dict[str, _Parameter]) -> int:
    """Frames by the header's 16-bit numbers, or by TRIAL's longer ones where it has them."""
    if header.last == 0xFFFF and (bounds := _long_bounds(trial)) is not None:
        return bounds[1] - bounds[0] + 1
    return header.last - header.first + 1


def _first_frame(header: _Header, trial: dict[str, _Parameter]) -> int:
    """Number of the first frame, counted from 1; some writers count from 0."""
    bounds = _long_bounds(trial) if header.last == 0xFFFF else None
    return max(1, header.first if bounds is None else bounds[0])


def _long_bounds(trial: dict[str, _Parameter]) -> tuple[int, int] | None:
    """First and last frame by TRIAL's 32-bit numbers, which are stored as pairs."""
    bounds = [trial.get(key) for key in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD")]
    pairs = [b for b in bounds if isinstance(b, np.ndarray) and b.size == 2]
    if len(pairs) < 2:
        return None
    first, last = (int(np.uint16(b[0])) + (int(np.uint16(b[1])) << 16) for b in pairs)
    return first, last


def _texts(point: dict[str, _Parameter], key: str) -> tuple[str, ...]:
    value = point.get(key, ())
    return value if isinstance(value, tuple) else ()


def _labels(point: dict[str, _Parameter], count: int) -> list[str]:
    labels = list(_texts(point, "LABELS"))
    number = 2
    while f"LABELS{number}" in point:
        labels += _texts(point, f"LABELS{number}")
        number += 1
    labels = labels[:count] + [""] * (count - len(labels))
    return [label or f"*{k + 1}" for k, label in enumerate(labels)]


def _shortened(names: Sequence[str]) -> str:
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    return ", ".join(names[:6]) + more


def _without_subject(names: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """Labels without "Subject:", when they all belong to one subject."""
    subjects = {name.split(":")[0] for name in names if ":" in name}
    if len(subjects) != 1:
        return names, ()
    return [name.split(":", 1)[-1] for name in names], (f"subject {subjects.pop()}",)
