"""Reads Acclaim's ASF/AMC: a skeleton file, and motions that refer to it.

Each bone becomes one joint at the bone's near end, named after the bone, and a last bone also
`<bone>_end` at its far end. World rotation of a bone: R = R_parent C M C^-1, with C the bone's
`axis` (fixed axes, in the stated order) and M its motion; the rest pose has every R = I.
"""

import io
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.core.errors import FormatError
from recon.core.limits import ANGLE, JOINTS, POSITION, SAMPLES, TABLE
from recon.core.units import Up
from recon.formats.texts import decoded_text, read_bytes
from recon.mocap.recording import (
    SkeletonRecording,
    finite_numbers,
    posed_skeleton,
    skeleton_in_metres,
)

CMU_RATE = 120.0
"""Frames per second of the CMU database; an AMC file does not state its rate."""
_CMU_LENGTH = 0.45
"""`:units length` of CMU's files, whose unit is then an inch over 0.45."""


@dataclass(frozen=True)
class _Bone:
    name: str
    direction: np.ndarray
    """Vector from the near to the far end, in the file's unit."""
    axis: np.ndarray
    """Matrix C (3 x 3) of the axes about which the bone's angles turn."""
    channels: tuple[str, ...]
    """rx ry rz (tx ty tz for the root), in the order of the motion's numbers."""


@dataclass(frozen=True)
class _Skeleton:
    bones: dict[str, _Bone]
    parents: dict[str, str]
    """Parents come first; the root has none."""
    origin: np.ndarray
    declared: str | None
    """Unit, where the file is of CMU's kind."""


def read_amc(
    path: Path,
    *,
    skeleton: Path | None = None,
    fps: float = CMU_RATE,
    unit: str | None = None,
    up: Up | None = None,
) -> SkeletonRecording:
    """Read an .amc or .amc.xz file and the skeleton in its .asf file.

    Args:
        path: of the motion.
        skeleton: of the .asf; None looks beside the motion (see `find_skeleton`).
        fps: frames per second, which the format leaves out.
        unit: see `skeleton_in_metres`.
        up: see `skeleton_in_metres`; by custom y.

    Raises:
        FileNotFoundError: when the motion or a skeleton is not there.
        ValueError: when one of them is damaged, or they do not belong together.
    """
    data = read_bytes(path)
    skeleton = find_skeleton(path) if skeleton is None else skeleton
    tree = _parse_asf(decoded_text(read_bytes(skeleton, TABLE)), skeleton.name)
    motion, degrees = _parse_amc(decoded_text(data), path.name)
    recording = _recording_of(tree, motion, degrees, path.name, fps)
    said = (f"skeleton {skeleton.name}", f"{fps:g} frames per second: not in the file")
    recording = replace(recording, decisions=said)
    return skeleton_in_metres(recording, unit=unit, up=up, declared=tree.declared)


def find_skeleton(path: Path) -> Path:
    """Return the path of the skeleton (.asf) of an .amc file, in the same folder.

    The skeleton's name is the longest that the motion's name begins with (07.asf for 07_01.amc,
    HDM_bk.asf for HDM_bk_kick_01.amc). Without such a name, the only .asf there is taken.

    Raises:
        FileNotFoundError: when there is none.
    """
    words = path.name.split(".")[0].split("_")
    found = sorted(
        p for p in path.parent.iterdir() if p.name.lower().endswith((".asf", ".asf.xz"))
    )
    by_name = {p.name.split(".")[0]: p for p in reversed(found)}
    for count in range(len(words), 0, -1):
        if (skeleton := by_name.get("_".join(words[:count]))) is not None:
            return skeleton
    if len(found) != 1:
        raise FileNotFoundError(
            f"{path}: needs its skeleton, but {path.parent} holds no {words[0]}.asf; put it there"
        )
    return found[0]


def _axis_matrix(angles: list[float], order: str, degrees: bool, name: str) -> np.ndarray:
    """Rotation matrix of three angles about fixed axes, applied in the order `order`."""
    if sorted(order.upper()) != ["X", "Y", "Z"]:
        raise FormatError(f"{name}: expected an axis order such as XYZ, got {order!r}")
    ANGLE.check(angles if degrees else np.rad2deg(angles), name, "axis")
    return Rotation.from_euler(order.lower(), angles, degrees=degrees).as_matrix()


def _parse_asf(text: str, name: str) -> _Skeleton:
    sections: dict[str, list[list[str]]] = {}
    current: list[list[str]] = []
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if words and words[0].startswith(":"):
            current = sections.setdefault(words[0][1:].lower(), [])
            words = words[1:]
        if words:
            current.append(words)
    if missing := [s for s in ("root", "bonedata", "hierarchy") if s not in sections]:
        raise FormatError(f"{name}: expected an ASF skeleton, but there is no :{missing[0]}")
    units = {words[0].lower(): words[-1].lower() for words in sections.get("units", [])}
    degrees = not units.get("angle", "deg").startswith("rad")
    length = finite_numbers([units.get("length", "1")], 1, f"{name}: units length")[0]
    root, origin = _parse_root(sections["root"], degrees, name)
    bones = {"root": root}
    for block in _bone_blocks(sections["bonedata"]):
        bone = _parse_bone(block, degrees, name)
        bones[bone.name] = bone
    parents: dict[str, str] = {}
    for words in sections["hierarchy"]:
        if words[0] in ("begin", "end"):
            continue
        for word in words:
            if word not in bones:
                raise FormatError(f"{name}: the hierarchy names {word!r}, which is no bone")
        if words[0] != "root" and words[0] not in parents:
            raise FormatError(f"{name}: the hierarchy gives {words[0]!r} children before a parent")
        for child in words[1:]:
            if child in parents or child == "root":
                raise FormatError(f"{name}: the hierarchy names {child!r} twice")
            parents[child] = words[0]
    if not parents:
        raise FormatError(f"{name}: the hierarchy is empty or cut short")
    return _Skeleton(bones, parents, origin, "cmu" if length == _CMU_LENGTH else None)


def _bone_blocks(lines: list[list[str]]) -> list[dict[str, list[str]]]:
    blocks: list[dict[str, list[str]]] = []
    for words in lines:
        if words[0] == "begin":
            blocks.append({})
        elif blocks and words[0] != "end":
            blocks[-1].setdefault(words[0].lower(), words[1:])
    return blocks


def _parse_root(lines: list[list[str]], degrees: bool, name: str) -> tuple[_Bone, np.ndarray]:
    fields = {words[0].lower(): words[1:] for words in lines}
    angles = finite_numbers(
        fields.get("orientation", ["0", "0", "0"]), 3, f"{name}: root orientation"
    )
    origin = np.array(
        finite_numbers(fields.get("position", ["0", "0", "0"]), 3, f"{name}: position")
    )
    order = "".join(fields.get("axis", ["XYZ"]))
    axis = _axis_matrix(angles, order, degrees, name)
    channels = tuple(w.lower() for w in fields.get("order", ["tx", "ty", "tz", "rx", "ry", "rz"]))
    if not set(channels) <= {"tx", "ty", "tz", "rx", "ry", "rz"}:
        raise FormatError(f"{name}: expected root order TX TY TZ RX RY RZ, got {channels}")
    return _Bone("root", np.zeros(3), axis, channels), origin


def _parse_bone(block: dict[str, list[str]], degrees: bool, name: str) -> _Bone:
    if missing := [k for k in ("name", "direction", "length", "axis") if not block.get(k)]:
        raise FormatError(f"{name}: expected every bone to have a {missing[0]}")
    place = f"{name}: bone {block['name'][0]}"
    direction = np.array(finite_numbers(block["direction"], 3, place))
    POSITION.check(direction, place, "direction")
    length = finite_numbers(block["length"], 1, place)[0]
    order = "".join(block["axis"][3:]) or "XYZ"
    axis = _axis_matrix(finite_numbers(block["axis"][:3], 3, place), order, degrees, place)
    channels = tuple(word.lower() for word in block.get("dof", []))
    if not set(channels) <= {"rx", "ry", "rz", "l"}:
        raise FormatError(f"{place}: expected dof rx, ry, rz or l, got {' '.join(channels)}")
    norm = float(np.linalg.norm(direction))
    return _Bone(block["name"][0], direction * (length / norm if norm else 0.0), axis, channels)


def _parse_amc(text: str, name: str) -> tuple[dict[str, np.ndarray], bool]:
    """Parse the values (frames, channels) of every bone, and whether angles are in degrees."""
    degrees, numbers = True, array("d")
    rows: dict[str, tuple[array[float], array[int]]] = {}
    for line in io.StringIO(text):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            degrees = False if words[0].upper() == ":RADIANS" else degrees
        elif len(words) == 1 and words[0].isdecimal():
            numbers.append(float(words[0][:15]))  # thousands of digits in a damaged file
        else:
            try:
                values, lengths = rows.setdefault(words[0], (array("d"), array("i")))
                values.extend([float(word) for word in words[1:]])
                lengths.append(len(words) - 1)
            except ValueError as error:
                raise FormatError(
                    f"{name}: expected a bone and its numbers, got {line[:60]!r}"
                ) from error
        if len(rows) > JOINTS.high:
            JOINTS.check(len(rows), name)
    frames = len(numbers)
    if frames == 0 or "root" not in rows:
        raise FormatError(f"{name}: expected an AMC motion, each frame with a line for the root")
    SAMPLES.check(frames * len(rows), name)
    if len(wrong := np.flatnonzero(np.diff(numbers) != 1)) > 0:
        before, after = numbers[wrong[0]], numbers[wrong[0] + 1]
        raise FormatError(
            f"{name}: expected frames numbered one by one, got {after:.0f} after {before:.0f}: "
            "frames are missing or out of order. Export the motion again, or make a file of each "
            "part; if none is missing, correct the numbers"
        )
    arrays: dict[str, np.ndarray] = {}
    for bone, (values, lengths) in rows.items():
        width = len(values) // frames
        if len(lengths) != frames or set(lengths) != {width}:
            raise FormatError(
                f"{name}: expected equally many numbers for {bone!r} in all {frames} frames, got "
                f"{len(values)} in {len(lengths)}; the file is cut short"
            )
        arrays[bone] = np.frombuffer(values).reshape(frames, width)
        if not np.isfinite(arrays[bone]).all():
            raise FormatError(f"{name}: the numbers of {bone!r} hold NaN or infinity")
    return arrays, degrees


def _recording_of(
    tree: _Skeleton, motion: dict[str, np.ndarray], degrees: bool, name: str, fps: float
) -> SkeletonRecording:
    frames = len(motion["root"])
    JOINTS.check(2 * len(tree.bones), name, "bones and their ends, of which there are ")
    SAMPLES.check(frames * 2 * len(tree.bones), name)
    if unknown := set(motion) - set(tree.bones):
        raise FormatError(f"{name}: moves {sorted(unknown)[0]!r}, which the skeleton lacks")
    order = ["root", *tree.parents]
    number = {bone: k for k, bone in enumerate(order)}
    inner = set(tree.parents.values())
    tips = [bone for bone in tree.parents if bone not in inner]
    names = (*order, *(f"{bone}_end" for bone in tips))
    parents = (-1, *(number[tree.parents[b]] for b in order[1:]), *(number[b] for b in tips))
    # a bone's `direction` is the offset of its children's joint
    offsets = np.stack([np.zeros(3) if p < 0 else tree.bones[order[p]].direction for p in parents])

    def local_poses() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for joint, (title, offset) in enumerate(zip(names, offsets, strict=True)):
            turn, shift = np.eye(3), np.zeros(3)
            if joint < len(order) and title in motion:
                turn, shift = _bone_motion(tree.bones[title], motion[title], degrees, name)
            yield (tree.origin + shift if title == "root" else offset), turn

    positions, orientations = posed_skeleton(parents, local_poses(), frames)
    return SkeletonRecording(name, names, parents, offsets, positions, orientations, fps, ())


def _bone_motion(
    bone: _Bone, values: np.ndarray, degrees: bool, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return a bone's rotation C M C^-1 (C axes, M angles) and translation; ignore lengths."""
    if values.shape[1] != len(bone.channels):
        raise FormatError(
            f"{name}: expected {len(bone.channels)} numbers ({' '.join(bone.channels)}) for "
            f"{bone.name!r}, got {values.shape[1]}; the skeleton is of another subject"
        )
    turn, shift = Rotation.identity(len(values)), np.zeros((len(values), 3))
    for column, channel in zip(values.T, bone.channels, strict=True):
        if channel.startswith("r"):
            ANGLE.check(column if degrees else np.rad2deg(column), name, f"{bone.name} {channel}")
            turn = Rotation.from_euler(channel[1], column[:, None], degrees=degrees) * turn
        elif channel.startswith("t"):
            shift[:, "xyz".index(channel[1])] = column
    return bone.axis @ turn.as_matrix() @ bone.axis.T, shift


def recording_files(recording: Path) -> list[Path]:
    """Return the files from which a recording (FILE, or FILE::MEMBER) is read.

    Raises:
        FileNotFoundError: when the skeleton of an .amc file is missing.
    """
    path = Path(str(recording).partition("::")[0])
    if path.name.lower().endswith((".amc", ".amc.xz")) and path.is_file():
        return [path, find_skeleton(path)]
    return [path]
