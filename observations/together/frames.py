"""Observations in another frame: what the front door does where a ground or no pose is given."""

import numpy as np
import torch
from jaxtyping import Float

from observations.depth import PointCloud
from observations.keypoints2d import Keypoints2D
from observations.tracked import TrackedPoints
from recon.core.camera import Camera, transform
from recon.core.errors import ObservationError
from recon.method.protocols import Sensor


def carried(seen: Sensor, T_new_old: Float[np.ndarray, "4 4"]) -> Sensor:
    """An observation after a rigid transform of the frame that its data are in.

    Args:
        seen: in the old frame.
        T_new_old: maps points of the old frame to the new one, metres.

    Raises:
        ValueError: when the sensor is of a kind of which nobody knows how it changes.
    """
    if isinstance(seen, Keypoints2D):
        return seen.derived(camera=_carried_camera(seen.camera, T_new_old))
    T = torch.from_numpy(T_new_old)
    if isinstance(seen, PointCloud):
        camera = None if seen.camera is None else _carried_camera(seen.camera, T_new_old)
        points = transform(T.to(seen.points), seen.points)
        return seen.derived(points=points.where(seen.present[..., None], 0.0), camera=camera)
    if not isinstance(seen, TrackedPoints):
        raise ObservationError(
            f"{type(seen).__name__} cannot be given in another frame: fit it alone"
        )
    positions = transform(T.to(seen.positions), seen.positions)
    return seen.derived(positions=positions.where(seen.visible[..., None], 0.0))


def camera_frame_is_recording(seen: Sensor) -> bool:
    """Whether a fixed camera's pose is the identity, as it is where nobody gave one.

    A camera cannot stand so in the world: it would lie on the ground and look straight up.
    """
    if not isinstance(seen, Keypoints2D | PointCloud) or seen.camera is None:
        return False
    poses = seen.camera.T_camera_world
    return bool((poses == torch.eye(4).to(poses)).all())


def _carried_camera(camera: Camera, T_new_old: Float[np.ndarray, "4 4"]) -> Camera:
    poses = camera.T_camera_world
    back = torch.from_numpy(np.linalg.inv(T_new_old)).to(poses)
    return camera.derived(T_camera_world=poses @ back)
