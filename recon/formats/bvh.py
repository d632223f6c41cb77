"""BVH: a tree of joints with offsets and Euler channels (Biovision), plain or xz-compressed.

Position channels replace a joint's OFFSET, as Blender and MotionBuilder read them, unless they
are zero throughout. The file states neither unit nor up axis; by custom y is up.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.formats.cgspeed import restore_lost_bones
from recon.formats.files import decode, read_bytes
from recon.recording import SkeletonRecording, settle_skeleton
from recon.units import Axis, snapped_rate

_CHANNEL = re.compile(r"^([XYZ])(position|rotation)$", re.IGNORECASE)
_TIMING = re.compile(r"\s*frames\s*:\s*(\S+)\s+frame\s+time\s*:\s*(\S+)", re.IGNORECASE)


@dataclass(frozen=True)
class _Hierarchy:
    names: list[str]
    parents: list[int]
    offsets: list[list[float]]
    channels: list[list[tuple[int, bool]]]
    """Of every joint: (axis, is a rotation), in the order of the file."""


def read_bvh(path: Path, *, unit: str | None = None, up: Axis | None = None) -> SkeletonRecording:
    """Read a .bvh or .bvh.xz file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or its unit or up axis cannot be told.
    """
    return parse_bvh(decode(read_bytes(path)), path.name, unit=unit, up=up)


def parse_bvh(
    text: str, name: str, *, unit: str | None = None, up: Axis | None = None
) -> SkeletonRecording:
    """The recording in the text of a BVH file; see `read_bvh`."""
    head, keyword, body = text.partition("MOTION")
    if not keyword:
        raise ValueError(f"{name}: expected a BVH file, but there is no line MOTION")
    tree = _parse_hierarchy(head, name)
    values, fps = _parse_motion(body, sum(len(c) for c in tree.channels), name)
    orientations, positions, offsets = _pose(tree, values)
    raw = SkeletonRecording(
        name=name,
        joint_names=tuple(tree.names),
        parents=tuple(tree.parents),
        rest_offsets=offsets,
        positions=positions,
        orientations=orientations,
        fps=fps,
        decisions=(f"{fps:g} frames per second: stated by the file",),
    )
    return restore_lost_bones(settle_skeleton(raw, unit=unit, up=up, usual_up="y"))


def _parse_hierarchy(head: str, name: str) -> _Hierarchy:
    tree = _Hierarchy([], [], [], [])
    open_joints: list[int] = []
    current = -1
    lines = head.replace("{", "\n{\n").replace("}", "\n}\n").splitlines()
    for line in filter(None, (line.strip() for line in lines)):
        word, _, rest = line.replace("\t", " ").partition(" ")
        keyword = word.upper()
        if keyword == "HIERARCHY":
            continue
        if keyword in ("ROOT", "JOINT", "END"):
            if (keyword == "ROOT") != (len(tree.names) == 0) or not (
                open_joints or not tree.names
            ):
                raise ValueError(f"{name}: expected one tree of joints, got {line!r} outside it")
            parent = open_joints[-1] if open_joints else -1
            current = len(tree.names)
            title = f"{tree.names[parent]}_end" if keyword == "END" else rest.strip()
            if not title or title in tree.names:
                raise ValueError(f"{name}: expected a new joint name, got {line!r}")
            tree.names.append(title)
            tree.parents.append(parent)
            tree.offsets.append([])
            tree.channels.append([])
        elif keyword == "{" and current >= 0:
            open_joints.append(current)
        elif keyword == "}" and open_joints:
            open_joints.pop()
        elif keyword == "OFFSET" and open_joints:
            tree.offsets[open_joints[-1]] = _numbers(rest.split(), 3, f"{name}: OFFSET")
        elif keyword == "CHANNELS" and open_joints:
            tree.channels[open_joints[-1]] = _parse_channels(rest.split(), name)
        else:
            raise ValueError(f"{name}: expected a line of a BVH hierarchy, got {line[:60]!r}")
    if open_joints or not tree.names:
        raise ValueError(f"{name}: the BVH hierarchy is cut short or empty")
    if missing := [n for n, o in zip(tree.names, tree.offsets, strict=True) if not o]:
        raise ValueError(f"{name}: expected an OFFSET of three numbers for joint {missing[0]!r}")
    return tree


def _numbers(words: Sequence[str], count: int, place: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise ValueError(f"{place}: expected numbers, got {' '.join(words)[:60]!r}") from error
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"{place}: expected {count} numbers, got {' '.join(words)[:60]!r}")
    return values


def _parse_channels(words: list[str], name: str) -> list[tuple[int, bool]]:
    found = [_CHANNEL.match(word) for word in words[1:]]
    if not words or words[0] != str(len(found)) or not all(found):
        raise ValueError(
            f"{name}: expected CHANNELS with their number and names such as Xposition or "
            f"Zrotation, got {' '.join(words)[:80]!r}"
        )
    channels = [("XYZ".index(m[1].upper()), m[2].lower() == "rotation") for m in found if m]
    turns = sum(1 for _, turn in channels if turn)
    shifts = [axis for axis, turn in channels if not turn]
    if turns > 3 or len(set(shifts)) != len(shifts):
        raise ValueError(f"{name}: expected at most three rotations and one position per axis")
    return channels


def _parse_motion(body: str, width: int, name: str) -> tuple[np.ndarray, float]:
    timing = _TIMING.match(body)
    if timing is None:
        raise ValueError(f"{name}: expected 'Frames: N' and 'Frame Time: seconds' after MOTION")
    try:
        frames, step = int(timing[1]), float(timing[2])
    except ValueError as error:
        raise ValueError(f"{name}: expected numbers, got {timing[0].strip()!r}") from error
    if frames < 1 or not 1e-5 < step < 100:
        raise ValueError(f"{name}: expected frames and a frame time, got {frames} and {step} s")
    try:
        values = np.array(list(map(float, body[timing.end() :].split())))
    except ValueError as error:
        raise ValueError(f"{name}: the motion holds something that is no number") from error
    if width == 0 or values.size != frames * width:
        raise ValueError(
            f"{name}: expected {frames} frames of {width} channels, got {values.size} numbers; "
            "the file is cut short or its header is wrong"
        )
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: the motion holds NaN or infinity")
    return values.reshape(frames, width), snapped_rate(1 / step)


def _pose(tree: _Hierarchy, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World orientations and positions, and offsets, in the units of the file."""
    frames, joints = len(values), len(tree.names)
    offsets = np.array(tree.offsets)
    shifts = np.broadcast_to(offsets, (frames, joints, 3)).copy()
    slots: dict[tuple[int, int], list[tuple[int, int]]] = {}
    column = 0
    for joint, channels in enumerate(tree.channels):
        first, slot = column, 0
        for axis, turn in channels:
            if turn:
                slots.setdefault((slot, axis), []).append((joint, column))
                slot += 1
            column += 1
        moved = [(axis, first + k) for k, (axis, turn) in enumerate(channels) if not turn]
        columns = [c for _, c in moved]
        if moved and (tree.parents[joint] < 0 or values[:, columns].any()):
            shifts[:, joint, [axis for axis, _ in moved]] = values[:, columns]
    local = np.broadcast_to(np.eye(3), (frames, joints, 3, 3))
    for slot in range(3):
        factor = np.broadcast_to(np.eye(3), (frames, joints, 3, 3)).copy()
        for axis in range(3):
            if chosen := slots.get((slot, axis)):
                which, source = (list(part) for part in zip(*chosen, strict=True))
                factor[:, which] = about_axis(axis, np.deg2rad(values[:, source]))
        local = local @ factor
    orientations, positions = np.empty_like(local), np.empty_like(shifts)
    for joint, parent in enumerate(tree.parents):
        if parent < 0:
            orientations[:, joint], positions[:, joint] = local[:, joint], shifts[:, joint]
        else:
            above = orientations[:, parent]
            orientations[:, joint] = above @ local[:, joint]
            turned = (above @ shifts[:, joint, :, None])[..., 0]
            positions[:, joint] = positions[:, parent] + turned
    return orientations, positions, offsets


def about_axis(axis: int, angle: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape 3 3"]:
    """Rotation about x, y or z (0, 1, 2) by an angle in radians."""
    cosine, sine = np.cos(angle), np.sin(angle)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.zeros((*angle.shape, 3, 3))
    matrix[..., axis, axis] = 1.0
    matrix[..., one, one] = matrix[..., two, two] = cosine
    matrix[..., two, one] = sine
    matrix[..., one, two] = -sine
    return matrix
