"""Nearest neighbours, frame by frame: which point of the body an observed point belongs to."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_CHUNK = 1 << 24
"""Distances held in memory at once on an accelerator."""


def nearest(
    points: Float[Tensor, "*batch moments points 3"],
    present: Bool[Tensor, "*batch moments points"],
    surface: Float[Tensor, "*batch moments surface 3"],
    allowed: Bool[Tensor, "*batch moments surface"],
) -> Int[Tensor, "*batch moments points"]:
    """Index of the nearest allowed point of the surface of the same moment; no gradient.

    Exact: by a k-d tree for every moment on the processor, by all distances in chunks elsewhere.
    Where a moment allows nothing, everything is allowed; zero where a point is not present.
    """
    allowed = allowed | ~allowed.any(-1, keepdim=True)
    points, surface = points.detach(), surface.detach()
    frames = [
        tensor.flatten(0, -3 if tensor.is_floating_point() else -2)
        for tensor in (points, present, surface, allowed)
    ]
    search = _by_trees if points.device.type == "cpu" else _by_distances
    return search(*frames).unflatten(0, points.shape[:-2])


def _by_trees(points: Tensor, present: Tensor, surface: Tensor, allowed: Tensor) -> Tensor:
    from scipy.spatial import KDTree

    found = np.zeros(present.shape, np.int64)
    rows = zip(points.numpy(), present.numpy(), surface.numpy(), allowed.numpy(), strict=True)
    for row, (seen, here, body, open_) in enumerate(rows):
        if not here.any():
            continue
        candidates = np.flatnonzero(open_)
        # unbalanced: such a tree is built several times faster and asked almost as fast
        tree = KDTree(body[candidates], balanced_tree=False, compact_nodes=False)
        found[row, here] = candidates[tree.query(seen[here])[1]]
    return torch.from_numpy(found)


def _by_distances(points: Tensor, present: Tensor, surface: Tensor, allowed: Tensor) -> Tensor:
    found = torch.zeros(present.shape, dtype=torch.long, device=points.device)
    rows = max(1, _CHUNK // max(points.shape[-2] * surface.shape[-2], 1))
    for some in torch.arange(len(points), device=points.device).split(rows):
        distance = torch.cdist(
            points[some], surface[some], compute_mode="donot_use_mm_for_euclid_dist"
        )
        distance = torch.where(allowed[some][:, None], distance, torch.inf)
        found[some] = distance.argmin(-1)
    return torch.where(present, found, 0)
