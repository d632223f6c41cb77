"""Vertices spread evenly over a body."""

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel

_ALWAYS = 1500
"""Vertices that are found in any case: fewer ones are the first of these."""


def spread_vertices(body: BodyModel, count: int) -> Int[Tensor, " points"]:
    """Vertices of the unposed average body that are farthest from each other; ascending."""
    template = body.template.detach().cpu().double().contiguous().numpy()
    wanted = min(count, len(template))
    found = _in_order(template.tobytes(), min(max(wanted, _ALWAYS), len(template)))
    return torch.from_numpy(np.sort(found[:wanted])).to(body.template.device)


@lru_cache(maxsize=4)
def _in_order(template: bytes, count: int) -> Int[np.ndarray, " count"]:
    """Vertices in the order in which farthest point sampling takes them; of a mesh kept once."""
    return _farthest(np.frombuffer(template).reshape(-1, 3), count)


def _farthest(points: Float[np.ndarray, "points 3"], count: int) -> Int[np.ndarray, " count"]:
    """Farthest point sampling from the first point on, in the order of sampling."""
    chosen = np.zeros(count, np.int64)
    distance = np.full(len(points), np.inf)
    for k in range(1, count):
        away = points - points[chosen[k - 1]]
        np.minimum(distance, np.einsum("ij,ij->i", away, away), out=distance)
        chosen[k] = distance.argmax()
    return chosen
