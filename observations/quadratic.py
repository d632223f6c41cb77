"""Energies of sensors about the places of their points."""

import torch
from jaxtyping import Float
from torch import Tensor

from observations.keypoints2d import Keypoints2D
from observations.moments import Tracker
from recon.core.robust import geman_mcclure
from recon.method.protocols import REFERENCE_FPS


def energy_of(sensor: Tracker, points: Float[Tensor, "moments points 3"]) -> Float[Tensor, ""]:
    """The value of `point_model` alone."""
    rate = REFERENCE_FPS / sensor.fps
    if isinstance(sensor, Keypoints2D):
        projected = sensor.camera.project(points)
        error = geman_mcclure((projected.pixels - sensor.pixels).square(), sensor.sigma)
        error = torch.where(projected.in_front[..., None], error, sensor.sigma**2).sum(-1)
        return 0.5 * rate * (sensor.confidence.square() * error).sum()
    away = (points - sensor.positions).square().sum(-1)
    return 0.5 * rate * sensor.kernel(away).where(sensor.visible, 0.0).sum()
