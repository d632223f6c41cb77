"""Centre of pressure from heights: skin near the ground presses, skin below it presses harder."""

from jaxtyping import Float
from torch import Tensor

GAMMA = 30.0
"""Per metre above the ground: 5 cm up, a fifth of the pressure is left. HUMOS prints 10, but ran
30, the value its 25 cm rule follows from."""

ALPHA = 100.0
"""Per metre below the ground."""


def pressure(heights: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """exp(-γ h) above the ground, 1 - α h below it (HUMOS, IPMAN)."""
    above = (-GAMMA * heights.clamp(min=0)).exp()
    return above + ALPHA * (-heights).clamp(min=0)


def centre_of_pressure(
    points: Float[Tensor, "*batch points 3"], areas: Float[Tensor, " points"]
) -> Float[Tensor, "*batch 2"]:
    """Mean of points on the skin, weighted by pressure × area, on the ground z = 0; metres.

    Heights alone cannot tell which of two equally low feet carries the body. A point exists
    however high the body is: gate it.
    """
    heights = points[..., 2]
    # a body in the air is let down first: all its weights change by one factor
    floor = heights.detach().amin(-1, keepdim=True).clamp(min=0)
    weights = pressure(heights - floor) * areas
    return (weights[..., None] * points[..., :2]).sum(-2) / weights.sum(-1, keepdim=True)
