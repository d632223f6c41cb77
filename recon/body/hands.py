"""The hands of the bundled body: bones of the fingers, how joints bend, and where points are.

No free recordings of fingers exist, so how hands move is not learned. Every joint turns about the
axes that it has; limits, and how joints move together, are from the literature.
"""

import io
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.fingers import FINGERS, HAND_JOINTS, HAND_PARENTS, ROWS, Hands
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, joint_index

WRISTS = (joint_index("left_wrist"), joint_index("right_wrist"))
_THUMB = (
    ("adduction", 0, 10, -40, 45), ("palmar_abduction", 0, 15, -15, 65), ("twist", 0, 0, -30, 45),
    ("mcp_abduction", 1, 0, -20, 20), ("mcp_flexion", 1, 15, -15, 65),
    ("ip_flexion", 2, 15, -25, 85),
)  # fmt: skip
_FINGER = (
    ("mcp_abduction", 0, 0, -25, 25), ("mcp_flexion", 0, 25, -40, 95),
    ("pip_flexion", 1, 35, -10, 115), ("dip_flexion", 2, 20, -10, 88),
)  # fmt: skip
_ANGLES = [
    (f"{finger}_{name}", 3 * number + joint, *degrees)
    for number, finger in enumerate(FINGERS)
    for name, joint, *degrees in (_THUMB if number == 0 else _FINGER)
]
ANGLES = tuple(row[0] for row in _ANGLES)
"""The 22 angles of a hand. Flexion and palmar abduction go towards the palm, abduction of fingers
towards the thumb, adduction of the thumb towards the fingers."""
JOINT_OF_ANGLE = tuple(int(row[1]) for row in _ANGLES)
"""Joint of the hand (finger by finger, thumb first) that each angle turns, in the order in which
the rotations of one joint are multiplied."""
_DEGREES = np.deg2rad([row[2:] for row in _ANGLES])
RELAXED = torch.from_numpy(_DEGREES[:, 0].copy())
"""Angles of a hand at rest, radians."""
LIMITS = torch.from_numpy(_DEGREES[:, 1:].copy())
"""Smallest and largest angles, radians, (22, 2): active ranges of the American Academy of
Orthopaedic Surgeons (Joint Motion, 1965) and of Hume et al. 1990 (J. Hand Surg. 15A:240), with
what joints yield to a push and 5 degrees for the zero that the flat hand is."""


@dataclass(frozen=True)
class HandModel:
    """Finger bones and joint axes of a person's left and right hand, in double precision."""

    directions: Float[Tensor, "2 20 3"]
    """Direction of every bone in the flat hand, body axes, in the order of their end points."""
    lengths: Float[Tensor, "2 20"]
    """Length of every bone, metres."""
    axes: Float[Tensor, "2 22 3"]
    """Axis in the flat hand that every angle turns about, body axes."""

    @classmethod
    def of(cls, body: BodyModel, shape: Float[Tensor, " shape"]) -> "HandModel":
        """Build the hand model for a body with the given shape.

        A body of the SMPL family has its own hands, which are not read: it gets those of the
        bundled body, in proportion to its forearms.
        """
        asset, own = hand_arrays(), BodyModel.load()
        bundled = body.checksum == own.checksum
        shape = shape.detach().double().cpu()
        coefficients = shape if bundled else shape.new_zeros(1)
        moved = asset["joint_directions"][..., : len(coefficients)] @ coefficients
        wrists = own.to(dtype=torch.float64).rest_joints(coefficients)[list(WRISTS)]
        points = (asset["joint_template"] + moved).unflatten(1, (5, 4))
        relaxed = torch.diff(points, dim=2, prepend=wrists[:, None, None].expand(2, 5, 1, 3))
        turns = asset["straight"].unflatten(1, (5, 3))
        flat = torch.cat((relaxed[:, :, :1], (turns @ relaxed[:, :, 1:, :, None])[..., 0]), 2)
        bones = flat.flatten(1, 2)
        lengths = bones.norm(dim=-1)
        if not bundled:
            lengths = (
                lengths * _forearm_length(body, shape) / _forearm_length(own, shape.new_zeros(1))
            )
        axes = _left_hand_axes(relaxed[0, 0], turns[0, 0, 0], flat[0, :, 1])
        both = torch.stack((axes, axes * axes.new_tensor([1.0, -1.0, -1.0])))
        return cls(bones / bones.norm(dim=-1, keepdim=True), lengths, both)

    def posed(
        self,
        angles: Float[Tensor, "time 22"],
        wrist_rotation: Float[Tensor, "time 3 3"],
        wrist_position: Float[Tensor, "time 3"],
        side: int,
        lengths: Float[Tensor, " 20"] | None = None,
    ) -> "PosedHand":
        """Pose one hand by its joint angles (radians) and the wrist's rotation and position."""
        size = self.lengths[side] if lengths is None else lengths
        bones = self.directions[side] * size[:, None]
        points, local, axes, pivots, ways = [], [], [], [], []
        for finger in range(len(FINGERS)):
            turn, at = wrist_rotation, wrist_position
            for k in range(4):
                bone = 4 * finger + k
                ways.append(turn @ self.directions[side, bone])
                at = at + turn @ bones[bone]
                points.append(at)
                if k == 3:
                    continue
                before = turn
                for number in [n for n, one in enumerate(JOINT_OF_ANGLE) if one == 3 * finger + k]:
                    axis = self.axes[side, number]
                    axes.append(turn @ axis)
                    pivots.append(at)
                    turn = turn @ so3.exp(angles[:, number, None] * axis)
                local.append(before.mT @ turn)
        stacked = (torch.stack(one, 1) for one in (points, local, axes, pivots, ways))
        return PosedHand(*stacked)


@dataclass(frozen=True)
class PosedHand:
    """One posed hand per frame: points, rotation axes and pivots; world coordinates, metres."""

    points: Float[Tensor, "time 20 3"]
    local: Float[Tensor, "time 15 3 3"]
    """Rotation of every joint relative to its parent, finger by finger."""
    axes: Float[Tensor, "time 22 3"]
    """Axis of every angle."""
    pivots: Float[Tensor, "time 22 3"]
    """Joint that every angle turns."""
    ways: Float[Tensor, "time 20 3"]
    """Direction of every bone."""


def _left_hand_axes(
    thumb_bones: Float[Tensor, "4 3"],
    turn_to_flat: Float[Tensor, "3 3"],
    first_bones: Float[Tensor, "5 3"],
) -> Float[Tensor, "22 3"]:
    """Unit vectors that the 22 angles turn about in the flat left hand.

    Args:
        thumb_bones: bones of the relaxed thumb, which is bent and so tells how it bends.
        turn_to_flat: rotation of its first bone to the flat hand.
        first_bones: first bones of the fingers of the flat hand.
    """
    palm = first_bones.new_tensor([0.0, -1.0, 0.0])
    first_bones = first_bones / first_bones.norm(dim=-1, keepdim=True)
    level = torch.linalg.cross(first_bones, palm.expand_as(first_bones), dim=-1)
    level = level / level.norm(dim=-1, keepdim=True)
    bend = turn_to_flat @ torch.linalg.cross(thumb_bones[1], thumb_bones[3], dim=-1)
    bend = bend - (bend @ first_bones[0]) * first_bones[0]
    bend = bend / bend.norm()
    across = torch.linalg.cross(bend, first_bones[0], dim=-1)
    rows = [-palm, level[0], first_bones[0], across, bend, bend]
    for finger in range(1, len(FINGERS)):
        rows += [palm, level[finger], level[finger], level[finger]]
    return torch.stack(rows)


def _forearm_length(body: BodyModel, shape: Tensor) -> float:
    rest = body.rest_joints(shape[: body.shape_size].to(body.template))
    return float((rest[WRISTS[0]] - rest[joint_index("left_elbow")]).norm())


@lru_cache(maxsize=1)
def hand_arrays() -> dict[str, Tensor]:
    """Load the bundled hand model, `recon/assets/hands.npz`, as tensors in double precision."""
    data = (resources.files("recon") / "assets" / "hands.npz").read_bytes()
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        numbers = {k: file[k] for k in file.files if file[k].dtype.kind in "fu"}
    return {
        key: torch.from_numpy(one.astype(np.int64 if one.dtype.kind == "u" else np.float64))
        for key, one in numbers.items()
    }


def with_bones_grown(
    hands: Hands,
    body: BodyModel,
    before: Float[Tensor, "*batch shape"],
    after: Float[Tensor, "*batch shape"],
) -> Hands:
    """Return hands whose measured bones grow as the model's do from one body shape to another."""
    if hands.lengths is None:
        return hands
    count, lengths = before.shape[-1], hands.lengths.clone()
    pairs = zip(before.reshape(-1, count), after.expand_as(before).reshape(-1, count), strict=True)
    grown = [HandModel.of(body, b).lengths / HandModel.of(body, a).lengths for a, b in pairs]
    lengths[..., ROWS] *= torch.stack(grown).reshape(*before.shape[:-1], 2, 20).to(lengths)
    return hands.replace(lengths=lengths)


def finger_offsets(motion: Motion, body: BodyModel) -> Float[Tensor, "40 3"]:
    """Return the vectors from parent to child of all finger joints and tips in the flat hand.

    Metres, axes of the body (x to its left, y up, z forward).
    """
    model = HandModel.of(body, motion.shape)
    out = model.directions.new_zeros(40, 3)
    out[ROWS] = model.directions * model.lengths[..., None]
    lengths = None if motion.hands is None else motion.hands.lengths
    if lengths is not None:
        out = out / out.norm(dim=-1, keepdim=True) * lengths.to(out)[:, None]
    return out.to(motion.translation)


def pose_fingers(
    motion: Motion, body: BodyModel
) -> tuple[Float[Tensor, "time 40 3"], Float[Tensor, "time 30 3 3"]]:
    """Positions of all finger joints and tips, and world rotations of the joints, of one clip.

    Raises:
        ValueError: when the motion has no fingers.
    """
    if motion.hands is None:
        raise ValueError("the motion has no fingers (hands is None)")
    posed, offsets = body.pose(motion), finger_offsets(motion, body)
    turns, places = list(posed.orientations.unbind(-3)), list(posed.joints.unbind(-2))
    for k, parent in enumerate(HAND_PARENTS):
        places.append(places[parent] + turns[parent] @ offsets[k])
        if k < len(HAND_JOINTS):
            turns.append(turns[parent] @ motion.hands.rotations[..., k, :, :])
    count = len(JOINTS)
    return torch.stack(places[count:], -2), torch.stack(turns[count:], -3)


def skin_weights_with_fingers(
    motion: Motion, body: BodyModel
) -> tuple[Float[Tensor, "vertices 52"], Float[Tensor, "30 4 4"]]:
    """Skinning weights of body and finger joints, and inverse bind matrices of finger joints.

    The hand of the unposed skin is relaxed, not flat: the matrices take its points to the frames
    of the finger joints. A body other than the bundled one has no fingers in its skin.
    """
    weights = torch.nn.functional.pad(body.weights.double(), (0, len(HAND_JOINTS)))
    if body.checksum != BodyModel.load().checksum:
        return weights.to(body.weights), torch.eye(4).repeat(len(HAND_JOINTS), 1, 1)
    asset, shape = hand_arrays(), motion.shape.double()
    points = asset["joint_template"] + asset["joint_directions"][..., : len(shape)] @ shape
    binds = torch.eye(4, dtype=torch.float64).repeat(len(HAND_JOINTS), 1, 1)
    joints = ROWS.unflatten(1, (5, 4))[:, :, :3].flatten(1)
    for side, wrist in enumerate(WRISTS):
        rows, turns = asset["vertices"][side], asset["straight"][side]
        places = points[side].unflatten(0, (5, 4))[:, :3].flatten(0, 1)
        binds[joints[side], :3, :3] = turns
        binds[joints[side], :3, 3] = -(turns @ places[..., None])[..., 0]
        columns = torch.cat((joints.new_tensor([wrist]), len(JOINTS) + joints[side]))
        weights[rows[:, None], columns] = asset["weights"]
    return (weights / weights.sum(-1, keepdim=True)).to(body.weights), binds.float()
