"""The pose that joints take which no marker shows: how people stand on average, arms hanging."""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from priors.pose.prior import PosePrior


@cache
def natural_pose() -> Float[Tensor, "21 3 3"]:
    """Mean rotation of every body joint over the motions that the bundled pose prior learned."""
    return PosePrior.load().density.mean.float()


def with_natural_pose(rotations: Float[Tensor, "*batch 22 3 3"]) -> Float[Tensor, "*batch 22 3 3"]:
    """Poses with the same root rotations, and all other joints at rest."""
    pose = natural_pose().to(rotations).expand(*rotations.shape[:-3], 21, 3, 3)
    return torch.cat((rotations[..., :1, :, :], pose), -3)
