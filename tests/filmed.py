"""A walk in front of cameras: what the tests of image observations share."""

import functools
from importlib import resources
from typing import Any

import torch

import recon
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import Camera, full_hd_camera
from recon.core.motion import Motion
from recon.formats.motions import load_motion
from recon.reading.images import keypoints_of
from recon.simulation.images import camera_ring, keypoints2d
from recon.simulation.points import Corruption

NOISE = 3.0
"""Pixels."""
BESIDE = (-1.5, 1.5)
"""The distances of the two people from the camera's axis, in metres; negative is to the left."""


@functools.cache
def bundled() -> BodyModel:
    """The bundled body in single precision, as fits use it."""
    return BodyModel.load()


@functools.cache
def walk(frames: int = 24, first: int = 0) -> Motion:
    """The beginning of the demo: half a second and more of walking, at 30 Hz."""
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        return load_motion(path).motion.window(first, first + frames)


def turned(motion: Motion, angle: float) -> Motion:
    """The motion turned about the vertical axis of the world, radians."""
    T = torch.eye(4)
    T[:3, :3] = so3.about_z(torch.tensor(angle))
    return motion.carried(T, bundled().rest_joints(motion.shape)[0])


def cameras(motion: Motion, count: int = 1, first: float = 0.0) -> tuple[Camera, ...]:
    """Full HD cameras evenly around the walk."""
    return camera_ring(motion, bundled(), full_hd_camera(), count, first=first)


def view(
    motion: Motion, camera: Camera, noise: float = NOISE, seed: int = 0, layout: str = "openpose25"
) -> Keypoints2D:
    """What a detector finds of it."""
    file = keypoints2d(motion, bundled(), camera, Corruption(noise=noise), seed, layout)
    return keypoints_of(file, bundled())


def seen_of(motion: Motion, kind: str) -> Any:
    """What sensors of a kind see of it: `joints3d`, `hidden` (without legs), `views`, ..."""
    if kind == "views":
        return [view(motion, one) for one in cameras(motion, 3)]
    if kind == "hidden":
        return recon.simulate(motion, "joints3d", noise=0.01, hide_below=0.9)
    if kind == "depth":
        return recon.simulate(motion, "depth", noise=0.005, points=512)
    return recon.simulate(motion, kind, noise=0.02)  # pyright: ignore[reportArgumentType]


def two_people(frames: int) -> list[Motion]:
    """Two walkers side by side, of whom one goes the other way; at 30 Hz."""
    one, two = walk(frames), turned(walk(frames, 10), 3.0)
    out = []
    for motion, x in zip((one, two), BESIDE, strict=True):
        pelvis = bundled().pose(motion).joints[:, 0].mean(0)
        shift = torch.tensor([x - float(pelvis[0]), 5.0 - float(pelvis[1]), 0.0])
        out.append(motion.replace(translation=motion.translation + shift))
    return out


def before_two() -> Camera:
    """A camera that has both of them in its images."""
    return full_hd_camera().placed(torch.tensor([0.0, 0.0, 1.5]), torch.tensor([0.0, 5.0, 1.0]))


def joint_error(found: Motion, truth: Motion) -> float:
    """Mean distance of joints in the world, metres."""
    body = bundled()
    return float((body.pose(found).joints - body.pose(truth).joints).norm(dim=-1).mean())
