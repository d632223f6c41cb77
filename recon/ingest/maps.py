"""Finds the body model's joints in recorded skeletons, by known names or by a user's file."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.errors import FormatError, ReconError
from recon.core.hands import right_handed_signs
from recon.core.skeleton import FEET, JOINTS, MIRROR, joint_index
from recon.core.units import Hand
from recon.formats.texts import read_toml
from recon.mocap.reader import (
    NEEDED,
    SkeletonTable,
    known_skeletons,
    plain_joint_name,
    skeleton_among,
)
from recon.mocap.recording import SkeletonRecording
from recon.mocap.trees import joints_by_tree


@dataclass(frozen=True)
class SkeletonMap:
    """Maps joints of the body model to those of a recorded skeleton; ankles and toes last."""

    name: str
    positions: tuple[tuple[int, str], ...]
    """Pairs: number of a model joint, name of the recorded joint at the same position."""
    orientations: tuple[tuple[int, str], ...]
    """Pairs: number of a model joint, name of the recorded joint that rotates with its bone."""

    @property
    def joints(self) -> tuple[int, ...]:
        """Numbers of the model's joints whose positions are recorded."""
        return tuple(joint for joint, _ in self.positions)

    @property
    def bones(self) -> tuple[int, ...]:
        """Numbers of the model's joints whose bones have recorded orientations."""
        return tuple(joint for joint, _ in self.orientations)

    @property
    def feet_rows(self) -> tuple[int, int]:
        """First row of `positions` with ankles or toes, and number of all rows."""
        return sum(joint not in FEET for joint in self.joints), len(self.joints)


def recognise(recording: SkeletonRecording, mapping: str | Path | None = None) -> SkeletonMap:
    """Find the body model's joints among the joints of a recording.

    Args:
        recording: motion of any skeleton.
        mapping: TOML file with tables [joints], [positions], [orientations] as in
            `assets/skeletons.toml`; None tries the skeletons known there, then the tree of the
            joints.

    Raises:
        FileNotFoundError: when there is no such mapping file.
        ValueError: when the skeleton is not known, or the file names joints that do not exist.
    """
    their_names = {plain_joint_name(name): name for name in recording.joint_names}
    if mapping is not None:
        return _user_map(Path(mapping), their_names, recording)
    try:
        name = skeleton_among(recording.joint_names, recording.name)
    except FormatError:
        joints = joints_by_tree(recording.joint_names, recording.parents, recording.rest_offsets)
        if joints is None:
            raise
        said = ", ".join(f"{ours} = {joint}" for ours, joint in joints.items())
        return _skeleton_map(
            f"told by the tree of its joints ({said})", {"joints": joints}, their_names
        )
    return _skeleton_map(name, known_skeletons()[name], their_names)


def _user_map(
    path: Path, their_names: Mapping[str, str], recording: SkeletonRecording
) -> SkeletonMap:
    if not path.is_file():
        raise FileNotFoundError(f"no skeleton mapping at {path}; expected a TOML file")
    table = read_toml(path)
    parts = {"joints", "positions", "orientations"}
    if not table or set(table) - parts or not all(isinstance(p, dict) for p in table.values()):
        raise ReconError(
            f"{path}: expected the tables {', '.join(sorted(parts))}, got {', '.join(table)}"
        )
    for part in table.values():
        for ours, joint in part.items():
            joint_index(ours)
            if not isinstance(joint, str) or plain_joint_name(joint) not in their_names:
                raise ReconError(
                    f"{path}: {ours} = {joint!r}, but {recording.name} has "
                    f"{', '.join(recording.joint_names)}"
                )
    found = _skeleton_map(path.stem, cast(SkeletonTable, table), their_names)
    if missing := [n for n in NEEDED if joint_index(n) not in found.joints]:
        raise ReconError(f"{path}: positions of {', '.join(missing)} are needed for a full body")
    return found


def _skeleton_map(name: str, table: SkeletonTable, their_names: Mapping[str, str]) -> SkeletonMap:
    both = dict(table.get("joints", {}))
    positions = both | dict(table.get("positions", {}))
    orientations = both | dict(table.get("orientations", {}))

    def joints_feet_last(part: Mapping[str, str]) -> tuple[tuple[int, str], ...]:
        numbers = sorted(map(joint_index, part), key=lambda j: (j in FEET, j))
        return tuple((j, their_names[plain_joint_name(part[JOINTS[j]])]) for j in numbers)

    return SkeletonMap(name, joints_feet_last(positions), joints_feet_last(orientations))


def right_handed_skeleton(
    recording: SkeletonRecording, skeleton: SkeletonMap, hand: Hand | None = None
) -> SkeletonRecording:
    """Return the recording in right-handed axes, with a note in it if it was changed.

    Where `hand` is given and knees and feet still point backwards by the names left and right,
    these names are exchanged.

    Args:
        recording: in metres, z up.
        skeleton: which of its joints are the body model's.
        hand: handedness of the axes; None tells it from the body.
    """
    chosen = recording.positions[:, [recording.joint(name) for _, name in skeleton.positions]]
    names, visible = [JOINTS[k] for k in skeleton.joints], np.ones(chosen.shape[:2], dtype=bool)
    signs, said = right_handed_signs(names, chosen, visible, hand)
    theirs = recording.joint_names
    if hand is not None and right_handed_signs(names, chosen * signs, visible)[1]:
        both = (dict(skeleton.positions), dict(skeleton.orientations))
        other = {part[k]: part[MIRROR[k]] for part in both for k in part if MIRROR[k] in part}
        theirs = tuple(other.get(name, name) for name in theirs)
        said += (
            f"feet or knees point backwards by the names left and right, if coordinates are {hand}"
            "-handed as given: left and right joints were exchanged",
        )
    return replace(
        recording,
        joint_names=theirs,
        rest_offsets=recording.rest_offsets * signs,
        positions=recording.positions * signs,
        orientations=recording.orientations * np.outer(signs, signs),
        decisions=(*recording.decisions, *said),
    )


_WORST_BONE = 40.0
"""Largest angle (degrees) between a limb of a recorded T-pose and the body model's at rest."""
_CHILD = {
    joint_index(f"{side}_{name}"): joint_index(f"{side}_{child}")
    for side in ("left", "right")
    for name, child in (
        ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"),
    )
}  # fmt: skip
"""The joint at the end of each bone of a limb; feet are left out: they are flat in any T-pose."""


def alignments_from_rest(
    recording: SkeletonRecording, skeleton: SkeletonMap, body: BodyModel
) -> Float[Tensor, "bones 3 3"] | None:
    """Return rotations from recorded bones to the model's; None if zero angles give no T-pose.

    At zero rotations every recorded bone has orientation I in the file's axes. The body model is
    rotated onto it (Q, orthogonal Procrustes of the joints), then each limb to the recorded
    direction by the smallest rotation S: alignment = S Q. A hand follows its forearm.
    """
    rest = np.zeros_like(recording.rest_offsets)
    for joint, parent in enumerate(recording.parents):
        if parent >= 0:
            rest[joint] = rest[parent] + recording.rest_offsets[joint]
    theirs = {j: torch.from_numpy(rest[recording.joint(n)]) for j, n in skeleton.positions}
    ours = body.joint_template.double()
    shared = sorted(set(theirs) - set(FEET))
    a = torch.stack([ours[j] for j in shared])
    b = torch.stack([theirs[j] for j in shared])
    turn = so3.nearest_rotation((b - b.mean(0)).mT @ (a - a.mean(0)))
    swings: dict[int, Tensor] = {}
    for joint, child in _CHILD.items():
        if joint not in theirs or child not in theirs:
            return None
        swing = so3.rotation_between(
            turn @ (ours[child] - ours[joint]), theirs[child] - theirs[joint]
        )
        if float(torch.rad2deg(so3.log(swing).norm())) > _WORST_BONE:
            return None
        swings[joint] = swing
    for side in ("left", "right"):
        swings[joint_index(f"{side}_wrist")] = swings[joint_index(f"{side}_elbow")]
    identity = torch.eye(3, dtype=torch.float64)
    return torch.stack([swings.get(j, identity) @ turn for j in skeleton.bones]).float()
