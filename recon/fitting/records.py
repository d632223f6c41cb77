"""Records of the fit of one clip: its input `Clip`, its result `ClipFit`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from torch import Tensor

from recon.core.errors import ObservationError
from recon.core.residuals import Noise
from recon.method.reconstruction import Reconstruction
from recon.method.sensor import Sensor
from recon.method.stages import ComparedHypotheses


@dataclass(frozen=True)
class Clip:
    """One clip's observations, and what was assumed in reading them."""

    observations: tuple[Sensor, ...]
    """Sensors' data, all in the frame of the recording."""
    names: tuple[str, ...]
    notes: tuple[str, ...]
    T_recording_camera: Float[np.ndarray, "4 4"] | None
    """Pose (m) of the one camera whose pose is not known; None if there is none."""
    ground_given: bool = False
    """Whether the caller gave the plane that lies at z = 0 of the recording."""
    starts: tuple[float, ...] = ()
    """Start times (s) of the observations before a part was cut out; empty without a cut."""


def clip_between(clip: Clip, start: float, stop: float) -> Clip:
    """Cut out a clip's data between two times (s of the recording's clock), both included.

    The part is limited to the first and last frame of all observations.

    Raises:
        ValueError: when the times do not rise or nothing was seen between them.
    """
    if not start < stop:
        raise ObservationError(f"--between takes two rising times in seconds, got {start} {stop}")
    ends = [one.start_time + (one.shown.shape[-2] - 1) / one.fps for one in clip.observations]
    first = max(start, min(one.start_time for one in clip.observations))
    last = min(stop, max(ends))
    cut = tuple(one.window(first, last) for one in clip.observations) if first <= last else ()
    if not any(len(seen_times(one)) > 0 for one in cut):
        times = np.concatenate([seen_times(one) for one in clip.observations])
        raise ObservationError(
            f"{', '.join(clip.names)}: nothing was seen between {start:g} and {stop:g} s; "
            f"--between counts on the recording's clock, on which data range from "
            f"{times.min():.2f} to {times.max():.2f} s"
        )
    return replace(clip, observations=cut, starts=start_times(clip))


def start_times(clip: Clip) -> tuple[float, ...]:
    """Return the start times (s) of the observations before any cut."""
    return clip.starts or tuple(one.start_time for one in clip.observations)


def seen_times(observation: Sensor) -> Float[np.ndarray, " moments"]:
    """Return the times (s) of the frames of an observation that have data in any clip."""
    moments = observation.shown.any(-1).flatten(0, -2).any(0).nonzero()[:, 0].cpu().numpy()
    return observation.start_time + moments / observation.fps


def seen_moments(observations: Sequence[Sensor]) -> Float[np.ndarray, " moments"]:
    """Return the times (s) at which any sensor has data, rising, rounded to milliseconds."""
    return np.unique(np.concatenate([seen_times(one) for one in observations]).round(3))


@dataclass(frozen=True)
class ClipFit:
    """The fit of one clip, with its observations, noise and ground."""

    result: Reconstruction
    """The fit in the world, where z = 0 is the ground."""
    noises: tuple[Noise, ...]
    ground_known: bool
    T_world_recording: Float[Tensor, "clips 4 4"]
    """Transform from the frame of the observations to the world (m)."""
    observations: tuple[Sensor, ...]
    """The observations as fitted, with indices of the unknown offsets of their points."""
    grounded: bool = True
    """Whether there is a ground at all; without one, the world is the frame of the observations
    and its z = 0 means nothing."""
    ground_seen: bool = False
    """Whether an unknown ground was laid on a plane that is given or seen."""

    @property
    def comparisons(self) -> tuple[ComparedHypotheses, ...]:
        """The hypotheses that stages compared, stage by stage."""
        stages = [report.compared for report in self.result.reports]
        return tuple(one for one in stages if one is not None)

    @property
    def lens_found(self) -> bool:
        """Whether the focal length of the camera was fitted with the motion."""
        return self.result.estimate.scene.lens is not None
