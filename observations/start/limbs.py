"""Arms and legs of a first guess turned towards the points that they carry."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.start.rigid import nearest_placed
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS, joint_index

_LIMBS = tuple(
    joint_index(f"{side}_{joint}")
    for joint in ("hip", "knee", "shoulder", "elbow")
    for side in ("left", "right")
)
"""Joints that are turned, every one after those that carry it."""
_SHORT = 0.05
"""Metres from the joint within which a point tells nothing of its turn."""
_NEAR = 0.12
"""Metres from the next joint within which a point on the next bone tells of this one's turn."""
_HELD = 0.01
"""How strongly a bone keeps its rest rotation about what the points do not tell, metres²."""


def limbs_towards(
    start: Motion,
    body: BodyModel,
    rest: Float[Tensor, "points 3"],
    bones: tuple[int, ...],
    positions: Float[Tensor, "*batch time points 3"],
    visible: Bool[Tensor, "*batch time points"],
) -> Motion:
    """A first guess whose thighs, shanks, upper arms and forearms point where their points lie.

    From the trunk outwards, each joint j takes the rotation R that maximises
    Σ_k (p_k - x_j)ᵀ O_p R b_k + `_HELD` tr R over its points k (Wahba 1965), with O_p the
    orientation of its parent, x_j its place and b_k the place of the point at rest, from there.
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
        next_to = (on_bone == child) & ((rest - joints[child]).norm(dim=-1) < _NEAR)
        place = (
            places[parent] + (turned[parent] @ (joints[joint] - joints[parent])[:, None])[..., 0]
        )
        used = visible & (own | next_to)
        away = (positions - place[..., None, :]) @ turned[parent]
        weight = used.to(positions)
        spread = torch.einsum("...k,...ki,kj->...ij", weight, away, lever)
        identity = torch.eye(3).to(spread)
        turn = so3.nearest(spread.double() + _HELD * identity).to(positions)
        seen = used.any(-1)
        turn = turn.take_along_dim(nearest_placed(seen)[..., None, None], -3)
        turn = torch.where(seen.any(-1)[..., None, None, None], turn, identity)
        rotations[..., joint, :, :] = turn
        turned[joint], places[joint] = turned[parent] @ turn, place
    return start.replace(rotations=rotations)
