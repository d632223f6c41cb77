"""Reads points, clouds and cameras of observation files at the frames of a motion."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.correspondences import BodyPoints
from recon.body.model import BodyModel
from recon.core.camera import Camera, transform
from recon.core.motion import Motion, MotionFile
from recon.formats.observations import (
    KeypointsFile,
    PointsFile,
    PositionsFile,
    load_observation,
)
from recon.method.protocols import Estimate
from recon.reading.points import positions_of
from recon.view.scene import Points, View, nearest_samples

Cloud = tuple[Float[Tensor, "_ 3"], ...]


def read_observed(
    paths: Sequence[Path], file: MotionFile, body: BodyModel
) -> tuple[Points | None, Cloud | None, tuple[View, ...]]:
    """Read points, a scan and cameras of observation files, at the frames of a motion.

    Cameras of unknown pose take that of the motion file.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when one is damaged, of unknown keypoints, or its camera has no pose and the
            motion file has none either.
    """
    points: list[tuple[Tensor, Tensor, Tensor]] = []
    clouds: list[Cloud] = []
    cameras: list[View] = []
    stems = [path.stem for path in paths]
    for path in paths:
        seen = load_observation(path)
        if isinstance(seen, PositionsFile):
            points.append(_points_at_frames(seen, path, file.motion, body))
            continue
        name = path.stem if stems.count(path.stem) == 1 else f"{path.parent.name}/{path.stem}"
        if isinstance(seen, KeypointsFile):
            camera = _camera_at_frames(seen, path, file)
            cameras.append(_view_of_keypoints(seen, camera, path, name, file, body))
            continue
        camera = None if seen.camera is None else _camera_at_frames(seen, path, file)
        clouds.append(_cloud_at_frames(seen, camera, file.motion))
        if camera is not None:
            cameras.append(View(name, camera))
    merged = tuple(torch.cat(parts) for parts in zip(*clouds, strict=True))
    together = None
    if points:
        places, visible, predicted = (torch.cat(part, 1) for part in zip(*points, strict=True))
        together = Points(places, visible, predicted)
    return together, merged or None, tuple(cameras)


def _points_at_frames(
    seen: PositionsFile, path: Path, motion: Motion, body: BodyModel
) -> tuple[Tensor, Tensor, Tensor]:
    """Return observed positions of points in every frame, a mask, and positions on the body."""
    observation = positions_of(seen, path, body)
    at = _sample_times(observation.positions.shape[1], observation.start_time, observation.fps)
    nearest, close = nearest_samples(motion.times, at)
    visible = observation.visible[0, nearest] & close[:, None]
    predicted = observation.predicted(Estimate.of_clip(motion, body))[0]
    return observation.positions[0, nearest], visible, predicted


def _view_of_keypoints(
    seen: KeypointsFile, camera: Camera, path: Path, name: str, file: MotionFile, body: BodyModel
) -> View:
    nearest, close = nearest_samples(
        file.motion.times, _sample_times(len(seen.pixels), seen.start_time, seen.fps)
    )
    try:
        places = BodyPoints.of_layout(seen.layout, body)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    known = places.known
    if seen.pixels.shape[1] != len(known):
        raise ValueError(
            f"{path}: layout {seen.layout} has {len(known)} points, the file "
            f"{seen.pixels.shape[1]}"
        )
    confidence = torch.from_numpy(seen.confidence).float()[nearest] * close[:, None]
    pixels = torch.from_numpy(seen.pixels).float()[nearest]
    projection = camera.project(places.of(body.pose(file.motion))[:, known])
    clocks = {one.name: one.start_time for one in file.cameras}
    start = clocks.get(path.stem, seen.start_time)
    return View(name, camera, pixels[:, known], confidence[:, known], projection, start)


def _cloud_at_frames(seen: PointsFile, camera: Camera | None, motion: Motion) -> Cloud:
    """Return the points of every frame in the world; none in frames without a sample."""
    frames = int(seen.frame.max()) + 1
    nearest, close = nearest_samples(
        motion.times, _sample_times(frames, seen.start_time, seen.fps)
    )
    order = np.argsort(seen.frame, kind="stable")
    parts = np.split(seen.points[order], np.searchsorted(seen.frame[order], np.arange(1, frames)))
    clouds = [
        torch.from_numpy(parts[k]).float() if near else torch.zeros(0, 3)
        for k, near in zip(nearest.tolist(), close.tolist(), strict=True)
    ]
    if camera is None or seen.camera is None or seen.camera.T_camera_world is not None:
        return tuple(clouds)
    poses = camera.T_world_camera.expand(len(clouds), 4, 4)
    return tuple(transform(T, cloud) for T, cloud in zip(poses, clouds, strict=True))


def _camera_at_frames(seen: KeypointsFile | PointsFile, path: Path, file: MotionFile) -> Camera:
    """Make the camera at the motion's frames; a moving one has the pose nearest in time."""
    arrays = seen.camera
    assert arrays is not None
    lens = None if arrays.distortion is None else torch.from_numpy(arrays.distortion).float()
    try:
        matrix = torch.from_numpy(arrays.camera_matrix).float()
        camera = Camera.create(matrix, arrays.image_size, lens)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if arrays.T_camera_world is None:
        known = camera.replace(T_camera_world=_known_poses(file, path))
        poses = known.T_world_camera  # read once: each access inverts the poses
    else:
        poses = torch.from_numpy(arrays.T_camera_world).float()
        if len(poses) > 1:
            at = _sample_times(len(poses), seen.start_time, seen.fps)
            poses = poses[nearest_samples(file.motion.times, at)[0]]
    return camera.replace(T_camera_world=poses[0] if len(poses) == 1 else poses)


def _known_poses(file: MotionFile, path: Path) -> Float[Tensor, "poses 4 4"]:
    """Return the camera poses that the motion file has, one or one per frame, after a check."""
    if file.T_world_camera is None:
        raise ValueError(
            f"{path}: the camera has no pose and the motion file has none (T_world_camera) "
            "either; fit the motion to this file, or add T_camera_world to it"
        )
    if len(file.T_world_camera) not in (1, file.motion.frames):
        raise ValueError(
            f"the motion file has {len(file.T_world_camera)} poses in T_world_camera; expected "
            f"1 or {file.motion.frames}"
        )
    return file.T_world_camera.float()


def _sample_times(count: int, start_time: float, fps: float) -> Float[Tensor, " count"]:
    """Return the times of `count` samples, seconds."""
    return start_time + torch.arange(count, dtype=torch.float64) / fps
