"""Several calibrated views of one moment: points in space from their rays."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from observations.start.rigid import rigid_start
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion

_LEAST_ANGLE = 0.03
"""Radians between the rays that meet in a point; below it, depth is mostly noise."""


def triangulate(
    views: Sequence[Keypoints2D],
) -> tuple[Float[Tensor, "batch moments points 3"], Bool[Tensor, "batch moments points"]]:
    """Points nearest to their rays, weighed by confidence, in the recording's frame; which exist.

    The point with least Σ c² |(I - d dᵀ)(x - o)|² over rays from o along the unit vector d: three
    linear equations per point, any number of views at once (OpenCV's triangulation takes two).
    A point exists where two views see it from directions that differ.

    Raises:
        ValueError: when the views do not share clock and layout.
    """
    clocks = {(v.fps, v.start_time, *v.pixels.shape[:-1]) for v in views}
    if len(clocks) != 1:
        raise ObservationError(
            "views are triangulated moment by moment: expected one clock and layout, got "
            + " and ".join(f"{fps:g} fps from {t:g} s, {tuple(n)}" for fps, t, *n in clocks)
        )
    matrix = views[0].pixels.new_zeros(*views[0].confidence.shape, 3, 3)
    vector = views[0].pixels.new_zeros(*views[0].confidence.shape, 3)
    spread, count = torch.zeros_like(vector), torch.zeros_like(views[0].confidence)
    for view in views:
        far = view.camera.unproject(view.pixels, torch.ones_like(view.confidence))
        origin = view.camera.T_world_camera[..., None, :3, 3]
        ray = torch.nn.functional.normalize(far - origin, dim=-1)
        across = torch.eye(3).to(ray) - ray[..., :, None] * ray[..., None, :]
        across = view.confidence.square()[..., None, None] * across
        matrix = matrix + across
        vector = vector + (across @ origin[..., None])[..., 0]
        seen = (view.confidence > 0).to(ray)
        spread, count = spread + seen[..., None] * ray, count + seen
    # n rays at small angles a to their mean have a sum of length n (1 - a²/2)
    narrow = (spread.norm(dim=-1) / count.clamp(min=1)).clamp(max=1)
    exists = (count >= 2) & (2 * (1 - narrow) > (_LEAST_ANGLE / 2) ** 2)
    solvable = torch.where(exists[..., None, None], matrix, torch.eye(3).to(matrix)).double()
    points = torch.linalg.solve(solvable, vector.double()[..., None])[..., 0].to(vector)
    return torch.where(exists[..., None], points, 0.0), exists


def tell_distance(views: Sequence[Keypoints2D]) -> bool:
    """Whether some point of every clip is seen from directions that differ.

    Cameras side by side see hardly more than one of them does: not how far a person is.
    """
    _, exists = triangulate(views)
    return bool(exists.any(-1).any(-1).all())


def views_start(body: BodyModel, views: Sequence[Keypoints2D]) -> Motion:
    """The rest pose laid on the triangulated torso, frame by frame."""
    first = views[0]
    positions, visible = triangulate(views)
    shape = positions.new_zeros(body.shape_size)
    return rigid_start(
        body, first.points.at_rest(body, shape), first.points.bones, positions, visible,
        fps=first.fps, start_time=first.start_time,
    )  # fmt: skip
