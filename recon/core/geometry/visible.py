"""Which parts of a surface a sensor may see."""

from jaxtyping import Bool, Float
from torch import Tensor


def facing(
    middles: Float[Tensor, "*batch discs 3"],
    normals: Float[Tensor, "*batch discs 3"],
    eye: Float[Tensor, "*batch 3"],
) -> Bool[Tensor, "*batch discs"]:
    """Whether the outer side of a disc is turned towards the eye."""
    return ((eye[..., None, :] - middles) * normals).sum(-1) >= 0
