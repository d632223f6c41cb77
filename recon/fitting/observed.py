"""The observations of one clip, with names and the notes of their reading."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from recon.core.errors import ObservationError
from recon.method.sensor import Sensor


@dataclass(frozen=True)
class Clip:
    """One clip's observations, and what was assumed in reading them."""

    observations: tuple[Sensor, ...]
    """All in the frame of the recording."""
    names: tuple[str, ...]
    notes: tuple[str, ...]
    T_recording_camera: Float[np.ndarray, "4 4"] | None
    """Pose of the one camera whose pose is not known, if there is one; metres."""
    ground_given: bool = False
    """Whether the caller gave the plane that lies at z = 0 of the recording."""


def window(clip: Clip, start: float, stop: float) -> Clip:
    """What was seen from one time to another, both included, seconds of the recording's clock.

    Before the first and after the last moment of all observations there is nothing to fit.

    Raises:
        ValueError: when the times do not rise or nothing was seen between them.
    """
    if not start < stop:
        raise ObservationError(f"--between takes two rising times in seconds, got {start} {stop}")
    ends = [one.start_time + (one.shown.shape[-2] - 1) / one.fps for one in clip.observations]
    first = max(start, min(one.start_time for one in clip.observations))
    last = max(first, min(stop, max(ends)))
    cut = tuple(observation.window(first, last) for observation in clip.observations)
    if not any(len(seen_times(one)) > 0 for one in cut):
        every = np.concatenate([seen_times(one) for one in clip.observations])
        raise ObservationError(
            f"{', '.join(clip.names)}: nothing was seen between {start:g} and {stop:g} s; "
            f"--between counts on the recording's clock, which shows something from "
            f"{every.min():.2f} to {every.max():.2f} s"
        )
    return replace(clip, observations=cut)


def seen_times(observation: Sensor) -> Float[np.ndarray, " moments"]:
    """Times of the frames of an observation that have data, seconds."""
    moments = observation.shown[0].any(-1).nonzero()[:, 0].cpu().numpy()
    return observation.start_time + moments / observation.fps
