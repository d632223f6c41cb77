"""Which cameras have no pose, so that the frame of the recording is their own."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from observations.together import kinds
from recon.method.protocols import Sensor


def camera_frame_is_recording(seen: Sensor) -> bool:
    """Whether a fixed camera's pose is the identity, as it is where nobody gave one.

    A camera cannot stand so in the world: it would lie on the ground and look straight up.
    """
    for one in kinds.with_camera([seen]):
        if one.camera is not None:
            poses = one.camera.T_camera_world
            return bool((poses == torch.eye(4).to(poses)).all())
    return False


def unposed_camera(seen: Sequence[Sensor]) -> Float[np.ndarray, "4 4"] | None:
    """First pose of the first camera that does not know the ground, T_recording_camera."""
    for one in kinds.with_camera(seen):
        if one.camera is not None and not one.ground_known:
            return one.camera.T_world_camera[0, 0].double().cpu().numpy()
    return None
