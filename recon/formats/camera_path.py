"""How a camera was carried, where nobody knows the ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class CameraPath:
    """How a camera was carried, in the world of a tracker that knows nothing of the ground."""

    T_world_camera: Float[np.ndarray, "time 4 4"]
    """A pose for every frame, in the tracker's unit."""
    metric: bool
    """Whether that unit is the metre."""
    level: bool
    """Whether the z axis of the tracker's world points up."""
