"""What is known of a finished motion, as files hold it: joints, contacts, ground, camera."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.formats.motions import MotionFile


def described(
    motion: Motion,
    body: BodyModel,
    ground: float | None = 0.0,
    T_world_camera: Float[Tensor, "4 4"] | None = None,
    observed: Bool[Tensor, "time 22"] | None = None,
    belt: Float[Tensor, "time 3"] | None = None,
    joint_std: Float[Tensor, "time 22"] | None = None,
    ground_std: Float[Tensor, "2"] | None = None,
    contact_probability: Float[Tensor, "time 22"] | None = None,
    angle_std: Float[Tensor, "time 42"] | None = None,
) -> MotionFile:
    """A motion with its joints, contacts and ground; without a ground no contacts are told.

    Where a camera's pose was found, the file has it and the root in the camera's frame besides.
    On a treadmill, contacts are told against the belt, by how far it has come.

    Args:
        motion: one clip, no batch axis.
        body: whose motion it is.
        ground: height of the ground, metres; None where there is none.
        T_world_camera: of a camera whose pose was found, metres.
        observed: false where a joint was inferred rather than seen.
        belt: how far the treadmill's belt has come at every frame, metres.
        joint_std: standard deviation of a coordinate of every joint, metres.
        ground_std: standard deviations of a ground that was found; see `MotionFile`.
        contact_probability: how likely each joint touches the ground.
        angle_std: standard deviations of joint angles; see `MotionFile`.
    """
    joints = body.pose(motion).joints
    contacts = None
    if ground is not None:
        above = joints - joints.new_tensor([0.0, 0.0, ground])
        if belt is not None:
            above = above - belt[:, None]
        heights = rest_heights(body, motion.shape)
        contacts = contact_labels(above, heights, motion.fps).to(joints)
    return MotionFile(
        motion,
        body=body.name,
        checksum=body.checksum,
        joints=joints,
        contacts=contacts,
        ground=None if ground is None else torch.tensor([0.0, 0.0, 1.0, ground]),
        ground_std=None if ground is None else ground_std,
        contact_probability=None if ground is None else contact_probability,
        joint_std=joint_std,
        angle_std=angle_std,
        observed=observed,
        T_world_camera=None if T_world_camera is None else T_world_camera[None],
        in_camera=None if T_world_camera is None else in_camera(motion, T_world_camera, body),
    )


def in_camera(
    motion: Motion, T_world_camera: Float[Tensor, "4 4"], body: BodyModel
) -> Float[Tensor, "time 6"]:
    """SMPL translation and root rotation vector of the same motion in the camera's frame."""
    pelvis = body.rest_joints(motion.shape)[..., 0, :]
    seen = motion.carried(torch.linalg.inv(T_world_camera), pelvis)
    return torch.cat((seen.translation, so3.log(seen.rotations[:, 0].double()).float()), -1)
