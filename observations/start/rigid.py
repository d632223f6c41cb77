"""A first guess from points in space: the rest body laid rigidly on each frame's torso."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import descendants, joint_index

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
    """The rest pose, placed so that its torso's points lie best on the visible ones.

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
    turn = so3.nearest(spread.double()).to(positions)
    placed = used.sum(-1) >= 3
    pelvis = body.joint_template[0].to(positions)
    # world = R (rest - pelvis) + pelvis + translation
    turned = (turn @ (rest_centre - pelvis)[..., None])[..., 0]
    translation = centre - turned - pelvis
    nearest = nearest_placed(placed)
    translation = translation.take_along_dim(nearest[..., None], -2)
    turn = turn.take_along_dim(nearest[..., None, None], -3)
    none = (~placed.any(-1))[..., None, None]
    identity = torch.eye(3, dtype=positions.dtype, device=positions.device)
    turn = torch.where(none[..., None], identity, turn)
    translation = torch.where(none, 0.0, translation)
    others = identity.expand(*turn.shape[:-2], 21, 3, 3)
    return Motion(
        translation=translation,
        rotations=torch.cat((turn[..., None, :, :], others), -3),
        shape=positions.new_zeros(*positions.shape[:-3], body.shape_size),
        valid=torch.ones_like(placed),
        fps=fps,
        start_time=start_time,
    )


def nearest_placed(placed: Bool[Tensor, "*batch time"]) -> Tensor:
    """The index of the closest frame with a placement, for every frame."""
    frames = placed.shape[-1]
    index = torch.arange(frames, device=placed.device).expand(placed.shape)
    far = 2 * frames
    before = torch.where(placed, index, -far).cummax(-1).values
    after = torch.where(placed, index, far).flip(-1).cummin(-1).values.flip(-1)
    closer = torch.where(index - before <= after - index, before, after)
    return closer.clamp(0, frames - 1)
