"""Base of support, and how far inside or outside of it a point lies."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

SUPPORT_HEIGHT = 0.05
"""Metres: skin below this and slower than the next supports the body (HUMOS's released code)."""

SUPPORT_SPEED = 0.4
"""m/s: 2 cm per frame at 20 fps."""


def supporting(
    vertices: Float[Tensor, "time vertices 3"], fps: float
) -> Bool[Tensor, "time vertices"]:
    """Vertices low and slow enough to carry weight.

    Speeds are those to the next frame; the last frame has that of the frame before it.
    """
    step = vertices.diff(dim=0).norm(dim=-1) * fps
    speed = torch.cat((step, step[-1:])) if len(step) else torch.zeros_like(vertices[..., 0])
    return (vertices[..., 2] < SUPPORT_HEIGHT) & (speed < SUPPORT_SPEED)


def base_of_support(points: Float[Tensor, "points 2"]) -> Float[Tensor, "corners 2"] | None:
    """Convex hull of points on the ground, counter-clockwise; None where it has no area."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 3:
        return None
    try:
        corners = ConvexHull(points.detach().cpu().double().numpy()).vertices
    except QhullError:  # all on a line
        return None
    return points[torch.from_numpy(corners.astype(np.int64)).to(points.device)]


def signed_distance(
    point: Float[Tensor, "*points 2"], hull: Float[Tensor, "corners 2"]
) -> Float[Tensor, "*points"]:
    """Distance to the nearest edge of a convex hull, negative inside, metres."""
    edge = hull.roll(-1, 0) - hull
    away = point[..., None, :] - hull
    along = ((away * edge).sum(-1) / edge.square().sum(-1)).clamp(0, 1)
    distance = (away - along[..., None] * edge).norm(dim=-1).amin(-1)
    left = edge[:, 0] * away[..., 1] - edge[:, 1] * away[..., 0]
    return torch.where((left >= 0).all(-1), -distance, distance)


def distances_to_support(
    points: Float[Tensor, "time kinds 2"],
    vertices: Float[Tensor, "time vertices 3"],
    standing: Bool[Tensor, "time vertices"],
) -> tuple[Float[Tensor, "time kinds"], Bool[Tensor, " time"]]:
    """Signed distances of a few points per frame to that frame's base, and where there is one.

    Frames without a base have distance 0, as in HUMOS's released code.
    """
    distances = torch.zeros_like(points[..., 0])
    exists = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    for frame in range(len(points)):
        hull = base_of_support(vertices[frame, standing[frame], :2])
        if hull is not None:
            distances[frame] = signed_distance(points[frame], hull)
            exists[frame] = True
    return distances, exists
