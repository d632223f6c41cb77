"""A first guess from 3D points: the rest body aligned rigidly with the torso of each frame."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS, descendants, joint_index

TORSO = frozenset(range(22)) - {
    joint
    for name in ("left_knee", "right_knee", "left_shoulder", "right_shoulder")
    for joint in descendants(joint_index(name))
}
"""Bones that move little against each other: pelvis, hips, spine, neck, collars, head."""


def rigid_start(
    body: BodyModel,
    rest: Float[Tensor, "points 3"],
    bones: tuple[int, ...],
    positions: Float[Tensor, "*batch time points 3"],
    visible: Bool[Tensor, "*batch time points"],
    *,
    fps: float,
    start_time: float,
) -> Motion:
    """First guess: the rest pose aligned with the torso's visible points by least squares.

    Where a frame shows fewer than three points of the torso all its points are used; where that
    is not enough either, the placement of the nearest frame that has one.
    """
    torso = torch.tensor([bone in TORSO for bone in bones], device=positions.device)
    enough = (visible & torso).sum(-1) >= 3
    used = visible & (torso | ~enough[..., None])
    weight = used.to(positions)
    total = weight.sum(-1).clamp(min=1.0)[..., None]
    centre = (weight[..., None] * positions).sum(-2) / total
    rest_centre = (weight[..., None] * rest).sum(-2) / total
    spread = torch.einsum(
        "...k,...ki,...kj->...ij",
        weight,
        positions - centre[..., None, :],
        rest - rest_centre[..., None, :],
    )
    turn = so3.nearest_rotation(spread.double()).to(positions)
    placed = used.sum(-1) >= 3
    pelvis = body.joint_template[0].to(positions)
    # a point p of the body at rest moves to R (p - pelvis) + pelvis + translation
    turned = (turn @ (rest_centre - pelvis)[..., None])[..., 0]
    translation = centre - turned - pelvis
    nearest = nearest_placed_frames(placed)
    translation = translation.take_along_dim(nearest[..., None], -2)
    turn = turn.take_along_dim(nearest[..., None, None], -3)
    none = (~placed.any(-1))[..., None, None]
    turn = torch.where(none[..., None], torch.eye(3).to(turn), turn)
    translation = torch.where(none, 0.0, translation)
    return rest_pose_at(body, translation, turn, fps=fps, start_time=start_time)


def rest_pose_at(
    body: BodyModel,
    translation: Float[Tensor, "*batch time 3"],
    root: Float[Tensor, "*batch time 3 3"],
    *,
    fps: float,
    start_time: float,
) -> Motion:
    """The average body in its rest pose, with given translations and rotations of its root."""
    unrotated = torch.eye(3).to(root).expand(*root.shape[:-2], 21, 3, 3)
    return Motion(
        translation=translation,
        rotations=torch.cat((root[..., None, :, :], unrotated), -3),
        shape=root.new_zeros(*root.shape[:-3], body.shape_size),
        valid=torch.ones_like(translation[..., 0], dtype=torch.bool),
        fps=fps,
        start_time=start_time,
    )


def nearest_placed_frames(placed: Bool[Tensor, "*batch time"]) -> Tensor:
    """For every frame, index of the nearest frame in time for which `placed` is true."""
    frames = placed.shape[-1]
    index = torch.arange(frames, device=placed.device).expand(placed.shape)
    far = 2 * frames
    before = torch.where(placed, index, -far).cummax(-1).values
    after = torch.where(placed, index, far).flip(-1).cummin(-1).values.flip(-1)
    closer = torch.where(index - before <= after - index, before, after)
    return closer.clamp(0, frames - 1)


_LIMBS = tuple(
    joint_index(f"{side}_{joint}")
    for joint in ("hip", "knee", "shoulder", "elbow")
    for side in ("left", "right")
)
"""Joints that are turned, every one after those that carry it."""
_SHORT = 0.05
"""Metres from the joint within which a point tells nothing of its turn."""
_NEAR_NEXT_JOINT_M = 0.12
"""Metres from the next joint within which a point on the next bone tells of this one's turn."""
_REST_STIFFNESS_M2 = 0.01
"""How strongly a bone keeps its rest rotation about what the points do not tell, metres²."""


def with_limbs_towards_points(
    start: Motion,
    body: BodyModel,
    rest: Float[Tensor, "points 3"],
    bones: tuple[int, ...],
    positions: Float[Tensor, "*batch time points 3"],
    visible: Bool[Tensor, "*batch time points"],
) -> Motion:
    """Rotate the thighs, shanks, upper arms and forearms of a motion towards their points.

    From the trunk outwards, each joint j takes the rotation R that maximises
    Σ_k (p_k - x_j)ᵀ O_p R b_k + c tr R over its points k (Wahba 1965), with c =
    `_REST_STIFFNESS_M2`, O_p the orientation of its parent, x_j its place and b_k the place of the
    point at rest, from there.
    Where none is visible, the joint is turned as in the nearest moment with one.

    Args:
        start: the body in every frame with its trunk in place and its limbs at rest.
        body: the body.
        rest: the points on the average body in its rest pose, metres.
        bones: the bone that carries each.
        positions: where they were seen, metres.
        visible: which of them were.
    """
    joints = body.joint_template.to(positions)
    on_bone = torch.tensor(bones, device=positions.device)
    rotations = start.rotations.clone()
    posed = body.pose(start)
    turned = {j: posed.orientations[..., j, :, :] for j in range(len(PARENTS))}
    places = {j: posed.joints[..., j, :] for j in range(len(PARENTS))}
    for joint in _LIMBS:
        parent, child = PARENTS[joint], PARENTS.index(joint)
        lever = rest - joints[joint]
        own = (on_bone == joint) & (lever.norm(dim=-1) > _SHORT)
        next_to = (on_bone == child) & ((rest - joints[child]).norm(dim=-1) < _NEAR_NEXT_JOINT_M)
        place = (
            places[parent] + (turned[parent] @ (joints[joint] - joints[parent])[:, None])[..., 0]
        )
        used = visible & (own | next_to)
        away = (positions - place[..., None, :]) @ turned[parent]
        weight = used.to(positions)
        spread = torch.einsum("...k,...ki,kj->...ij", weight, away, lever)
        identity = torch.eye(3).to(spread)
        turn = so3.nearest_rotation(spread.double() + _REST_STIFFNESS_M2 * identity).to(positions)
        seen = used.any(-1)
        turn = turn.take_along_dim(nearest_placed_frames(seen)[..., None, None], -3)
        turn = torch.where(seen.any(-1)[..., None, None, None], turn, identity)
        rotations[..., joint, :, :] = turn
        turned[joint], places[joint] = turned[parent] @ turn, place
    return start.replace(rotations=rotations)
