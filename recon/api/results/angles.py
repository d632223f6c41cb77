"""Joint angles over time, as `recon.joint_angles` returns them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.api.results.printing import in_ten_lines


@dataclass(frozen=True, repr=False)
class JointAngles:
    """Angles of the joints of one clip, by name."""

    convention: str
    """The names and axes: `isb`, or an OpenSim model."""
    times: Float[np.ndarray, " time"]
    """Seconds of the recording's clock."""
    degrees: Mapping[str, Float[np.ndarray, " time"]]
    """Angles by name, degrees, without jumps."""
    metres: Mapping[str, Float[np.ndarray, " time"]]
    """Coordinates of an OpenSim model that are lengths, metres; empty for the ISB."""

    def __repr__(self) -> str:
        """A summary of at most ten lines: how many angles, over how long, and their ranges."""
        first = (
            f"JointAngles: {len(self.degrees)} angles ({self.convention}), {len(self.times)} "
            f"frames, {self.times[0]:.2f} to {self.times[-1]:.2f} s"
        )
        ranges = [
            f"{name}: {values.min():.1f} to {values.max():.1f} degrees"
            for name, values in self.degrees.items()
        ]
        return in_ten_lines(first, ranges, ())
