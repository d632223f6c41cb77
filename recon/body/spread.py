"""Vertices spread evenly over a body."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel


def spread_vertices(body: BodyModel, count: int) -> Int[Tensor, " points"]:
    """Vertices of the unposed average body that are farthest from each other; ascending."""
    template = body.template.detach().cpu().double().numpy()
    chosen = _farthest(template, min(count, len(template)))
    return torch.from_numpy(chosen).to(body.template.device)


def _farthest(points: Float[np.ndarray, "points 3"], count: int) -> Int[np.ndarray, " count"]:
    """Farthest point sampling from the first point on."""
    chosen = np.zeros(count, np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        distance = np.minimum(distance, np.square(points - points[chosen[k - 1]]).sum(1))
        chosen[k] = distance.argmax()
    return np.sort(chosen)
