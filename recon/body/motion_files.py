"""Load motions for one body model, and move motions to another shape of it."""

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import TOES
from recon.formats.motions import load_motion

WITH_BODY = "give the file of its body (--body, or body= in Python)"
"""What to do about a motion of another body, where one can be given."""


def load_motion_of(path: Path, body: BodyModel, remedy: str = WITH_BODY) -> MotionFile:
    """Read a motion of a body, with all of the body's shape coefficients; those missing are zero.

    Shape coefficients mean nothing on another body, so a motion of one is refused: a file that
    names another body, or one of another program (AMASS) for the bundled body, because its betas
    belong to the SMPL family. With a SMPL-family body of your own, such a file is accepted.

    Args:
        path: motion file.
        body: whose motion it must be; in its precision the motion is read.
        remedy: what to do about a motion of another body, for the message.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or made with another body.
    """
    return checked_for_body(load_motion(path, body.template.dtype), path, body, remedy)


def checked_for_body(
    file: MotionFile, path: object, body: BodyModel, remedy: str = WITH_BODY
) -> MotionFile:
    """Check a file that was read already, as `load_motion_of` does; `path` is for messages.

    Raises:
        ValueError: when it was made with another body.
    """
    bundled = body.checksum == BodyModel.load().checksum
    if file.checksum is None and file.format_version == 0 and bundled:
        raise ReconError(
            f"{path}: does not name its body (files of AMASS never do), so its betas belong to a "
            f"body of the SMPL family and mean nothing on the bundled one; {remedy}"
        )
    if file.checksum not in (None, body.checksum):
        raise ReconError(
            f"{path}: made with the body {file.body} ({file.checksum}), not with {body.name} "
            f"({body.checksum}); {remedy}"
        )
    missing = body.shape_size - file.motion.shape.shape[-1]
    if missing < 0:
        raise ReconError(
            f"{path}: has {file.motion.shape.shape[-1]} shape coefficients, but the body "
            f"{body.name!r} has only {body.shape_size}; {remedy}"
        )
    shape = torch.nn.functional.pad(file.motion.shape, (0, missing))
    return replace(file, motion=file.motion.replace(shape=shape))


def with_equal_pelvis_path(
    motion: Motion, body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> Motion:
    """Give a motion another body shape; joint rotations and the pelvis' path stay as they are.

    Feet may leave the ground or sink into it; see `with_shape`.
    """
    before, after = (body.rest_joints(s)[..., None, 0, :] for s in (motion.shape, shape))
    return motion.replace(translation=motion.translation + before - after, shape=shape)


def with_shape(motion: Motion, body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Motion:
    """Give a motion another body shape, and scale its path by the ratio of leg lengths.

    Rotations stay; finger bones grow as those of the body's hands do. The pelvis' path, from its
    place above the ground in the first frame and the level of the toe joints at rest, grows with
    the legs (pelvis to toes), and the toes' level becomes that of the new toes. Where legs keep
    their proportions no foot slips or rises; else soles rise or sink by millimetres, up to two
    centimetres at heel strikes. Time is not scaled.

    Raises:
        ValueError: when the body has fewer shape coefficients.
    """
    toes_before, toes_after = _toe_heights(body, motion.shape), _toe_heights(body, shape)
    scale = (leg_length(body, shape) / leg_length(body, motion.shape))[..., None, None]
    pelvis = motion.translation + body.rest_joints(motion.shape)[..., None, 0, :]
    origin = torch.cat((pelvis[..., :1, :2], _per_frame(toes_before)), -1)
    target = torch.cat((pelvis[..., :1, :2], _per_frame(toes_after)), -1)
    moved = target + scale * (pelvis - origin)
    hands = motion.hands
    if hands is not None:
        from recon.body.hands import with_bones_grown  # rarely needed

        hands = with_bones_grown(hands, body, motion.shape, shape)
    return motion.replace(
        translation=moved - body.rest_joints(shape)[..., None, 0, :], shape=shape, hands=hands
    )


def leg_length(body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
    """Height of the pelvis above the toe joints of a body at rest, metres."""
    rest = body.rest_joints(shape)[..., 1]
    return rest[..., 0] - rest[..., list(TOES)].mean(-1)


def _toe_heights(body: BodyModel, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch"]:
    """Height of the toe joints above the sole of a body at rest, metres."""
    level = body.joint_template[list(TOES), 1].min()
    below = (body.template[:, 1] < level).nonzero()[:, 0]
    sole = body.rest_vertices(shape, below)[..., 1].amin(-1)
    return body.rest_joints(shape)[..., list(TOES), 1].mean(-1) - sole


def _per_frame(height: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 1 1"]:
    return height[..., None, None]
