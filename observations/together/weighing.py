"""How noisy observations of different kinds are, and what they weigh beside each other."""

from collections.abc import Sequence
from dataclasses import dataclass

from observations.depth import PointCloud
from observations.keypoints2d import Keypoints2D
from observations.noise import LIMITS, estimate_noise
from observations.together.first_guess import Seen
from recon.body.model import BodyModel
from recon.core.motion import Motion

CLOUD_NOISE = 0.01
"""Metres that depth sensors, clothes and hair put between points and a smooth body."""
CLOUD_WORTH = 16
"""Points that know their place on the body, as which the cloud of a frame counts, however many
points it has: neighbours err alike, and none of them says more than how far the surface is."""


@dataclass(frozen=True)
class Noise:
    """Of one observation."""

    own: float
    """Standard deviation of every coordinate in its own unit: metres, or pixels in images. Of
    points that say the same as their neighbours, as much larger as makes them count once."""
    metres: float
    """Standard deviation at the body."""


def noise_of(
    observation: Seen, guess: Motion, body: BodyModel, told: float | None = None
) -> Noise:
    """How noisy an observation is: told, or told from its data.

    A pixel is as wide as distance over focal length at the body. A detector's error is taken for
    no smaller than a centimetre there, as its idea of a knee is not the model's.
    """
    if isinstance(observation, PointCloud):
        noise = CLOUD_NOISE if told is None else told
        count = observation.present.sum(-1)
        typical = float(count[count > 0].float().median()) if bool((count > 0).any()) else 1.0
        return Noise(noise * max(typical / CLOUD_WORTH, 1.0) ** 0.5, noise)
    if not isinstance(observation, Keypoints2D):
        found = told or estimate_noise(observation.positions, observation.visible)
        return Noise(found, found)
    pixel = pixel_size(observation, guess, body)
    limits = (LIMITS[0] / pixel, LIMITS[1] / pixel)
    found = told or estimate_noise(observation.pixels, observation.confidence > 0, limits)
    return Noise(found, found * pixel)


def pixel_size(view: Keypoints2D, guess: Motion, body: BodyModel) -> float:
    """Metres that a pixel is wide at the body: median distance over focal length."""
    pelvis = body.pose(guess).joints[..., :1, :].mean(-3, keepdim=True)
    distance = float(view.camera.to_camera(pelvis)[..., 2].clamp(min=0.1).median())
    return distance / float(view.camera.camera_matrix[..., [0, 1], [0, 1]].mean())


def weights_of(noises: Sequence[Noise]) -> list[float]:
    """Multipliers that make the misfits worth what the least noisy one is, in metres²."""
    least = min(noise.metres for noise in noises)
    return [(least / noise.own) ** 2 for noise in noises]
