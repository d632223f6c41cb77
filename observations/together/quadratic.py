"""What sensors say about the places of their points, as quadratic models of their energies."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from observations.records.tracked import TrackedPoints
from observations.together.moments import Tracker
from recon.core.camera import NEAREST
from recon.core.robust import geman_mcclure, squared
from recon.method.protocols import REFERENCE_FPS


@dataclass(frozen=True)
class PointModel:
    """An energy about given places p of points: E + gᵀ dp + ½ dpᵀ A dp, point by point."""

    value: Float[Tensor, ""]
    """E, unit of the sensor squared."""
    gradient: Float[Tensor, "moments points 3"]
    """g; that unit squared per metre."""
    curvature: Float[Tensor, "moments points 3 3"]
    """A, positive semidefinite: second derivatives of the kernel and the camera are left out."""


def model_of(sensor: Tracker, points: Float[Tensor, "moments points 3"]) -> PointModel:
    """The energy of a sensor (without a leading axis of clips) about predicted points.

    Args:
        sensor: what was seen.
        points: predicted at the same moments, world, metres.
    """
    if isinstance(sensor, Keypoints2D):
        model = _of_pixels(sensor, points)
    else:
        model = _of_places(sensor, points)
    rate = REFERENCE_FPS / sensor.fps
    return PointModel(rate * model.value, rate * model.gradient, rate * model.curvature)


def energy_of(sensor: Tracker, points: Float[Tensor, "moments points 3"]) -> Float[Tensor, ""]:
    """The value of `model_of` alone."""
    rate = REFERENCE_FPS / sensor.fps
    if isinstance(sensor, Keypoints2D):
        projected = sensor.camera.project(points)
        error = geman_mcclure((projected.pixels - sensor.pixels).square(), sensor.sigma)
        error = torch.where(projected.in_front[..., None], error, sensor.sigma**2).sum(-1)
        return 0.5 * rate * (sensor.confidence.square() * error).sum()
    away = (points - sensor.positions).square().sum(-1)
    return 0.5 * rate * sensor.kernel(away).where(sensor.visible, 0.0).sum()


def _of_places(sensor: TrackedPoints, points: Tensor) -> PointModel:
    away = points - sensor.positions
    size, counts = away.square().sum(-1), sensor.visible.to(points)
    value, slope = size, counts
    if sensor.kernel is not squared:
        with torch.enable_grad():
            variable = size.detach().requires_grad_()
            value = sensor.kernel(variable)
            (slope,) = torch.autograd.grad(value.sum(), variable)
        value, slope = value.detach(), slope * counts
    identity = torch.eye(3, dtype=points.dtype, device=points.device)
    return PointModel(
        0.5 * (value * counts).sum(), slope[..., None] * away, slope[..., None, None] * identity
    )


def _of_pixels(sensor: Keypoints2D, points: Tensor) -> PointModel:
    camera = sensor.camera
    seen = camera.to_camera(points)
    in_front = seen[..., 2] > NEAREST
    depth = torch.where(in_front, seen[..., 2], 1.0)[..., None]
    rays = seen[..., :2] / depth
    matrix = camera.camera_matrix
    pixels = rays @ matrix[..., :2, :2].mT + matrix[..., None, :2, 2]
    bent = torch.cat((torch.eye(2).to(rays).expand(*rays.shape, 2), -rays[..., None]), -1)
    jacobian = matrix[..., None, :2, :2] @ (bent / depth[..., None])
    jacobian = jacobian @ camera.T_camera_world[..., None, :3, :3]
    away, scale = pixels - sensor.pixels, sensor.sigma**2
    error = torch.where(in_front[..., None], geman_mcclure(away.square(), sensor.sigma), scale)
    counts = sensor.confidence.square()
    slope = (scale / (scale + away.square())).square() * (counts * in_front)[..., None]
    weighted = slope[..., None] * jacobian
    return PointModel(
        0.5 * (counts * error.sum(-1)).sum(),
        (away[..., None, :] @ weighted)[..., 0, :],
        jacobian.mT @ weighted,
    )
