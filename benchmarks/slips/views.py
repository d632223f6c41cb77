"""Mistakes that concern cameras: poses, clocks and mirrored images."""

import math

import torch
from jaxtyping import Float
from torch import Generator, Tensor

from benchmarks.slips.points import edited, values_of, weights_of
from observations.keypoints2d import Keypoints2D
from recon.core import rotations as so3
from recon.core.camera import Camera
from recon.method.sensor import Sensor as Seen


def mirrored(view: Seen) -> Seen:
    """Left and right of the image are exchanged, as front cameras of phones write it."""
    assert isinstance(view, Keypoints2D)
    pixels = view.pixels * view.pixels.new_tensor([-1.0, 1.0])
    width = float(view.camera.image_size[0])
    return edited(view, pixels + pixels.new_tensor([width, 0.0]))


def delayed(view: Seen, frames: int) -> Seen:
    """Every moment shows what happened some frames before; the first moments show nothing."""
    values, weights = values_of(view).roll(frames, 1), weights_of(view).roll(frames, 1)
    weights[:, :frames] = 0
    return edited(view, values, weights)


def misplaced(view: Seen, degrees: float, seed: int) -> Seen:
    """The calibration has the camera turned about itself by an angle, about a random axis."""
    assert isinstance(view, Keypoints2D)
    turn = turned(torch.tensor([degrees]), seed).to(view.pixels)
    return view.replace(camera=_after(view.camera, turn))


def drifting(camera: Camera, frames: int, degrees: float, seed: int) -> Camera:
    """A fixed camera whose tripod gives way: it turns evenly by an angle in so many frames."""
    return _after(camera, turned(torch.linspace(0, degrees, frames), seed))


def turned(degrees: Float[Tensor, " poses"], seed: int) -> Float[Tensor, "poses 4 4"]:
    """Rotations by angles about one random axis."""
    axis = torch.randn(3, generator=Generator().manual_seed(seed))
    axis = axis / axis.norm()
    turns = torch.eye(4).repeat(len(degrees), 1, 1)
    turns[:, :3, :3] = so3.exp(degrees[:, None] * (math.pi / 180) * axis)
    return turns


def spread_out(view: Seen, factor: float) -> Seen:
    """The calibration has the camera so many times as far from the origin."""
    assert isinstance(view, Keypoints2D)
    pose = view.camera.T_camera_world.clone()
    pose[..., :3, 3] *= factor
    return view.replace(camera=view.camera.replace(T_camera_world=pose))


def _after(camera: Camera, turn: Tensor) -> Camera:
    return camera.replace(T_camera_world=turn @ camera.T_camera_world)
