"""Simulated cameras: those of a preset, placed around the body, or those of a calibration."""

import math
from pathlib import Path

import torch

from recon.body.model import BodyModel
from recon.core.camera import Camera, full_hd_camera
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.formats.calibration.cameras import load_cameras
from recon.formats.observations import CameraArrays
from recon.simulation.images import dome, orbiting
from recon.simulation.settings import FilmSettings

_PRESETS = {"front": 0.0, "side": math.tau / 4}
"""Angle of a preset's first camera from where the body faces, radians."""


def cameras_around(
    truth: Motion, body: BodyModel, film: FilmSettings, lens: Camera | None = None
) -> dict[str, Camera]:
    """The cameras of a preset or of a calibration, by name.

    Args:
        truth: one clip (no batch axis).
        body: whose motion it is.
        film: which cameras; one from a calibration without a pose is placed in front.
        lens: of a preset's cameras; default: full HD.

    Raises:
        FileNotFoundError: when there is no such calibration.
        ValueError: when it is damaged or does not say where its cameras are, or cameras that move
            already are to be carried around.
    """
    if film.views < 1:
        raise ReconError(f"views: expected one camera or more, got {film.views}")
    lens = full_hd_camera() if lens is None else lens
    if film.camera in _PRESETS:
        first = mean_heading(truth) + _PRESETS[film.camera]
        placed = dome(truth, body, lens.to(dtype=truth.translation.dtype), film.views, first=first)
        cameras = {f"cam{k}": camera for k, camera in enumerate(placed, 1)}
    else:
        cameras = _calibrated(Path(film.camera), truth, body, film.views)
    if film.orbit == 0:
        return cameras
    if any(camera.T_camera_world.ndim == 3 for camera in cameras.values()):
        raise ReconError(f"{film.camera}: its cameras move already; leave orbit out")
    middle = body.pose(truth).joints.flatten(0, -2).mean(0)
    return {n: orbiting(c, middle, truth.frames, film.orbit) for n, c in cameras.items()}


def _calibrated(path: Path, truth: Motion, body: BodyModel, views: int) -> dict[str, Camera]:
    if not path.exists():
        raise FileNotFoundError(
            f"{path}: no such calibration; expected a file, or one of {', '.join(_PRESETS)}"
        )
    found = load_cameras(path).cameras
    if views != 1:
        raise ReconError(f"{path} says which cameras there are ({len(found)}); leave views out")
    cameras = {}
    for name, arrays in found.items():
        camera = _camera(arrays, truth)
        if arrays.T_camera_world is None:
            if len(found) > 1:
                raise ReconError(f"{path}: camera {name} has no pose, so it cannot be placed")
            camera = dome(truth, body, camera, 1, first=mean_heading(truth))[0]
        elif camera.T_camera_world.ndim == 3 and len(camera.T_camera_world) < truth.frames:
            raise ReconError(
                f"{path}: camera {name} has {len(camera.T_camera_world)} poses, the motion "
                f"{truth.frames} frames"
            )
        elif camera.T_camera_world.ndim == 3:
            poses = camera.T_camera_world[: truth.frames]
            camera = camera.replace(T_camera_world=poses)
        cameras[name] = camera
    return cameras


def _camera(arrays: CameraArrays, truth: Motion) -> Camera:
    """A camera as tensors; one pose has no time axis."""
    poses = arrays.T_camera_world
    if poses is not None and len(poses) == 1:
        poses = poses[0]
    return Camera.create(
        torch.from_numpy(arrays.camera_matrix),
        arrays.image_size,
        None if arrays.distortion is None else torch.from_numpy(arrays.distortion),
        None if poses is None else torch.from_numpy(poses),
    ).to(dtype=truth.translation.dtype)


def mean_heading(truth: Motion) -> float:
    """The mean heading of the body, radians from the world's x axis."""
    x, y, _ = truth.rotations[:, 0, :, 2].mean(0).tolist()
    return math.atan2(y, x)
