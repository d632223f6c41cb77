"""Nearest neighbours in place and in kind: points of a surface that look like what was seen."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_AT_ONCE = 16
"""Moments whose costs are in memory together; so few that they stay in the cache."""


def nearest_alike(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    kinds: Float[Tensor, "moments points kinds"],
    surface: Float[Tensor, "moments surface 3"],
    allowed: Bool[Tensor, "moments surface"],
    of_surface: Float[Tensor, "surface kinds"],
) -> Int[Tensor, "moments points"]:
    """Index of the allowed point j of the surface that costs least; no gradient.

    Point i costs |p_i - s_j|² + k_i · k_j, with k_i its row of `kinds`: what it costs to be of a
    kind, metres². Where a moment allows nothing, everything is allowed; zero where a point is not
    present.

    Args:
        points: that were seen, metres.
        present: which of them exist.
        kinds: k_i.
        surface: places of the surface at every moment, metres.
        allowed: which of them may be seen.
        of_surface: k_j.
    """
    allowed = allowed | ~allowed.any(-1, keepdim=True)
    found = torch.zeros(present.shape, dtype=torch.long, device=points.device)
    moments = present.any(-1).nonzero()[:, 0]
    for some in moments.split(_AT_ONCE):
        open_ = allowed[some]
        most = int(open_.sum(-1).max())
        # allowed ones first, in their order
        pick = torch.argsort(~open_, dim=-1, stable=True)[:, :most]
        there = surface[some].gather(1, pick[..., None].expand(*pick.shape, 3)).detach()
        middle = there.mean(1, keepdim=True)  # so that little is lost in rounding
        there, here = there - middle, points[some].detach() - middle
        size = there.square().sum(-1, keepdim=True)
        size = size.masked_fill(~open_.gather(1, pick)[..., None], 1e9)
        left = torch.cat((-2 * here, torch.ones_like(here[..., :1]), kinds[some]), -1)
        right = torch.cat((there, size, of_surface[pick]), -1)
        best = (left @ right.mT).argmin(-1)
        found[some] = pick.gather(1, best)
    return torch.where(present, found, 0)
