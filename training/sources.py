"""Finds and reads the recordings that priors are trained on.

Skeletons go through the conversion of `recon convert --all`, markers through that of `recon
convert`. Two sources have readers here, because no other program writes their files: motions of
the DeepMimic humanoid, and the packed markers of UI-PRMD.
"""

import csv
import json
import lzma
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.batch.collection import SourceClip, clips_by_collection
from recon.core.errors import FormatError
from recon.core.skeleton import joint_index
from recon.core.units import snapped_rate
from recon.formats.texts import decoded_text, read_bytes
from recon.ingest.maps import SkeletonMap
from recon.mocap.bvh import read_bvh
from recon.mocap.c3d import read_c3d
from recon.mocap.recording import (
    MarkerRecording,
    SkeletonRecording,
    drop_lead_in,
    markers_in_metres,
    posed_skeleton,
    skeleton_in_metres,
)

FIRST, MORE = "mocap", "mocap_more"
"""Folders of skeletons: those of version 0.2.0, and those that came later."""
COMMON = "one common skeleton"
"""Words of a note that say that the bones are nobody's own."""
_COMMON = {"cmu_daz", "cmu_windows", "cmu_deepmimic"}
"""Later collections on a common skeleton; what their root does does not fit its legs."""
_LIST = Path(__file__).with_name("free_recordings.toml")
"""Marker recordings of single people that are learned from."""
MARKERS, HUMANOID, CMU_WINDOWS = "ui_prmd", "cmu_deepmimic", "cmu_windows"


def skeleton_clips(data: Path) -> list[list[SourceClip]]:
    """List all recordings of skeletons, one list per collection.

    Args:
        data: folder of all real recordings.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when a manifest is damaged.
    """
    folders = sorted(manifest.parent for manifest in (data / MORE).glob("*/manifest.csv"))
    more = [_clips_of_manifest(one) for one in folders if one.name not in (HUMANOID, CMU_WINDOWS)]
    return [*clips_by_collection(data / FIRST), *more]


def _clips_of_manifest(folder: Path) -> list[SourceClip]:
    """List the recordings of a collection that its manifest names."""
    with (folder / "manifest.csv").open(newline="", encoding="utf-8-sig") as file:
        return [_clip_of_row(folder, row) for row in csv.DictReader(file)]


def _clip_of_row(folder: Path, row: dict[str, str]) -> SourceClip:
    # column `clip` of these manifests names the take; a take may have several windows
    notes = row | {"action": row["description"]}
    if folder.name in _COMMON:
        notes["skeleton"] = COMMON
    return SourceClip(folder.name, row["path"].split(".")[0], folder / row["path"], None, notes)


def marker_clips(data: Path) -> list[SourceClip]:
    """All recordings of markers for training or for testing."""
    table = tomllib.loads(_LIST.read_text(encoding="utf-8"))
    found = [
        SourceClip("observations", row["clip"], data / row["path"], None,
                   {"action": row["motion"], "subject": row["person"]})
        for row in table["recording"]
        if "clip" in row
    ]  # fmt: skip
    return found + _clips_of_manifest(data / "observations" / MARKERS)


def clips_of_shared_skeleton(data: Path, collection: str) -> list[SourceClip]:
    """List a collection's clips, whose people all have one skeleton that needs its own reader."""
    return _clips_of_manifest(data / MORE / collection)


def read_markers(clip: SourceClip) -> MarkerRecording:
    """Read the recording of markers of a clip.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged.
    """
    return read_packed_markers(clip.path) if clip.collection == MARKERS else read_c3d(clip.path)


_PLUG_IN_GAIT = (
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAK", "LSHO", "LUPA", "LELB",
    "LFRM", "LWRA", "LWRB", "LFIN", "RSHO", "RUPA", "RELB", "RFRM", "RWRA", "RWRB", "RFIN", "LASI",
    "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB", "LANK", "LHEE", "LTOE", "RTHI", "RKNE", "RTIB",
    "RANK", "RHEE", "RTOE",
)  # fmt: skip
_PACKED_RATE, _PACKED_METRES = 100.0, 1e-5
FASTEST_MARKER = 15.0
"""Metres per second: a marker that is faster has got the label of another."""


def read_packed_markers(path: Path) -> MarkerRecording:
    """Markers of a UI-PRMD clip: int32 hundredths of a millimetre, differences along time.

    Markers at the origin are missing. Where a marker jumps, it is taken as not seen on both sides.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when its size is not that of whole frames.
    """
    try:
        raw = lzma.decompress(path.read_bytes())
        steps = np.frombuffer(raw, "<i4").reshape(3 * len(_PLUG_IN_GAIT), -1).T
    except (lzma.LZMAError, ValueError) as error:
        raise FormatError(f"{path}: expected 39 packed markers (UI-PRMD), but {error}") from error
    places = _PACKED_METRES * steps.astype(np.int64).cumsum(0).reshape(len(steps), -1, 3)
    seen = (places != 0).any(-1)
    jump = np.linalg.norm(np.diff(places, axis=0), axis=-1) * _PACKED_RATE > FASTEST_MARKER
    seen[1:] &= ~jump
    seen[:-1] &= ~jump
    raw_markers = MarkerRecording(
        path.name, _PLUG_IN_GAIT, np.where(seen[..., None], places, 0.0), seen,
        _PACKED_RATE, ("packed markers of UI-PRMD",),
    )  # fmt: skip
    return markers_in_metres(raw_markers, unit="m", up="z")


_UPRIGHT = (
    (("LeftShoulder",), "LeftArm", (0.951, 0.299, -0.080)),
    (("RightShoulder",), "RightArm", (-0.951, 0.299, -0.080)),
    (("Neck", "Neck1", "Head"), "", (0.0, 0.964, 0.264)),
)
"""Joints of the skeleton of CMU's BVH files that turn together, the joint that they lead to (or
none: the head's own y), and its mean direction in the frame of Spine1 over ten people of CMU on
their own bones, none of whom is tested."""
_STOOPS = 12.5
"""Degrees from it beyond which a person's mean is mended; collars of these ten are within 10."""


def read_cmu_windows(clips: Sequence[SourceClip]) -> dict[str, SkeletonRecording]:
    """Read recordings in which all people have CMU's skeleton of 31 joints; by clip name.

    Angles of one skeleton on another turn every bone by what the rest poses differ in, so that
    some of these people bow their heads and draw up their shoulders throughout. Where a person's
    mean direction is far from everybody's, collars and neck are turned by a constant; arms keep
    their orientations.

    Raises:
        FileNotFoundError, ValueError: as `read_bvh`.
    """
    found = {clip.name: drop_lead_in(read_bvh(clip.path)) for clip in clips}
    for person in {clip.subject for clip in clips}:
        own = [clip.name for clip in clips if clip.subject == person]
        for joints, tip, usual in _UPRIGHT:
            seen = np.concatenate(
                [_direction_of_limb(found[name], joints, tip) for name in own]
            ).mean(0)
            turn = Rotation.align_vectors(np.array([usual]), seen[None])[0]
            if np.degrees(turn.magnitude()) > _STOOPS:
                for name in own:
                    found[name] = _with_joints_turned(found[name], joints, turn.as_matrix())
    return found


def _direction_of_limb(
    recording: SkeletonRecording, joints: tuple[str, ...], tip: str
) -> np.ndarray:
    last = recording.joint(joints[-1])
    if tip:
        world = recording.positions[:, recording.joint(tip)] - recording.positions[:, last]
        world = world / np.linalg.norm(world, axis=-1, keepdims=True)
    else:
        world = recording.orientations[:, last, :, 1]
    chest = recording.orientations[:, recording.joint("Spine1")]
    return (np.swapaxes(chest, 1, 2) @ world[..., None])[..., 0]


def _with_joints_turned(
    recording: SkeletonRecording, joints: tuple[str, ...], turn: np.ndarray
) -> SkeletonRecording:
    """Rotate a chain of joints about its first joint, in the frame of Spine1.

    What hangs from the last of them is moved and keeps its orientation.
    """
    positions, orientations = recording.positions.copy(), recording.orientations.copy()
    chest = orientations[:, recording.joint("Spine1")]
    world = chest @ turn @ np.swapaxes(chest, 1, 2)
    for number in (recording.joint(name) for name in joints):
        for child in (c for c, parent in enumerate(recording.parents) if parent == number):
            bone = positions[:, child] - positions[:, number]
            shift = (world @ bone[..., None])[..., 0] - bone
            positions[:, recording.descendants(child)] += shift[:, None]
        orientations[:, number] = world @ orientations[:, number]
    said = f"{joints[0]} turned to where people on their own bones have it"
    decisions = (*recording.decisions, said)
    return replace(recording, positions=positions, orientations=orientations, decisions=decisions)


_TREE: dict[str, tuple[str, tuple[float, float, float]]] = {
    "root": ("", (0.0, 0.0, 0.0)),
    "chest": ("root", (0.0, 0.236151, 0.0)),
    "neck": ("chest", (0.0, 0.223894, 0.0)),
    **{
        f"{side}_{joint}": (f"{side}_{parent}" if parent not in ("root", "chest") else parent,
                            (x, y, sign * z))
        for side, sign in (("right", 1.0), ("left", -1.0))
        for joint, parent, x, y, z in (
            ("hip", "root", 0.0, 0.0, 0.084887), ("knee", "hip", 0.0, -0.421546, 0.0),
            ("ankle", "knee", 0.0, -0.40987, 0.0), ("ball", "ankle", 0.1, -0.035, 0.0),
            ("shoulder", "chest", -0.02405, 0.2435, 0.18311),
            ("elbow", "shoulder", 0.0, -0.274788, 0.0), ("wrist", "elbow", 0.0, -0.258947, 0.0),
        )
    },
}  # fmt: skip
"""Parent and offset (metres; x ahead, y up, z to the right) of the humanoid's joints, with arms
that hang; the ball of the foot lies in its box."""
_ORDER = tuple(
    (name, 1 if name.endswith(("knee", "elbow")) else 4)
    for name in ("chest", "neck", "right_hip", "right_knee", "right_ankle", "right_shoulder",
                 "right_elbow", "left_hip", "left_knee", "left_ankle", "left_shoulder",
                 "left_elbow")
)  # fmt: skip
"""Joints in the order of a frame's numbers, after dt, place and turn of the root; hinges (about z)
have one number, other joints a quaternion (w x y z)."""
_ARMS = tuple(f"{side}_{name}" for side in ("right", "left") for name in ("shoulder", "elbow"))
HUMANOID_MAP = SkeletonMap(
    name="humanoid of DeepMimic",
    positions=tuple(
        (joint_index(ours), theirs)
        for ours, theirs in (
            ("pelvis", "root"), ("neck", "neck"),
            *((f"{side}_{name}", f"{side}_{name}")
              for name in ("hip", "knee", "shoulder", "elbow", "wrist")
              for side in ("left", "right")),
            ("left_ankle", "left_ankle"), ("right_ankle", "right_ankle"),
            ("left_foot", "left_ball"), ("right_foot", "right_ball"),
        )
    ),
    orientations=tuple(
        (joint_index(ours), theirs)
        for ours, theirs in (
            ("pelvis", "root"), ("spine3", "chest"), ("head", "neck"),
            *((f"{side}_{name}", f"{side}_{name}")
              for name in ("hip", "knee", "shoulder", "elbow") for side in ("left", "right")),
            ("left_ankle", "left_ankle"), ("right_ankle", "right_ankle"),
        )
    ),
)  # fmt: skip
"""Our joints in the humanoid."""


def read_humanoid(path: Path) -> SkeletonRecording:
    """A motion of the DeepMimic humanoid (JSON), its arms turned so that it rests in a T-pose.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no such motion.
    """
    try:
        table = json.loads(decoded_text(read_bytes(path)))
        frames = np.array(table["Frames"], dtype=float)
        if frames.ndim != 2 or frames.shape[1] != 44 or not np.isfinite(frames).all():
            raise ValueError(f"its frames have shape {frames.shape}, or NaN or infinity in them")
        turns = _joint_rotations(frames)
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{path}: expected frames of 44 numbers, but {error}") from error
    names = tuple(_TREE)
    parents = tuple(names.index(parent) if parent else -1 for parent, _ in _TREE.values())
    offsets = np.array([place for _, place in _TREE.values()])
    for joint, (name, parent) in enumerate(zip(names, parents, strict=True)):
        raised = _arm_lowering(name)
        # `_arm_lowering` is A (identity except for arms); in the new rest pose, the rotation R of
        # a joint relative to its parent becomes A_parentᵀ R A
        before = _arm_lowering(names[parent]) if parent >= 0 else np.eye(3)
        turns[name] = before.T @ turns[name] @ raised
        offsets[joint] = before.T @ offsets[joint]

    def local_poses() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for name, offset in zip(names, offsets, strict=True):
            yield (frames[:, 1:4] if name == "root" else offset), turns[name]

    positions, orientations = posed_skeleton(parents, local_poses(), len(frames))
    raw = SkeletonRecording(path.name, names, parents, offsets, positions, orientations,
                            snapped_rate(1 / float(np.median(frames[:, 0]))), ())  # fmt: skip
    return skeleton_in_metres(raw, unit="m", up="y")


def _joint_rotations(frames: np.ndarray) -> dict[str, np.ndarray]:
    """Rotation of every joint relative to its parent, frames x 3 x 3, from a motion's numbers."""
    still = np.broadcast_to(np.eye(3), (len(frames), 3, 3))
    turns = dict.fromkeys(_TREE, still)
    turns["root"] = Rotation.from_quat(frames[:, 4:8], scalar_first=True).as_matrix()
    column = 8
    for name, width in _ORDER:
        own = frames[:, column : column + width]
        turn = (
            Rotation.from_euler("z", own) if width == 1
            else Rotation.from_quat(own, scalar_first=True)
        )  # fmt: skip
        turns[name] = turn.as_matrix()
        column += width
    return turns


def _arm_lowering(name: str) -> np.ndarray:
    """Rotation from a sideways to a hanging arm for an arm's joint; identity for others."""
    if name not in _ARMS:
        return np.eye(3)
    return Rotation.from_euler(
        "x", 90 if name.startswith("right") else -90, degrees=True
    ).as_matrix()
