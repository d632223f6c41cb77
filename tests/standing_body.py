"""Bodies that stand, hover, slide and jump, for tests of physics."""

import torch
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion


def standing(body: BodyModel, path: Tensor, fps: float = 20.0) -> Motion:
    """The average body, upright in its rest pose; its soles follow a path (time 3)."""
    quarter = torch.tensor([torch.pi / 2, 0.0, 0.0], dtype=torch.float64)
    rotations = torch.eye(3, dtype=torch.float64).repeat(len(path), 22, 1, 1)
    rotations[:, 0] = so3.exp(quarter)
    shape = torch.zeros(body.shape_size, dtype=torch.float64)
    motion = Motion.create(torch.zeros(len(path), 3, dtype=torch.float64), rotations, shape, fps)
    sole = body.pose(motion.window(0, 1)).vertices[0, :, 2].amin()
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return motion.replace(translation=path - sole * up)


def times(seconds: float, fps: float = 20.0) -> Tensor:
    """Moments of a clip, seconds."""
    return torch.arange(int(seconds * fps + 1e-6) + 1, dtype=torch.float64) / fps


def path(x: Tensor | float = 0.0, z: Tensor | float = 0.0, *, like: Tensor) -> Tensor:
    """Places (time 3) along x and z at the times given."""
    zero = torch.zeros_like(like)
    return torch.stack((zero + x, zero, zero + z), -1)
