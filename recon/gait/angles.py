"""Joint angles over time, as `recon.joint_angles` returns them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from recon.api.given import BodyLike, MotionLike, body_given, motion_given
from recon.api.results import in_ten_lines
from recon.body.angles import isb_angles
from recon.body.opensim import TRANSLATIONS, opensim_coordinates
from recon.core.errors import ReconError


@dataclass(frozen=True, repr=False)
class JointAngles:
    """Joint angles of one clip over time, by name."""

    convention: str
    """The names and axes: `isb`, or an OpenSim model."""
    times: Float[np.ndarray, " time"]
    """Seconds of the recording's clock."""
    degrees: Mapping[str, Float[np.ndarray, " time"]]
    """Angles by name, degrees, without jumps."""
    metres: Mapping[str, Float[np.ndarray, " time"]]
    """Coordinates of an OpenSim model that are lengths, metres; empty for the ISB."""

    def __repr__(self) -> str:
        """A summary in at most ten lines: number of angles, duration and ranges."""
        first = (
            f"JointAngles: {len(self.degrees)} angles ({self.convention}), {len(self.times)} "
            f"frames, {self.times[0]:.2f} to {self.times[-1]:.2f} s"
        )
        ranges = [
            f"{name}: {values.min():.1f} to {values.max():.1f} degrees"
            for name, values in self.degrees.items()
        ]
        return in_ten_lines(first, ranges, ())


def joint_angles(
    motion: MotionLike,
    *,
    convention: Literal["isb", "rajagopal2016", "gait2392"] = "isb",
    body: BodyLike = None,
) -> JointAngles:
    """Joint angles of a motion in degrees, at the motion's times.

    They have no standard deviations: those of joints are known without the correlations that an
    angle depends on.

    Args:
        motion: a motion of one clip.
        convention: the recommendations of the International Society of Biomechanics, whose names
            say what a positive angle is, or the coordinates of an OpenSim model.
        body: whose motion it is; the bundled one, whose bony landmarks are known.

    Raises:
        ReconError: when the body is another one, or the convention is none of these.
    """
    model = body_given(body)
    given = motion_given(motion, model).motion
    times = given.times.double().cpu().numpy()
    if convention == "isb":
        return JointAngles(convention, times, isb_angles(given, model), {})
    if convention not in ("rajagopal2016", "gait2392"):
        raise ReconError(
            f"convention: expected isb, rajagopal2016 or gait2392, got {convention!r}"
        )
    found = opensim_coordinates(given, model, convention)
    lengths = {name: values for name, values in found.items() if name in TRANSLATIONS}
    angles = {name: values for name, values in found.items() if name not in TRANSLATIONS}
    return JointAngles(convention, times, angles, lengths)
