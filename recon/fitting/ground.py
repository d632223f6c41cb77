"""First guesses of an unknown ground, from standing people or from the camera's height.

`recon.fitting.clip` decides whether the ground is unknown at all, and optimises the guess beside
the motion (`recon.core.scene.UnknownGround`).
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.body.soles import sole_heights
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.scene import TILT, UnknownGround
from recon.core.skeleton import joint_index

_HEAD = joint_index("head")
_ANKLES = [joint_index("left_ankle"), joint_index("right_ankle")]

LEVEL_CAMERA = (0.0, -1.0, 0.0, -1.2)
"""The ground that a camera of unknown pose is first taken to see: level, 1.2 m below it."""
_FACING = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
"""A body that would look where the camera looks; its right is the image's."""


def ground_by_posture(motion: Motion, body: BodyModel) -> UnknownGround:
    """First guess of an unknown ground, one per clip, in a recording with an unknown up axis.

    Up is where heads are from between the ankles, on average over the frames: steps forward and
    back, and leaning to either side, cancel. The ground is as high as the soles that stand.
    """
    up = mean_up(motion, body)
    pivot = point_below_pelvis(motion, body)
    # R = Exp(v) rotates `up` onto z; v has the direction of up × z and the length of the angle
    sine = up[..., :2].norm(dim=-1, keepdim=True)
    angle = torch.atan2(sine, up[..., 2:])
    axis = torch.stack((up[..., 1], -up[..., 0]), -1) / sine.clamp(min=1e-9)
    ground = UnknownGround.create(pivot).replace(tilt=axis * angle / TILT)
    level = motion.carried(ground.T_world_recording, body.rest_joints(motion.shape)[..., 0, :])
    return ground.replace(lift=-sole_heights(level, body))


def ground_by_feet(motion: Motion, body: BodyModel) -> UnknownGround:
    """First guess of the ground in a recording whose z axis is up; only its height is unknown."""
    ground = UnknownGround.create(point_below_pelvis(motion, body))
    return ground.replace(lift=-sole_heights(motion, body))


def mean_up(motion: Motion, body: BodyModel) -> Float[Tensor, "clips 3"]:
    """Mean direction from the middle of the ankles to the head, a unit vector."""
    joints = body.pose(motion).joints
    rise = joints[..., _HEAD, :] - joints[..., _ANKLES, :].mean(-2)
    rise = rise.where(motion.valid[..., None], 0.0)
    return torch.nn.functional.normalize(rise.sum(-2), dim=-1)


def point_below_pelvis(motion: Motion, body: BodyModel) -> Float[Tensor, "clips 3"]:
    """The point of the recording's z = 0 below the mean place of the pelvis, metres."""
    pelvis = body.pose(motion).joints[..., 0, :].where(motion.valid[..., None], 0.0)
    mean = pelvis.sum(-2) / motion.valid.sum(-1, keepdim=True)
    return mean * mean.new_tensor([1.0, 1.0, 0.0])


def camera_above(ground: tuple[float, float, float, float]) -> Float[np.ndarray, "4 4"]:
    """T_recording_camera of a camera that sees the ground n·x = d; it stands above the origin.

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
    """T_world_frame of a frame in which the ground is n·x = d; z = 0 of the world is the ground.

    The frame's origin comes to lie over the world's, and the plane z = 0 changes nothing.

    Raises:
        ValueError: when the normal is zero.
    """
    from recon.core.camera import Ground, world_from_camera  # needed only if a plane is given

    plane = Ground.create(torch.tensor(ground[:3]), torch.tensor(ground[3]))
    return world_from_camera(plane, torch.tensor(_FACING), torch.zeros(3)).double().numpy()
