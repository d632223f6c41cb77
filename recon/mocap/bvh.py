"""Reads Biovision's BVH: a tree of joints with offsets, and Euler angles of every frame.

Position channels replace a joint's OFFSET, as Blender and MotionBuilder read them, unless they
are zero throughout. The file states neither unit nor up axis; by custom y is up.
"""

import dataclasses
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.core.errors import FormatError
from recon.core.limits import ANGLE, FRAMES, JOINTS, SAMPLES
from recon.core.units import Up
from recon.formats.texts import decoded_text, parsed_numbers, read_bytes, with_decimal_points
from recon.mocap.recording import (
    SkeletonRecording,
    finite_numbers,
    posed_skeleton,
    skeleton_in_metres,
    stated_rate,
)

_LOST = (("Spine1", 1.0), ("LeftHand", 0.5), ("RightHand", 0.5))
"""Joint of a lost bone, and its length as a share of the bone before it."""
_SIGNATURE = {"LHipJoint", "RHipJoint", "LowerBack", "Neck1", "LeftFingerBase", "RightFingerBase"}


def restore_lost_bones(recording: SkeletonRecording) -> SkeletonRecording:
    """Restore bones that a known exporter writes with length zero; keep other skeletons."""
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


_DECIMAL_COMMA = re.compile(r"\d,\d")
_CHANNEL = re.compile(r"^([XYZ])(position|rotation)$", re.IGNORECASE)
_MOTION = re.compile(r"(?<![^\r\n])[ \t]*MOTION\b", re.IGNORECASE)
_TIMING = re.compile(r"\s*frames\s*:\s*(\S+)\s+frame\s+time\s*:\s*(\S+)", re.IGNORECASE)


_TURNS = 0.5
"""Range of a channel, in any unit, from which on a body moves."""


@dataclass
class _Joint:
    name: str
    parent: int
    offset: list[float]
    channels: list[tuple[int, bool]]
    """(axis, is a rotation), in the order of the file."""


def read_bvh(path: Path, *, unit: str | None = None, up: Up | None = None) -> SkeletonRecording:
    """Read a .bvh or .bvh.xz file.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or its unit or up axis cannot be told.
    """
    return parse_bvh(decoded_text(read_bytes(path)), path.name, unit=unit, up=up)


def parse_bvh(
    text: str, name: str, *, unit: str | None = None, up: Up | None = None
) -> SkeletonRecording:
    """Parse the text of a BVH file, as `read_bvh` does."""
    text = with_decimal_points(text, _DECIMAL_COMMA)
    # search for MOTION only as far as joints can reach: each takes less than 1000 characters
    if (middle := _MOTION.search(text, 0, int(1000 * JOINTS.high))) is None:
        raise FormatError(f"{name}: expected a BVH file, but there is no line MOTION")
    joints = parse_hierarchy(text[: middle.start()], name)
    values, (fps, said) = _parse_motion(text[middle.end() :], joints, name)
    parents = tuple(joint.parent for joint in joints)
    positions, orientations = posed_skeleton(parents, _local_poses(joints, values), len(values))
    raw = SkeletonRecording(
        name=name,
        joint_names=tuple(joint.name for joint in joints),
        parents=parents,
        rest_offsets=np.array([joint.offset for joint in joints]),
        positions=positions,
        orientations=orientations,
        fps=fps,
        decisions=(said,),
    )
    return restore_lost_bones(skeleton_in_metres(raw, unit=unit, up=up))


def parse_hierarchy(head: str, name: str) -> list[_Joint]:
    """Parse the joints in the text before the motion, parents first.

    Raises:
        ValueError: when it is no tree of joints with offsets.
    """
    joints: list[_Joint] = []
    taken: set[str] = set()
    open_joints: list[int] = []
    lines = head.replace("{", "\n{\n").replace("}", "\n}\n").splitlines()
    for line in filter(None, (line.strip() for line in lines)):
        word, _, rest = line.replace("\t", " ").partition(" ")
        keyword = word.upper()
        if keyword == "HIERARCHY":
            continue
        if keyword in ("ROOT", "JOINT", "END"):
            if (keyword == "ROOT") != (not joints) or (joints and not open_joints):
                raise FormatError(
                    f"{name}: expected one tree of joints, got {line[:50]!r} outside of it"
                )
            parent = open_joints[-1] if open_joints else -1
            title = f"{joints[parent].name}_end" if keyword == "END" else rest.strip()
            if not title or title in taken:
                raise FormatError(f"{name}: expected a new joint name, got {line[:60]!r}")
            taken.add(title)
            JOINTS.check(len(taken), name)
            joints.append(_Joint(title, parent, [], []))
        elif keyword == "{" and joints:
            open_joints.append(len(joints) - 1)
        elif keyword == "}" and open_joints:
            open_joints.pop()
        elif keyword == "OFFSET" and open_joints:
            joints[open_joints[-1]].offset = finite_numbers(rest.split(), 3, f"{name}: OFFSET")
        elif keyword == "CHANNELS" and open_joints:
            joints[open_joints[-1]].channels = _parse_channels(rest.split(), name)
        else:
            raise FormatError(f"{name}: expected a line of a BVH hierarchy, got {line[:60]!r}")
    if open_joints or not joints:
        raise FormatError(f"{name}: the BVH hierarchy is cut short or empty")
    if missing := [joint.name for joint in joints if not joint.offset]:
        raise FormatError(f"{name}: expected an OFFSET of three numbers for joint {missing[0]!r}")
    return joints


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


def _parse_motion(
    body: str, joints: list[_Joint], name: str
) -> tuple[np.ndarray, tuple[float, str]]:
    """Parse the values of all frames and channels, and the frame rate."""
    timing = _TIMING.match(body)
    if timing is None:
        raise FormatError(f"{name}: expected 'Frames: N' and 'Frame Time: seconds' after MOTION")
    try:
        frames, step = int(timing[1]), float(timing[2].replace(",", "."))
    except ValueError as error:
        raise FormatError(f"{name}: expected numbers, got {timing[0].strip()[:80]!r}") from error
    width = sum(len(joint.channels) for joint in joints)
    FRAMES.check(frames, name, "Frames")
    SAMPLES.check(frames * len(joints), name, "Frames")
    if step > 1:
        raise FormatError(
            f"{name}: expected 'Frame Time' in seconds, got {step:g}, as if in milliseconds or "
            "frames per second: write 0.033333 for 30 frames per second"
        )
    rate = stated_rate(1 / step if step > 0 else 0.0, name, "Frame Time")
    try:
        values = parsed_numbers(body, frames * width, timing.end())
    except ValueError as error:
        raise FormatError(
            f"{name}: expected {frames} frames of {width} channels, but {str(error)[:100]}; the "
            "file is cut short, damaged, or its header is wrong"
        ) from error
    if width == 0 or not np.isfinite(values).all():
        raise FormatError(f"{name}: the motion has no channels, or holds NaN or infinity")
    values = values.reshape(frames, width)
    turns = [turn for joint in joints for _, turn in joint.channels]
    ANGLE.check(values, name, "[frame, channel]", seen=np.broadcast_to(turns, values.shape))
    moved = values[:, turns]
    if (np.abs(moved) <= np.pi).all() and np.ptp(moved, axis=0).max(initial=0.0) > _TURNS:
        said = "no angle is larger than 3.14: if they are radians, write them in degrees"
        return values, (rate[0], f"{rate[1]}; {said}")
    return values, rate


def _local_poses(
    joints: list[_Joint], values: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Position (frames, 3) and rotation of every joint relative to its parent, in order."""
    column = 0
    for joint in joints:
        channels = joint.channels
        columns = values[:, column : column + len(channels)]
        column += len(channels)
        shift, turn = np.tile(joint.offset, (len(values), 1)), Rotation.identity(len(values))
        moved = [(axis, k) for k, (axis, turns) in enumerate(channels) if not turns]
        if moved and (joint.parent < 0 or columns[:, [k for _, k in moved]].any()):
            shift[:, [axis for axis, _ in moved]] = columns[:, [k for _, k in moved]]
        for k, (axis, turns) in enumerate(channels):
            if turns:
                turn = turn * Rotation.from_euler("xyz"[axis], columns[:, [k]], degrees=True)
        yield shift, turn.as_matrix()
