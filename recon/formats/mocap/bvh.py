"""BVH: a tree of joints with offsets and Euler channels (Biovision), plain or xz-compressed.

Position channels replace a joint's OFFSET, as Blender and MotionBuilder read them, unless they
are zero throughout. The file states neither unit nor up axis; by custom y is up.
"""

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import ANGLE, FRAME_RATE, FRAMES, JOINTS, SAMPLES
from recon.core.units import Axis, snapped_rate
from recon.formats.mocap.recording import SkeletonRecording, settle_skeleton
from recon.formats.opening import decode, numbers_in, read_bytes

_LOST = (("Spine1", 1.0), ("LeftHand", 0.5), ("RightHand", 0.5))
"""Joint of a lost bone, and its length as a share of the bone before it."""
_SIGNATURE = {"LHipJoint", "RHipJoint", "LowerBack", "Neck1", "LeftFingerBase", "RightFingerBase"}


def restore_lost_bones(recording: SkeletonRecording) -> SkeletonRecording:
    """Give the lost bones their length back; any other skeleton is returned as it is."""
    if not set(recording.joint_names) >= _SIGNATURE:
        return recording
    offsets, positions = recording.rest_offsets.copy(), recording.positions.copy()
    restored: list[str] = []
    for name, share in _LOST:
        joint = recording.joint(name)
        children = [c for c, p in enumerate(recording.parents) if p == joint]
        if np.abs(offsets[children]).max() > 1e-6:
            continue
        bone = offsets[joint] * share
        offsets[children] = bone
        below = recording.descendants(joint)[1:]
        positions[:, below] += (recording.orientations[:, joint] @ bone)[:, None]
        restored.append(f"{name} {np.linalg.norm(bone):.3f} m")
    if not restored:
        return recording
    reason = f"bones lost by the cgspeed conversion restored: {', '.join(restored)}"
    return dataclasses.replace(
        recording,
        rest_offsets=offsets,
        positions=positions,
        decisions=(*recording.decisions, reason),
    )


_CHANNEL = re.compile(r"^([XYZ])(position|rotation)$", re.IGNORECASE)
_TIMING = re.compile(r"\s*frames\s*:\s*(\S+)\s+frame\s+time\s*:\s*(\S+)", re.IGNORECASE)


@dataclass(frozen=True)
class _Hierarchy:
    names: list[str]
    parents: list[int]
    offsets: list[list[float]]
    channels: list[list[tuple[int, bool]]]
    """Channels of every joint, (axis, is a rotation), in the order of the file."""


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
        raise FormatError(f"{name}: expected a BVH file, but there is no line MOTION")
    tree = _parse_hierarchy(head, name)
    values, fps = _parse_motion(body, tree, name)
    orientations, positions, offsets = _pose(tree, values)
    del values
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
    taken: set[str] = set()
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
                raise FormatError(
                    f"{name}: expected one tree of joints, got {line[:50]!r} outside"
                )
            parent = open_joints[-1] if open_joints else -1
            current = len(tree.names)
            title = f"{tree.names[parent]}_end" if keyword == "END" else rest.strip()
            if not title or title in taken:
                raise FormatError(f"{name}: expected a new joint name, got {line[:60]!r}")
            taken.add(title)
            JOINTS.check(len(taken), name)
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
            raise FormatError(f"{name}: expected a line of a BVH hierarchy, got {line[:60]!r}")
    if open_joints or not tree.names:
        raise FormatError(f"{name}: the BVH hierarchy is cut short or empty")
    if missing := [n for n, o in zip(tree.names, tree.offsets, strict=True) if not o]:
        raise FormatError(f"{name}: expected an OFFSET of three numbers for joint {missing[0]!r}")
    return tree


def _numbers(words: Sequence[str], count: int, place: str) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FormatError(f"{place}: expected numbers, got {' '.join(words)[:60]!r}") from error
    if len(values) != count or not np.isfinite(values).all():
        raise FormatError(f"{place}: expected {count} numbers, got {' '.join(words)[:60]!r}")
    return values


def _parse_channels(words: list[str], name: str) -> list[tuple[int, bool]]:
    found = [_CHANNEL.match(word) for word in words[1:]]
    if not words or words[0] != str(len(found)) or not all(found):
        raise FormatError(
            f"{name}: expected CHANNELS with their number and names such as Xposition or "
            f"Zrotation, got {' '.join(words)[:80]!r}"
        )
    channels = [("XYZ".index(m[1].upper()), m[2].lower() == "rotation") for m in found if m]
    turns = sum(1 for _, turn in channels if turn)
    shifts = [axis for axis, turn in channels if not turn]
    if turns > 3 or len(set(shifts)) != len(shifts):
        raise FormatError(f"{name}: expected at most three rotations and one position per axis")
    return channels


def _parse_motion(body: str, tree: _Hierarchy, name: str) -> tuple[np.ndarray, float]:
    timing = _TIMING.match(body)
    if timing is None:
        raise FormatError(f"{name}: expected 'Frames: N' and 'Frame Time: seconds' after MOTION")
    try:
        frames, step = int(timing[1]), float(timing[2])
    except ValueError as error:
        raise FormatError(f"{name}: expected numbers, got {timing[0].strip()[:80]!r}") from error
    width = sum(len(channels) for channels in tree.channels)
    FRAMES.check(frames, name, "Frames")
    SAMPLES.check(frames * len(tree.names), name, "Frames")
    FRAME_RATE.check(1 / step if step > 0 else 0.0, name, "Frame Time")
    try:
        values = numbers_in(body, frames * width, timing.end())
    except ValueError as error:
        raise FormatError(
            f"{name}: expected {frames} frames of {width} channels, but {str(error)[:100]}; the "
            "file is cut short, damaged, or its header is wrong"
        ) from error
    if width == 0 or not np.isfinite(values).all():
        raise FormatError(f"{name}: the motion has no channels, or holds NaN or infinity")
    values = values.reshape(frames, width)
    turns = [turn for channels in tree.channels for _, turn in channels]
    ANGLE.check(values, name, "[frame, channel]", seen=np.broadcast_to(turns, values.shape))
    return values, snapped_rate(1 / step)


def _pose(tree: _Hierarchy, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World orientations and positions, and offsets, in the units of the file."""
    frames, joints = len(values), len(tree.names)
    offsets = np.array(tree.offsets)
    orientations, positions = np.empty((frames, joints, 3, 3)), np.empty((frames, joints, 3))
    column = 0
    for joint, (parent, channels) in enumerate(zip(tree.parents, tree.channels, strict=True)):
        columns = values[:, column : column + len(channels)]
        column += len(channels)
        shift, local = _motion_of(channels, columns, offsets[joint], root=parent < 0)
        if parent < 0:
            orientations[:, joint], positions[:, joint] = local, shift
        else:
            above = orientations[:, parent]
            orientations[:, joint] = above @ local
            positions[:, joint] = positions[:, parent] + (above @ shift[..., None])[..., 0]
    return orientations, positions, offsets


def _motion_of(
    channels: list[tuple[int, bool]], columns: np.ndarray, offset: np.ndarray, *, root: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Place (frames, 3) of a joint in its parent, and its rotation (frames, 3, 3)."""
    shift = np.tile(offset, (len(columns), 1))
    moved = [(axis, k) for k, (axis, turn) in enumerate(channels) if not turn]
    if moved and (root or columns[:, [k for _, k in moved]].any()):
        shift[:, [axis for axis, _ in moved]] = columns[:, [k for _, k in moved]]
    local = np.broadcast_to(np.eye(3), (len(columns), 3, 3))
    for k, (axis, turn) in enumerate(channels):
        if turn:
            local = local @ about_axis(axis, np.deg2rad(columns[:, k]))
    return shift, local


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
