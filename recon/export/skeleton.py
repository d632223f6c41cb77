"""Skeleton, skinning weights and quaternions of a motion, for all exporters."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS


def one_clip(motion: Motion) -> Motion:
    """Return the valid frames of a motion of one clip, on the CPU and without gradients.

    Raises:
        ReconError: when it has a batch axis.
    """
    if motion.translation.ndim != 2:
        raise ReconError("expected one clip without a batch axis; export motion[k]")
    return motion.window(0, int(motion.valid.sum())).detach().to(device="cpu")


def offsets_from_parents(rest: Float[np.ndarray, "22 3"]) -> Float[np.ndarray, "22 3"]:
    """Return the vector from parent to joint in the rest pose (root: from the origin), metres."""
    root = np.array(PARENTS)[:, None] < 0
    return rest - np.where(root, rest.dtype.type(0), rest[list(PARENTS)])


@dataclass(frozen=True)
class Skeleton:
    """Joints, rotations and skinning of a motion for a file: 22 joints, 52 if it has fingers."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """Parent of every joint, -1 for the root."""
    offsets: Float[np.ndarray, "joints 3"]
    """Vector from the parent in the rest pose, metres; for the root, from the origin."""
    rotations: Float[Tensor, "time joints 3 3"]
    """Rotation of every joint relative to its parent."""
    weights: Float[Tensor, "vertices joints"]
    """Skinning weights."""
    binds: Float[np.ndarray, "joints 4 4"]
    """Inverse bind matrices: from the unposed skin to the frame of every joint at rest."""

    @classmethod
    def of(cls, motion: Motion, body: BodyModel) -> "Skeleton":
        """Make the skeleton of one clip; finger joints are flat at rest, the skin is relaxed."""
        rest = body.rest_joints(motion.shape).detach().float().numpy()
        binds = np.tile(np.eye(4, dtype=np.float32), (len(JOINTS), 1, 1))
        binds[:, :3, 3] = -rest
        offsets = offsets_from_parents(rest)
        if motion.hands is None:
            return cls(JOINTS, PARENTS, offsets, motion.rotations, body.weights, binds)
        from recon.body.hands import (  # imported only for fingers
            finger_offsets,
            skin_weights_with_fingers,
        )
        from recon.core.fingers import HAND_JOINTS, HAND_PARENTS

        count = len(HAND_JOINTS)
        weights, fingers = skin_weights_with_fingers(motion, body)
        ways = finger_offsets(motion, body)[:count].detach().float().numpy()
        return cls(
            (*JOINTS, *HAND_JOINTS), (*PARENTS, *HAND_PARENTS[:count]),
            np.concatenate((offsets, ways)),
            torch.cat((motion.rotations, motion.hands.rotations), 1),
            weights, np.concatenate((binds, fingers.numpy())),
        )  # fmt: skip


def largest_skin_weights(
    weights: Float[Tensor, "vertices joints"], most: int | None = None
) -> tuple[Float[np.ndarray, "vertices some"], Int[np.ndarray, "vertices some"]]:
    """Select the largest skinning weights per vertex, scaled to sum to one, and their joints.

    Args:
        weights: skinning weights.
        most: number of weights per vertex; None takes as many as the vertex with the most has.
    """
    weights, joints = weights.double().cpu().sort(dim=-1, descending=True, stable=True)
    count = int((weights > 0).sum(-1).max()) if most is None else most
    weights, joints = weights[:, :count], joints[:, :count]
    weights = weights / weights.sum(-1, keepdim=True)
    return weights.float().numpy(), torch.where(weights > 0, joints, 0).numpy()


def quaternions(rotations: Float[Tensor, "time joints 3 3"]) -> Float[Tensor, "time joints 4"]:
    """Convert rotations to unit quaternions (x, y, z, w) whose sign never flips between frames.

    Linear interpolation between q and -q' would take the long way round.
    """
    vector = so3.log(rotations)
    half = vector.norm(dim=-1, keepdim=True) / 2
    q = torch.cat((vector * torch.sinc(half / torch.pi) / 2, half.cos()), -1)
    signs = (q[1:] * q[:-1]).sum(-1).sign()
    signs = torch.where(signs == 0, 1.0, signs).cumprod(0)
    q = torch.cat((q[:1], q[1:] * signs[..., None]))
    return q / q.norm(dim=-1, keepdim=True)
