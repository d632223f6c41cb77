"""The direction from a body's right to its left, which tells its two alike sides apart."""

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

_WIDEST = 0.15
"""Metres beside the middle of the unposed body beyond which a place counts no more: hands are far
from it there, and anywhere when posed."""


def from_right_to_left(
    points: Float[Tensor, "moments points 3"],
    places: Float[Tensor, "moments points 3"],
    weights: Float[Tensor, "moments points"],
) -> Float[Tensor, "moments 3"]:
    """Unit direction in which points lie whose places are on the left, of every moment.

    It is that of the covariance Σ w (s - s̄) (p - p̄) of points p and the coordinate s of their
    places from right to left, at most 15 cm. With left and right of all places exchanged, it is
    the opposite one. Where nothing tells, it is zero.

    Args:
        points: positions, metres.
        places: where on the unposed body they lie, metres.
        weights: how much each counts; zero for points off the body.
    """
    aside = places[..., 0].clamp(-_WIDEST, _WIDEST)
    share = weights / weights.sum(-1, keepdim=True).clamp(min=1e-6)
    middle = (share * aside).sum(-1, keepdim=True)
    return normalize(((share * (aside - middle))[..., None] * points).sum(-2), dim=-1)
