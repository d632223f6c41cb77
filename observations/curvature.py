"""Second-order models of point energies, linearised at the predicted positions."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.robust import geman_mcclure, squared
from recon.method.quadratic import PointModel

if TYPE_CHECKING:
    from recon.core.camera import Camera
else:  # points in space have no camera
    from typing import Any as Camera


def of_places(
    points: Float[Tensor, "*batch moments points 3"],
    positions: Float[Tensor, "*batch moments points 3"],
    weights: Tensor,
    kernel: Callable[[Tensor], Tensor],
    rate: float,
) -> PointModel:
    """The model of E = rate ½ Σ kernel(w² |p - observed|²); weights w (*batch, frames, points)."""
    away = points - positions
    slope = weights.to(points).square()
    value = slope * away.square().sum(-1)
    if kernel is not squared:
        with torch.enable_grad():
            variable = value.detach().requires_grad_()
            counted = kernel(variable)
            (by_square,) = torch.autograd.grad(counted.sum(), variable)
        value, slope = counted.detach(), by_square * slope
    slope = rate * slope
    identity = torch.eye(3, dtype=points.dtype, device=points.device)
    return PointModel(
        0.5 * rate * value.sum((-2, -1)),
        slope[..., None] * away,
        slope[..., None, None] * identity,
    )


def of_pixels(
    points: Float[Tensor, "*batch moments points 3"],
    camera: Camera,
    pixels: Float[Tensor, "*batch moments points 2"],
    confidence: Float[Tensor, "*batch moments points"],
    sigma: float,
    rate: float,
) -> PointModel:
    """The model of rate ½ Σ c² (ρ(Δu) + ρ(Δv)), with the kernel ρ of Geman and McClure."""
    from recon.core.camera import NEAREST

    seen = camera.to_camera(points)
    in_front = seen[..., 2] > NEAREST
    depth = torch.where(in_front, seen[..., 2], 1.0)[..., None]
    rays = seen[..., :2] / depth
    matrix = camera.camera_matrix
    predicted = rays @ matrix[..., :2, :2].mT + matrix[..., None, :2, 2]
    bent = torch.cat((torch.eye(2).to(rays).expand(*rays.shape, 2), -rays[..., None]), -1)
    jacobian = matrix[..., None, :2, :2] @ (bent / depth[..., None])
    jacobian = jacobian @ camera.T_camera_world[..., None, :3, :3]
    away, scale = predicted - pixels, sigma**2
    error = torch.where(in_front[..., None], geman_mcclure(away.square(), sigma), scale)
    counts = rate * confidence.square()
    slope = (scale / (scale + away.square())).square() * (counts * in_front)[..., None]
    weighted = slope[..., None] * jacobian
    return PointModel(
        0.5 * (counts * error.sum(-1)).sum((-2, -1)),
        (away[..., None, :] @ weighted)[..., 0, :],
        jacobian.mT @ weighted,
    )
