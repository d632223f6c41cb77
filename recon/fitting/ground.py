"""First guesses of an unknown ground, from standing people or from the camera's height.

`recon.fitting.clip` decides whether the ground is unknown at all, and optimises the guess together
with the motion (`recon.core.scene.UnknownGround`).
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.body.soles import ground_heights
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.scene import TILT, UnknownGround
from recon.core.skeleton import joint_index

_HEAD = joint_index("head")
_ANKLES = [joint_index("left_ankle"), joint_index("right_ankle")]

LEVEL_CAMERA = (0.0, -1.0, 0.0, -1.2)
"""First guess (n, d) of the ground n·x = d below a camera of unknown pose: level, 1.2 m below
it."""
_FACING = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
"""Rotation of a body that looks where the camera looks; its right is the image's right."""


def ground_by_posture(motion: Motion, body: BodyModel) -> UnknownGround:
    """Guess the unknown ground of each clip of a recording whose up axis is unknown.

    Up is the direction from between the ankles to the head, averaged over the frames: steps
    forward and back, and leaning to either side, cancel. The ground is at the height of the
    standing soles.
    """
    up = mean_up(motion, body)
    pivot = point_below_pelvis(motion, body)
    # R = Exp(v) rotates `up` onto z; v has the direction of up × z and the length of the angle
    sine = up[..., :2].norm(dim=-1, keepdim=True)
    angle = torch.atan2(sine, up[..., 2:])
    axis = torch.stack((up[..., 1], -up[..., 0]), -1) / sine.clamp(min=1e-9)
    ground = UnknownGround.create(pivot).replace(tilt=axis * angle / TILT)
    level = motion.carried(ground.T_world_recording, body.rest_joints(motion.shape)[..., 0, :])
    return ground.replace(lift=-ground_heights(level, body))


def ground_by_feet(motion: Motion, body: BodyModel) -> UnknownGround:
    """Guess the height of the ground in a recording whose z axis is known to be up."""
    ground = UnknownGround.create(point_below_pelvis(motion, body))
    return ground.replace(lift=-ground_heights(motion, body))


def mean_up(motion: Motion, body: BodyModel) -> Float[Tensor, "clips 3"]:
    """Return the mean direction from the middle of the ankles to the head, a unit vector."""
    joints = body.pose(motion).joints
    rise = joints[..., _HEAD, :] - joints[..., _ANKLES, :].mean(-2)
    rise = rise.where(motion.valid[..., None], 0.0)
    return torch.nn.functional.normalize(rise.sum(-2), dim=-1)


def point_below_pelvis(motion: Motion, body: BodyModel) -> Float[Tensor, "clips 3"]:
    """Return the point of the recording's z = 0 below the pelvis' mean position (m)."""
    pelvis = body.pose(motion).joints[..., 0, :].where(motion.valid[..., None], 0.0)
    mean = pelvis.sum(-2) / motion.valid.sum(-1, keepdim=True)
    return mean * mean.new_tensor([1.0, 1.0, 0.0])


def camera_above(ground: tuple[float, float, float, float]) -> Float[np.ndarray, "4 4"]:
    """Return T_recording_camera of a camera above the origin, from its ground plane n·x = d.

    Raises:
        ValueError: when the normal is zero, or the camera is below the ground.
    """
    if not ground[3] < 0:
        raise ObservationError(
            f"the ground {ground} is not below the camera: expected (nx, ny, nz, d) with the "
            "normal up and d < 0, such as (0, -1, 0, -1.2) for a level camera 1.2 m above it"
        )
    return world_above(ground)


def world_above(ground: tuple[float, float, float, float]) -> Float[np.ndarray, "4 4"]:
    """Return T_world_frame of a frame with the ground n·x = d, which is z = 0 in the world.

    The frame's origin comes to lie above the world's; the plane z = 0 gives the identity.

    Raises:
        ValueError: when the normal is zero.
    """
    from recon.core.camera import Ground, world_from_camera  # imported only when a plane is given

    plane = Ground.create(torch.tensor(ground[:3]), torch.tensor(ground[3]))
    return world_from_camera(plane, torch.tensor(_FACING), torch.zeros(3)).double().numpy()
