"""A first guess for data that do not tell where the body is."""

from collections.abc import Sequence

import torch

from observations.start.images import UPRIGHT
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion


def standing(
    body: BodyModel, clips: Sequence[int], moments: int, *, fps: float, start_time: float
) -> Motion:
    """The average body in its rest pose, upright, over the origin; its soles stand at z = 0.

    It faces the negative y axis of the world, as the rest pose that is turned upright does.
    """
    rest = body.joint_template
    turn = so3.exp(rest.new_tensor(UPRIGHT))
    placed = (body.template - rest[0]) @ turn.T
    place = rest.new_zeros(3)
    place[2] = -placed[:, 2].min()
    rotations = torch.eye(3).to(rest).repeat(*clips, moments, len(rest), 1, 1)
    rotations[..., 0, :, :] = turn
    return Motion.create(
        (place - rest[0]).expand(*clips, moments, 3).clone(), rotations,
        rest.new_zeros(*clips, body.shape_size), fps, start_time=start_time,
    )  # fmt: skip
