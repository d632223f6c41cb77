"""Two tracks of two calibrated views as points in the world: are they one person?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from observations.people.places import body_size
from observations.people.tracks import Track
from recon.core.errors import ObservationError
from recon.core.layouts import keypoint_names
from recon.formats.observations import CameraArrays

_CONFIDENT = 0.3
_FRAMES = 25
"""Frames looked at for a pair of tracks."""
_FEWEST_POINTS = 20


@dataclass(frozen=True)
class TrackedView:
    """What one camera saw, followed."""

    name: str
    layout: str
    camera: CameraArrays
    tracks: tuple[Track, ...]
    first_frame: int = 0
    """Frame number of the first pose of a moving camera."""


@dataclass(frozen=True)
class TrackPair:
    """Keypoints of two tracks, triangulated."""

    error: float
    """Median reprojection error of the worse view in body sizes; infinite when fewer than
    20 keypoints are seen in both, or they meet behind a camera."""
    points: Float[np.ndarray, "frames points 3"]
    """World frame, metres; zero where not seen."""
    seen: Bool[np.ndarray, "frames points"]
    """Which points both views saw."""
    names: tuple[str, ...]


def triangulated(one: TrackedView, a: int, two: TrackedView, b: int) -> TrackPair:
    """Keypoints of track a of a view and track b of another as points nearest to both rays.

    Each ray (u, v) of a camera P = [R | t] gives two equations, u P3 - P1 and v P3 - P2; the
    point is the right singular vector of least singular value (Hartley and Zisserman, 12.2).
    """
    names = tuple(n for n in keypoint_names(one.layout) if n in keypoint_names(two.layout))
    frames = np.intersect1d(one.tracks[a].frame, two.tracks[b].frame)
    frames = frames[:: max(1, -(-len(frames) // _FRAMES))]
    sights = [_sight(view, k, frames, names) for view, k in ((one, a), (two, b))]
    both = sights[0].seen & sights[1].seen
    if both.sum() < _FEWEST_POINTS:
        nothing = np.zeros((*both.shape, 3))
        return TrackPair(float("inf"), nothing, np.zeros_like(both), names)
    points = _meeting([sight.rays for sight in sights], [sight.pose for sight in sights])
    points = np.where(both[..., None], points, 0.0)
    errors = np.maximum(*(_miss(points, sight) for sight in sights))
    return TrackPair(float(np.median(errors[both])), points, both, names)


def joint_errors(views: Sequence[TrackedView], numbers: Sequence[int]) -> list[float]:
    """Median reprojection error, in body sizes, by view of points triangulated from all views.

    Zeros when fewer than 20 keypoints are seen by all.
    """
    names = keypoint_names(views[0].layout)
    frames = views[0].tracks[numbers[0]].frame
    for view, number in zip(views, numbers, strict=True):
        names = tuple(name for name in names if name in keypoint_names(view.layout))
        frames = np.intersect1d(frames, view.tracks[number].frame)
    frames = frames[:: max(1, -(-len(frames) // _FRAMES))]
    sights = [_sight(v, number, frames, names) for v, number in zip(views, numbers, strict=True)]
    seen = np.all([sight.seen for sight in sights], axis=0)
    if seen.sum() < _FEWEST_POINTS:
        return [0.0] * len(views)
    points = _meeting([sight.rays for sight in sights], [sight.pose for sight in sights])
    return [float(np.median(_miss(points, sight)[seen])) for sight in sights]


@dataclass(frozen=True)
class _Sight:
    """A track in some frames, as rays."""

    rays: np.ndarray
    """(frames, keypoints, 2): x/z and y/z of undistorted pixels."""
    seen: np.ndarray
    scale: np.ndarray
    """(frames,) body sizes per unit of the rays."""
    pose: np.ndarray
    """(frames, 4, 4) world to camera."""


def _sight(view: TrackedView, number: int, frames: np.ndarray, names: tuple[str, ...]) -> _Sight:
    track = view.tracks[number]
    at = np.searchsorted(track.frame, frames)
    pixels, confidence = track.pixels[at], track.confidence[at]
    known = keypoint_names(view.layout)
    columns = [known.index(name) for name in names]
    size = np.array([body_size(*pair) for pair in zip(pixels, confidence, strict=True)])
    focal = np.sqrt(np.linalg.det(view.camera.camera_matrix))
    return _Sight(
        rays=_rays(view.camera, pixels[:, columns]),
        seen=(confidence[:, columns] >= _CONFIDENT),
        scale=focal / size,
        pose=_poses(view, frames),
    )


def _meeting(rays: list[np.ndarray], poses: list[np.ndarray]) -> np.ndarray:
    equations = [
        ray[..., None] * T[:, None, None, 2] - T[:, None, :2]
        for ray, T in zip(rays, poses, strict=True)
    ]
    point = np.linalg.svd(np.concatenate(equations, -2))[2][..., -1, :]
    scale = point[..., 3:]
    return point[..., :3] / np.where(np.abs(scale) > 1e-9, scale, 1e-9)


def _miss(points: np.ndarray, sight: _Sight) -> np.ndarray:
    """Distance of points from the rays in body sizes; infinite behind the camera."""
    local = np.einsum("tij,tkj->tki", sight.pose[:, :3, :3], points) + sight.pose[:, None, :3, 3]
    front = local[..., 2] > 1e-6
    again = local[..., :2] / np.where(front, local[..., 2], 1.0)[..., None]
    miss = np.linalg.norm(again - sight.rays, axis=-1) * sight.scale[:, None]
    return np.where(front, miss, np.inf)


def _rays(camera: CameraArrays, pixels: np.ndarray) -> np.ndarray:
    """x/z and y/z of undistorted pixels, by OpenCV."""
    import cv2

    flat = pixels.reshape(-1, 1, 2).astype(np.float64)
    if len(flat) == 0:
        return pixels
    out = cv2.undistortPoints(flat, camera.camera_matrix, camera.distortion)
    return np.asarray(out).reshape(pixels.shape)


def _poses(view: TrackedView, frames: np.ndarray) -> np.ndarray:
    """World to camera by frame number."""
    pose = view.camera.T_camera_world
    if pose is None:
        raise ObservationError(f"{view.name}: expected a camera with a pose")
    return pose[frames - view.first_frame] if len(pose) > 1 else pose.repeat(len(frames), 0)
