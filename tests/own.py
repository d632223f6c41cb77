"""The plugs of the examples: a fifth sensor and a fourth prior, each in one file."""

import sys
from importlib import import_module
from pathlib import Path

import torch

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import joint_index

sys.path.append(str(Path(__file__).parents[1] / "examples"))
SENSOR, PRIOR = "08_own_sensor:Imus", "09_own_prior:NearPoses"
"""Their places, as `recon.fit` and the command line take them."""
Imus = import_module("08_own_sensor").Imus
NearPoses = import_module("09_own_prior").NearPoses
WORN = ("pelvis", "spine3", "head", "left_elbow", "right_elbow", "left_knee", "right_knee")
BONES = tuple(map(joint_index, WORN))


def turns(motion: Motion, body: BodyModel, noise: float = 0.05) -> torch.Tensor:
    """Orientations that units on `WORN` measure, with noise in radians about each axis."""
    g = torch.Generator().manual_seed(4)
    exact = body.pose(motion).orientations[..., list(BONES), :, :]
    away = noise * torch.randn(exact.shape[:-1], generator=g, dtype=exact.dtype)
    return exact @ so3.exp(away)


def units(motion: Motion, body: BodyModel, noise: float = 0.05):
    """The units' data as a sensor."""
    axes = turns(motion, body, noise).mT.flatten(-3, -2)
    return Imus(axes, torch.ones(axes.shape[:-1], dtype=torch.bool), BONES, motion.fps)
