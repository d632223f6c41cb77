"""A motion on another shape: the same turns, the path scaled to the legs, soles on the floor."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body import BodyModel
from recon.motion import Motion
from recon.skeleton import TOES


def with_shape(motion: Motion, body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Motion:
    """What a body of another shape does when it does the same.

    Rotations stay. The pelvis' path, from its place above the ground in the first frame and the
    level of the toe joints at rest, grows with the legs (pelvis to toes), and the toes' level
    becomes that of the new toes. Where legs keep their proportions no foot slips or rises; else
    soles rise or sink by millimetres, up to two centimetres at heel strikes. Time is not scaled.

    Raises:
        ValueError: when the body has fewer shape coefficients.
    """
    pelvis_before, toes_before = _standing(body, motion.shape)
    pelvis_after, toes_after = _standing(body, shape)
    scale = ((pelvis_after - toes_after) / (pelvis_before - toes_before))[..., None, None]
    pelvis = motion.translation + body.rest_joints(motion.shape)[..., None, 0, :]
    origin = torch.cat((pelvis[..., :1, :2], _column(toes_before)), -1)
    target = torch.cat((pelvis[..., :1, :2], _column(toes_after)), -1)
    moved = target + scale * (pelvis - origin)
    return motion.replace(
        translation=moved - body.rest_joints(shape)[..., None, 0, :], shape=shape
    )


def _standing(
    body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Heights above the sole of a body at rest, metres: pelvis, toe joints."""
    level = body.joint_template[list(TOES), 1].min()
    below = (body.template[:, 1] < level).nonzero()[:, 0]
    rest = body.rest_joints(shape)[..., 1]
    sole = body.rest_vertices(shape, below)[..., 1].amin(-1)
    return rest[..., 0] - sole, rest[..., list(TOES)].mean(-1) - sole


def _column(height: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 1 1"]:
    return height[..., None, None]
