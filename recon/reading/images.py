"""Makes 2D keypoint files observations: removes lens distortion, keeps confidences."""

import numpy as np
import torch
from jaxtyping import Float

from observations.camera_paths import feet_in_camera, with_path_in_metres
from observations.correspondences import BodyPoints
from observations.keypoints2d import SIGMA, Keypoints2D
from recon.body.model import BodyModel
from recon.core.camera import Camera
from recon.core.errors import ObservationError
from recon.fitting.ground import LEVEL_CAMERA, camera_above
from recon.formats.cameras import CameraArrays, undistorted_pixels
from recon.formats.observations import KeypointsFile


def keypoints_of(
    file: KeypointsFile,
    body: BodyModel,
    T_recording_camera: Float[np.ndarray, "4 4"] | None = None,
    sigma: float = SIGMA,
) -> Keypoints2D:
    """Make an observation of one view's keypoints, with a leading axis of length one.

    If the file does not state the camera's pose, the ground is not known, and
    `T_recording_camera` sets the recording's frame; by default the camera is taken as level.

    Raises:
        ValueError: when the layout is not known or has another number of points.
    """
    points = BodyPoints.of_layout(file.layout, body)
    if len(points.known) != file.pixels.shape[1]:
        raise ObservationError(
            f"layout {file.layout} has {len(points.known)} keypoints, got {file.pixels.shape[1]}"
        )
    camera, path = undistorted_camera(file.camera, T_recording_camera), file.camera.path
    pixels = torch.from_numpy(undistorted_keypoints(file)).float()[None]
    confidence = torch.from_numpy(file.confidence).float()[None] * points.known
    view = Keypoints2D(
        pixels=torch.where(confidence[..., None] > 0, pixels, 0.0),
        confidence=confidence,
        points=points,
        camera=camera[None],
        fps=file.fps,
        start_time=file.start_time,
        sigma=sigma,
        ground_known=file.camera.T_camera_world is not None,
        focal_std=file.camera.focal_std,
        level=path is not None and path.level,
        unit_known=path is None or path.metric,
        lens=() if file.camera.distortion is None else tuple(file.camera.distortion.tolist()),
        fingers=_undistorted_fingers(file),
    )
    return view if view.unit_known else with_path_in_metres(view, feet_in_camera(view, body))


def undistorted_keypoints(file: KeypointsFile) -> Float[np.ndarray, "time points 2"]:
    """Return a view's keypoints without lens distortion, pixels of the same camera matrix.

    Exact zeros stay zero, as they mark missing points that diagnosis looks for.
    """
    if file.camera.distortion is None:
        return file.pixels
    missing = (file.pixels == 0).all(-1, keepdims=True)
    return np.where(missing, 0.0, undistorted_pixels(file.pixels, file.camera))


def _undistorted_fingers(file: KeypointsFile) -> Float[np.ndarray, "1 time 42 3"] | None:
    """Return the hand keypoints without lens distortion; None if the file has none."""
    if file.fingers is None:
        return None
    pixels = undistorted_pixels(file.fingers[..., :2], file.camera)
    fingers = np.concatenate((pixels, file.fingers[..., 2:]), -1)
    return np.where(file.fingers[..., 2:] > 0, fingers, 0.0)[None]


def undistorted_camera(
    arrays: CameraArrays,
    T_recording_camera: Float[np.ndarray, "4 4"] | None = None,
    dtype: torch.dtype = torch.float32,
) -> Camera:
    """Return a camera without its distortion; matrix (1, 3, 3), poses (1 or time, 4, 4)."""
    poses = arrays.T_camera_world
    if poses is None:
        if T_recording_camera is None:
            T_recording_camera = camera_above(LEVEL_CAMERA)
        poses = np.linalg.inv(T_recording_camera)[None]
        if (path := arrays.path) is not None:
            # move a tracked path to begin at the given pose; a level path is not rotated
            first = path.T_world_camera[0]
            T = T_recording_camera @ np.linalg.inv(first)
            if path.level:
                T = np.eye(4)
                T[:3, 3] = T_recording_camera[:3, 3] - first[:3, 3]
            poses = np.linalg.inv(T @ path.T_world_camera)
    return Camera.create(
        torch.from_numpy(np.asarray(arrays.camera_matrix)).to(dtype)[None],
        arrays.image_size,
        None,
        torch.from_numpy(np.asarray(poses)).to(dtype),
    )
