"""Poses a character's rig frame by frame, by the rotations of a person's joints."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.hands import finger_offsets, pose_fingers
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.fingers import FINGERS, HAND_JOINTS, SIDES
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, joint_index
from recon.export.character import Character

Posed = dict[int, Float[Tensor, "time 4 4"]]
"""Rotation and position, without scale, of every animated node in the scene, in every frame."""


@dataclass(frozen=True)
class CharacterPose:
    """Node rotations and hip position of a character in every frame; y up, in its scene."""

    turns: dict[int, Float[Tensor, "time 3 3"]]
    """World rotation of every animated node relative to the body model's rest pose."""
    hips: Float[Tensor, "time 3"]
    """Position of the hips' node."""


@dataclass(frozen=True)
class CharacterRig:
    """A character with rest rotations and offsets of its bones, for forward kinematics."""

    character: Character
    rest: dict[int, Float[Tensor, "3 3"]]
    """Rotation of every animated node in the body model's rest pose, in its axes."""
    shifts: dict[int, tuple[int, Float[Tensor, "3"]]]
    """For every animated node but the hips: the animated node above, and the offset from there,
    along the axes of the node above and in lengths of the scene."""

    @classmethod
    def of(cls, character: Character, motion: Motion, body: BodyModel) -> "CharacterRig":
        """Make the rig of a character in the rest pose of a body model."""
        found = _rotations_to_body_rest_pose(character, motion, body)
        rest = {node: turn @ character.rest_rotations[node] for node, turn in found.items()}
        driven, shifts = set(character.animated_nodes), {}
        for node in character.animated_nodes[1:]:
            path = character.tree.path_to_root(node)
            above = next(k for k in path[1:] if k in driven)
            chain = np.eye(4)
            for k in path[: path.index(above)][::-1]:
                chain = chain @ character.local[k]
            shifts[node] = (
                above,
                torch.from_numpy(chain[:3, 3] * _scale_of_node(character, above)),
            )
        return cls(character, rest, shifts)

    @property
    def hips(self) -> int:
        """Number of the node of the hips."""
        return self.character.animated_nodes[0]

    def node_transforms(self, pose: CharacterPose) -> Posed:
        """Compute rotation and position of all animated nodes by forward kinematics."""
        found: Posed = {}
        for node in self.character.animated_nodes:
            place = pose.hips
            if node in self.shifts:
                above, shift = self.shifts[node]
                place = found[above][:, :3, 3] + found[above][:, :3, :3] @ shift
            found[node] = so3.rigid(pose.turns[node] @ self.rest[node], place)
        return found

    def points(self, posed: Posed, nodes: list[int]) -> Float[Tensor, "time points 3"]:
        """Return the outermost skin points of some nodes, in the scene."""
        found = [so3.transform(posed[k], self._skin(k)) for k in nodes if k in self.character.skin]
        return torch.cat(found, 1) if found else posed[self.hips][:, :0, :3]

    def _skin(self, node: int) -> Float[Tensor, "points 3"]:
        return torch.from_numpy(self.character.skin[node]) * _scale_of_node(self.character, node)


def node_rotations(
    character: Character, motion: Motion, body: BodyModel
) -> dict[int, Float[Tensor, "time 3 3"]]:
    """Return each node's rotation from the rest pose in every frame of a motion; world, z up.

    A spine with another number of bones gets rotations interpolated along the body's spine.
    """
    joint_rotations = body.pose(motion).orientations
    bones = character.bones
    found = {
        node: joint_rotations[:, joint_index(j)] for j, node in bones.nodes.items() if j in JOINTS
    }
    fingers = None if motion.hands is None else pose_fingers(motion, body)[1]
    for joint, node in bones.nodes.items():
        if joint in HAND_JOINTS:
            wrist = joint_rotations[:, joint_index(f"{joint.partition('_')[0]}_wrist")]
            found[node] = wrist if fingers is None else fingers[:, HAND_JOINTS.index(joint)]
    for nodes, chain in (
        (bones.spine, ("pelvis", "spine1", "spine2", "spine3")),
        (bones.neck, ("spine3", "neck")),
    ):
        steps = [joint_rotations[:, joint_index(joint)] for joint in chain]
        for k, node in enumerate(nodes):
            at = (k + 1) * (len(steps) - 1) / len(nodes)
            low = min(int(at), len(steps) - 2)
            share = joint_rotations.new_full(joint_rotations.shape[:1], at - low)
            found[node] = so3.interpolate(steps[low], steps[low + 1], share)
    return found


def _scale_of_node(character: Character, node: int) -> float:
    """Return the ratio of lengths in the scene to lengths in a node's own axes."""
    return float(np.linalg.norm(character.world[node, :3, :3], axis=0).mean())


def _rotations_to_body_rest_pose(
    character: Character, motion: Motion, body: BodyModel
) -> dict[int, Float[Tensor, "3 3"]]:
    """Find each animated node's rotation from the character's rest pose to the body model's.

    Bones of arms, legs and fingers are turned by the smallest rotation to the directions of the
    body model's; hands are also aligned by knuckles, and the forearm takes half of that twist.
    Trunk, head and feet stay: in any rest pose a person stands upright with flat feet.
    """
    nodes, identity = character.bones.nodes, torch.eye(3, dtype=torch.float64)
    found = dict.fromkeys(character.animated_nodes, identity)
    rest = body.rest_joints(motion.shape).double()
    ours = {joint: rest[k] for k, joint in enumerate(JOINTS)}
    places = torch.from_numpy(character.rest_positions)
    offsets = dict(zip(HAND_JOINTS, finger_offsets(motion, body).double(), strict=False))

    def with_bone_aligned(start: str, end: str, way: Tensor, before: Tensor) -> Tensor:
        bone = places[nodes[end]] - places[nodes[start]]
        return so3.rotation_between(before @ bone, way) @ before

    for side in SIDES:
        for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
            turn = identity
            for start, end in pairwise(limb):
                a, b = f"{side}_{start}", f"{side}_{end}"
                turn = with_bone_aligned(a, b, ours[b] - ours[a], turn)
                found[nodes[a]] = turn
        fore = ours[f"{side}_wrist"] - ours[f"{side}_elbow"]
        elbow, wrist = nodes[f"{side}_elbow"], nodes[f"{side}_wrist"]
        found[wrist] = found[elbow]
        knuckles = [f"{side}_{finger}1" for finger in ("index", "middle", "pinky")]
        if all(name in nodes for name in knuckles):
            hand = [
                _hand_axes(points[1], points[0] - points[2])
                for points in (
                    [offsets[name] for name in knuckles],
                    [places[nodes[name]] - places[wrist] for name in knuckles],
                )
            ]
            found[wrist] = hand[0] @ hand[1].mT
            found[elbow] = _half_twist(found[wrist] @ found[elbow].mT, fore) @ found[elbow]
        for finger in FINGERS:
            turn = found[wrist]
            for k in (1, 2, 3):
                a, b = f"{side}_{finger}{k}", f"{side}_{finger}{k + 1}"
                if motion.hands is not None and a in nodes and b in nodes:
                    turn = with_bone_aligned(a, b, offsets[b], turn)
                if a in nodes:
                    found[nodes[a]] = turn
    return found


def _hand_axes(along: Float[Tensor, "3"], across: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Return axes along a hand, across it and out of its palm, as columns."""
    x = along / along.norm()
    z = torch.linalg.cross(along, across)
    z = z / z.norm().clamp(min=1e-12)
    return torch.stack((x, torch.linalg.cross(z, x), z), -1)


def _half_twist(
    rotation: Float[Tensor, "3 3"], direction: Float[Tensor, "3"]
) -> Float[Tensor, "3 3"]:
    """Return half of the twist that a rotation makes about a direction."""
    axis = direction / direction.norm()
    side = torch.linalg.cross(axis, torch.eye(3, dtype=axis.dtype)[int(axis.abs().argmin())])
    side = side / side.norm()
    moved = rotation @ side
    angle = torch.atan2(torch.linalg.cross(side, moved) @ axis, side @ moved)
    return so3.exp(0.5 * angle * axis)
