"""Completes sparse recordings of any length by one motion that also covers unseen moments."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from observations.depth import CLOUD_NOISE
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.fitting.clip import fit_clip
from recon.fitting.cycles import (
    FITTED,
    NAMED_NOISE,
    RATES,
    at_least_30_hz,
    observations_in_space,
    seen_moments_per_second,
)
from recon.fitting.methods import FitOptions
from recon.fitting.records import ClipFit
from recon.method.sensor import Sensor
from recon.method.stages import Watch

FEW = 12.0
"""Frames with data per second below which their noise cannot be estimated."""


@dataclass(frozen=True)
class WholeRecording:
    """The prior of any motion by which a whole recording is completed."""

    completes: ClassVar[bool] = True
    prior: str = "humor"
    """Name of the prior."""
    weights: str = "open"
    """Its weights, `open` or a file."""

    @classmethod
    def load(cls, weights: str, body: BodyModel | None = None) -> "WholeRecording":
        """Return the default prior, with weights of this name."""
        del body
        return cls(weights=weights)


def complete_recording(
    observations: Sequence[Sensor],
    prior: WholeRecording,
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    start: Motion | None = None,
) -> ClipFit:
    """Fit one motion to a sparse recording, at 30 Hz or more.

    Args:
        observations: sensors' data of one clip.
        prior: the prior of any motion.
        options: options of the fit; the prior in them is ignored.
        body: body model to be fitted.
        watch: called after every iteration.
        start: an earlier fit, axes (1, time); None for none.

    Raises:
        ObservationError: when at most one frame has data.
    """
    in_space = observations_in_space(observations)
    if in_space and seen_moments_per_second(in_space) == 0 and len(in_space) == len(observations):
        raise ObservationError(
            "at most one frame has data, so there is no motion to fit; give two or more"
        )
    seen = [
        one if one.places is None else at_least_30_hz(one.with_at_most_points(FITTED))
        for one in observations
    ]
    few = bool(in_space) and seen_moments_per_second(in_space) < FEW
    noise = tuple(
        given_or_usual_noise(one, options.noise_of(row), few) for row, one in enumerate(seen)
    )
    any_motion = replace(options, prior=prior.prior, weights=prior.weights, noise=noise)
    begun = start and start.resample(max(one.fps for one in seen))
    return fit_clip(seen, any_motion, body, watch, begun)


def given_or_usual_noise(sensor: Sensor, given: float | None, few_moments: bool) -> float | None:
    """Return the noise (m) to assume for an observation; None leaves it to be estimated.

    Noise cannot be estimated from few frames, so the usual one is assumed unless it is given.
    Energies are taken at 30 Hz whatever the clock: few frames with data on a fast clock would each
    count for less than a frame, for which a smaller noise compensates.
    """
    if not few_moments or sensor.places is None:
        return given
    usual = NAMED_NOISE if sensor.named else CLOUD_NOISE
    often = max(seen_moments_per_second([sensor]), RATES[0])
    return (usual if given is None else given) * (often / max(sensor.fps, often)) ** 0.5
