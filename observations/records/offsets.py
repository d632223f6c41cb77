"""Tracked points that sit away from their place on the model."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from recon.method.protocols import Estimate


def displaced(
    points: Float[Tensor, "*batch time points 3"],
    estimate: Estimate,
    bones: Sequence[int],
    rows: tuple[int, int] | None,
    unit: float = 1.0,
) -> Float[Tensor, "*batch time points 3"]:
    """Points of the model with their `Scene.offsets` added, which turn with their bones.

    Args:
        points: world, metres.
        estimate: the bones' orientations and the offsets.
        bones: of every point.
        rows: of the offsets, first and one past the last; None leaves the points where they are.
        unit: of the offsets, metres.
    """
    if rows is None:
        return points
    turns = estimate.body.orientations[..., list(bones), :, :]
    offsets = estimate.scene.offsets[..., None, slice(*rows), :, None]
    return points + unit * (turns @ offsets)[..., 0]
