"""Orthonormal cosines over the frames of a clip (DCT-II); few of them describe a slow motion."""

import math

import torch
from jaxtyping import Float
from torch import Tensor


def cosines(frames: int, count: int) -> Float[Tensor, "frames cosines"]:
    """Return a matrix whose columns are the first `count` DCT-II cosines over `frames` frames."""
    t = torch.arange(frames, dtype=torch.float64)[:, None] + 0.5
    k = torch.arange(count, dtype=torch.float64)
    amplitude = torch.where(k == 0, 1.0, 2.0).sqrt() / math.sqrt(frames)
    return amplitude * (math.pi * t * k / frames).cos()
