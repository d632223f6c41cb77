"""A made-up walk: hips swing in turn, the pelvis goes ahead; nothing else moves."""

import math

import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import joint_index


def a_walk(body: BodyModel, seconds=1.0, period=1.0, fps=50.0, speed=1.2, pause=0.0) -> Motion:
    """Strikes with the left heel at `pause`, before which and after `seconds` it stands."""
    frames = round((seconds + 2 * pause) * fps) + 1
    time = (torch.arange(frames) / fps - pause).clamp(0, seconds)
    phase = math.tau * time / period
    rotations = torch.eye(3).repeat(frames, 22, 1, 1)
    upright = so3.exp(torch.tensor([math.pi / 2, 0.0, 0.0]))
    rotations[:, 0] = so3.about_z(torch.tensor(math.pi)) @ upright
    for name, sign in (("left_hip", 1.0), ("right_hip", -1.0)):
        flexion = math.radians(10) + sign * math.radians(22) * phase.cos()
        turn = torch.zeros(frames, 3)
        turn[:, 0] = -flexion
        rotations[:, joint_index(name)] = so3.exp(turn)
    rest = body.rest_joints(torch.zeros(body.shape_size))
    height = rest[0, 1] - rest[10, 1] + 0.03
    pelvis = torch.stack((torch.zeros(frames), speed * time, height.expand(frames)), -1)
    return Motion.create(pelvis - rest[0], rotations, torch.zeros(body.shape_size), fps)
