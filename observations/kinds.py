"""What kinds of sensors a clip has: points with names, images, clouds."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeGuard

import numpy as np
import torch
from jaxtyping import Float

from recon.method.protocols import Sensor

if TYPE_CHECKING:
    from observations.depth import PointCloud
    from observations.joints3d import Joints3D
    from observations.keypoints2d import Keypoints2D
    from observations.keypoints3d import Keypoints3D
    from observations.markers3d import Markers3D

    Tracked = Joints3D | Markers3D | Keypoints3D
    InSpace = Tracked | PointCloud
else:
    # a clip loads the code of those sensors alone that it has
    Tracked = InSpace = Keypoints2D = Markers3D = PointCloud = Sensor


def _seeing(observations: Sequence[Sensor], *what: str) -> list:
    """Those that see one of these; a sensor of somebody's own need not say what it sees."""
    return [one for one in observations if getattr(one, "sees", None) in what]


def tracked(observations: Sequence[Sensor]) -> list[Tracked]:
    """Joints, markers and keypoints: points in space with names."""
    return _seeing(observations, "points")


def markers(observations: Sequence[Sensor]) -> list[Markers3D]:
    """Markers on the skin."""
    return [one for one in _seeing(observations, "points") if one.on_skin]


def in_space(observations: Sequence[Sensor]) -> list[InSpace]:
    """Joints, markers, keypoints and clouds, in the order given."""
    return [one for one in observations if is_in_space(one)]


def is_in_space(one: Sensor) -> TypeGuard[InSpace]:
    """Whether a sensor gives places in space, metres."""
    return len(_seeing([one], "points", "surface")) > 0


def views(observations: Sequence[Sensor]) -> list[Keypoints2D]:
    """Keypoints in images."""
    return _seeing(observations, "image")


def with_camera(observations: Sequence[Sensor]) -> list[Keypoints2D | PointCloud]:
    """Keypoints in images, then points of surfaces, which may have a camera."""
    return [*views(observations), *clouds(observations)]


def clouds(observations: Sequence[Sensor]) -> list[PointCloud]:
    """Points without names."""
    return _seeing(observations, "surface")


def camera_frame_is_recording(seen: Sensor) -> bool:
    """Whether a fixed camera's pose is the identity, as it is where nobody gave one.

    A camera cannot stand so in the world: it would lie on the ground and look straight up.
    """
    for one in with_camera([seen]):
        if one.camera is not None:
            poses = one.camera.T_camera_world
            return bool((poses == torch.eye(4).to(poses)).all())
    return False


def unposed_camera(seen: Sequence[Sensor]) -> Float[np.ndarray, "4 4"] | None:
    """First pose of the first camera that does not know the ground, T_recording_camera."""
    for one in with_camera(seen):
        if one.camera is not None and not one.ground_known:
            return one.camera.T_world_camera[0, 0].double().cpu().numpy()
    return None
