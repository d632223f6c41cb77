"""The pose that joints take which no marker shows: how people stand on average, arms hanging."""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from priors.pose.prior import PosePrior
from recon.method.protocols import REFERENCE_FPS, Estimate


@cache
def natural_pose() -> Float[Tensor, "21 3 3"]:
    """Mean rotation of every body joint over the motions that the bundled pose prior learned."""
    return PosePrior.load().density.mean.float()


def natural_rest(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Σ (1 - cos angle) of the 21 body joints away from the natural pose, at 30 Hz.

    Takes the place of `terms.rest_pose`, which draws arms without markers into a T-pose.
    """
    motion = estimate.motion
    body = motion.rotations[..., 1:, :, :]
    away = (body - natural_pose().to(body)).square().sum((-1, -2, -3)) / 4
    return away.where(motion.valid, 0.0).sum(-1) * (REFERENCE_FPS / motion.fps)


def with_natural_pose(rotations: Float[Tensor, "*batch 22 3 3"]) -> Float[Tensor, "*batch 22 3 3"]:
    """Poses with the same root rotations, and all other joints at rest."""
    pose = natural_pose().to(rotations).expand(*rotations.shape[:-3], 21, 3, 3)
    return torch.cat((rotations[..., :1, :, :], pose), -3)
