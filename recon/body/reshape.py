"""A motion on another shape: the same turns, the path scaled to the legs, soles on the floor."""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import TOES


def copied(motion: Motion, body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Motion:
    """A motion on another shape with equal rotations and an equal path of the pelvis.

    Feet may leave the ground or sink into it; see `with_shape`.
    """
    before, after = (body.rest_joints(s)[..., None, 0, :] for s in (motion.shape, shape))
    return motion.replace(translation=motion.translation + before - after, shape=shape)


def with_shape(motion: Motion, body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Motion:
    """A motion on another shape, its path scaled by the length of the legs.

    Rotations stay. The pelvis' path, from its place above the ground in the first frame and the
    level of the toe joints at rest, grows with the legs (pelvis to toes), and the toes' level
    becomes that of the new toes. Where legs keep their proportions no foot slips or rises; else
    soles rise or sink by millimetres, up to two centimetres at heel strikes. Time is not scaled.

    Raises:
        ValueError: when the body has fewer shape coefficients.
    """
    toes_before, toes_after = _toes(body, motion.shape), _toes(body, shape)
    scale = (leg_length(body, shape) / leg_length(body, motion.shape))[..., None, None]
    pelvis = motion.translation + body.rest_joints(motion.shape)[..., None, 0, :]
    origin = torch.cat((pelvis[..., :1, :2], _column(toes_before)), -1)
    target = torch.cat((pelvis[..., :1, :2], _column(toes_after)), -1)
    moved = target + scale * (pelvis - origin)
    return motion.replace(
        translation=moved - body.rest_joints(shape)[..., None, 0, :], shape=shape
    )


def leg_length(body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
    """Height of the pelvis above the toe joints of a body at rest, metres."""
    rest = body.rest_joints(shape)[..., 1]
    return rest[..., 0] - rest[..., list(TOES)].mean(-1)


def _toes(body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
    """Height of the toe joints above the sole of a body at rest, metres."""
    level = body.joint_template[list(TOES), 1].min()
    below = (body.template[:, 1] < level).nonzero()[:, 0]
    sole = body.rest_vertices(shape, below)[..., 1].amin(-1)
    return body.rest_joints(shape)[..., list(TOES), 1].mean(-1) - sole


def _column(height: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 1 1"]:
    return height[..., None, None]
