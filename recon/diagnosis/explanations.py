"""Corrects one camera of several under each hypothesis of its error; measures the error left."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from recon.diagnosis.images import Images
from recon.diagnosis.rays import Rays, in_camera, projected

Cause = Literal["turned", "placed", "mirrored", "sized", "moving"]

_MAX_SAME_SIZE = 1.1
"""Ratio of image sizes up to which they count as equal; a rotation can look like as much."""
_SMOOTHING_S = 0.15
"""Time (s) before and after each frame over which a moving camera's rotation is averaged."""
_MIN_DEPTH_SHARE = 0.05
"""Smallest z component of a ray's unit vector in the camera's frame that is used."""
_ROUNDS = 8
_MIN_POINTS, _MIN_SAMPLES = 4, 12
"""Least number of points to estimate a camera's rotation in one frame, and its pose over all."""
_MAX_INLIER = 0.02
"""Distance in the plane z = 1 within which a keypoint agrees with an estimated camera pose."""


@dataclass(frozen=True)
class ExplainedView:
    """One view as corrected under one hypothesis, and the error that remains."""

    cause: Cause
    images: Images
    """All views, the doubted one corrected."""
    value: float
    """Size of the correction: degrees, a factor, or metres for another position, by `cause`."""
    remains: float
    """Median distance (m) of the view's rays from the points that the other views triangulate."""


@dataclass(frozen=True)
class DoubtedView:
    """A view that may be wrong, with the points that all other views triangulate."""

    images: Images
    view: int
    points: Float[np.ndarray, "moments points 3"]
    """Points (m, recording's frame) triangulated from the other views."""
    exists: Bool[np.ndarray, "moments points"]

    @classmethod
    def of(cls, images: Images, view: int) -> "DoubtedView":
        """Triangulate points from all other views, for comparison with one view."""
        rest = [v for v in range(len(images.names)) if v != view]
        return cls(images, view, *Rays.of(images.view(rest)).triangulated())

    def ray_distances(self, images: Images | None = None) -> Float[np.ndarray, "moments points"]:
        """Return distances (m) of the view's rays from points of other views; NaN if unknown."""
        one = Rays.of((self.images if images is None else images).view([self.view]))
        there = self.exists & (one.weight[0] > 0)
        return np.where(there, one.distances_from(self.points)[0], np.nan)

    def median_ray_distance(self, images: Images | None = None) -> float:
        """Return the median distance (m) of the view's rays from the points of other views."""
        away = self.ray_distances(images)
        return float(np.nanmedian(away)) if np.isfinite(away).any() else 0.0

    def corrected_by_cause(self, causes: tuple[Cause, ...]) -> list[ExplainedView]:
        """Correct the view under each hypothesis; also measure the remaining errors."""
        corrections: dict[Cause, Callable[[], tuple[Images, float]]] = {
            "mirrored": lambda: (mirrored(self.images, [self.view]), 0.0),
            "turned": self._with_constant_turn,
            "sized": self._with_scaled_image,
            "placed": self._with_new_pose,
            "moving": self._with_smooth_turn,
        }
        out: list[ExplainedView] = []
        for cause in causes:
            images, value = corrections[cause]()
            out.append(ExplainedView(cause, images, value, self.median_ray_distance(images)))
        return out

    def _rays_and_targets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return keypoints' rays, directions to triangulated points, and where both exist."""
        one = Rays.of(self.images.view([self.view]))
        turn = self.images.pose[self.view, :, :3, :3]
        targets = self.points - one.origin[0]
        targets = targets / np.maximum(np.linalg.norm(targets, axis=-1, keepdims=True), 1e-9)
        local = np.swapaxes(turn, -1, -2)
        return one.direction[0] @ local, targets @ local, self.exists & (one.weight[0] > 0)

    def _with_constant_turn(self) -> tuple[Images, float]:
        """Rotate the camera about its centre so that most rays meet the points (robust Wahba)."""
        rays, targets, there = self._rays_and_targets()
        turn = robust_rotations(targets[there][None], rays[there][None], there[there][None])
        degrees = np.degrees(Rotation.from_matrix(turn[0]).magnitude())
        return self._with_turn(turn), float(degrees)

    def _with_smooth_turn(self) -> tuple[Images, float]:
        """Rotate the camera about its centre by a rotation that changes smoothly over time."""
        rays, targets, there = self._rays_and_targets()
        moments = len(rays)
        known = there.sum(-1) >= _MIN_POINTS
        if not known.any():
            return self.images, 0.0
        vectors = Rotation.from_matrix(robust_rotations(targets, rays, there)[known]).as_rotvec()
        times = np.arange(moments)
        vectors = np.stack([np.interp(times, times[known], own) for own in vectors.T], -1)
        smooth = moving_average(vectors, round(_SMOOTHING_S * self.images.fps))
        spread = np.linalg.norm(smooth - smooth.mean(0), axis=-1).max()
        return self._with_turn(Rotation.from_rotvec(smooth).as_matrix()), float(np.degrees(spread))

    def _with_turn(self, turns: Float[np.ndarray, "moments 3 3"]) -> Images:
        pose = self.images.pose.copy()
        pose[self.view, :, :3] = turns @ pose[self.view, :, :3]
        fixed = np.ptp(pose[self.view], axis=0).max() < 1e-9
        kept = tuple(bool(fixed) if v == self.view else f for v, f in enumerate(self.images.fixed))
        return replace(self.images, pose=pose, fixed=kept)

    def _with_scaled_image(self) -> tuple[Images, float]:
        """Scale the keypoints about the image's corner, as if detected at another resolution."""
        images, v = self.images, self.view
        local, front = in_camera(images.pose[v], self.points)
        pixels = projected(images.view([v]), local[None], front[None])[0]
        there = self.exists & front & images.seen[v]
        own = images.pixels[v][there]
        if len(own) == 0:
            return images, 1.0
        factor = float(np.median((pixels[there] * own).sum(-1) / np.square(own).sum(-1)))
        if 1 / _MAX_SAME_SIZE < factor < _MAX_SAME_SIZE:
            return images, 1.0
        scaled = images.pixels.copy()
        scaled[v] *= factor
        return replace(images, pixels=scaled), 1 / factor if factor > 0 else np.inf

    def _with_new_pose(self) -> tuple[Images, float]:
        """Estimate another camera pose, with which most points agree (PnP with RANSAC)."""
        images, pose = self.images, self.images.pose.copy()
        local, front = in_camera(pose[self.view], self.points)
        rays, _, there = self._rays_and_targets()
        good = there & front & (rays[..., 2] > _MIN_DEPTH_SHARE)
        if good.sum() < _MIN_SAMPLES:
            return images, 0.0
        plane = rays[good][:, :2] / rays[good][:, 2:]
        found, turn, shift, _ = cv2.solvePnPRansac(
            local[good], plane, np.eye(3), None, reprojectionError=_MAX_INLIER
        )
        if found:
            turn = Rotation.from_rotvec(turn[:, 0]).as_matrix()
            pose[self.view, :, :3] = turn @ pose[self.view, :, :3]
            pose[self.view, :, :3, 3] += shift[:, 0]
        moved = camera_centre(pose[self.view, 0]) - camera_centre(images.pose[self.view, 0])
        return replace(images, pose=pose), float(np.linalg.norm(moved))


def mirrored(images: Images, views: list[int]) -> Images:
    """Return the images with some views mirrored, left to right."""
    pixels = images.pixels.copy()
    for v in views:
        pixels[v, ..., 0] = np.where(images.seen[v], images.size[v][0] - pixels[v, ..., 0], 0.0)
    return replace(images, pixels=pixels)


def shifted_in_time(images: Images, view: int, frames: float) -> Images:
    """Return the images with one view shifted by a number of frames, with interpolation."""
    moments = images.pixels.shape[1]
    times = np.arange(moments) + frames
    low = np.floor(times + 1e-9).astype(int)
    part = (times - low)[:, None]
    part = np.where(np.abs(part) < 1e-6, 0.0, part)
    inside = (low >= 0) & (low + (part[:, 0] > 0) < moments)
    a, b = np.clip(low, 0, moments - 1), np.clip(low + 1, 0, moments - 1)
    pixels, confidence = images.pixels.copy(), images.confidence.copy()
    own, sure = images.pixels[view], images.confidence[view]
    both = np.where(part > 0, np.minimum(sure[a], sure[b]), sure[a])
    confidence[view] = np.where(inside[:, None], both, 0.0)
    there = confidence[view][..., None] > 0
    pixels[view] = np.where(there, (1 - part[..., None]) * own[a] + part[..., None] * own[b], 0.0)
    return replace(images, pixels=pixels, confidence=confidence)


def robust_rotations(
    targets: Float[np.ndarray, "moments samples 3"],
    rays: Float[np.ndarray, "moments samples 3"],
    known: Bool[np.ndarray, "moments samples"],
) -> Float[np.ndarray, "moments 3 3"]:
    """Find the rotations that best turn unit vectors onto others; outliers have less weight."""
    weight = known.astype(np.float64)
    turns = np.broadcast_to(np.eye(3), (len(targets), 3, 3))
    for _ in range(_ROUNDS):
        u, _, vh = np.linalg.svd(np.einsum("tn,tni,tnj->tij", weight, rays, targets))
        proper = np.ones((len(targets), 1, 3))
        proper[..., 0, 2] = np.linalg.det(u @ vh)
        turns = (u * proper) @ vh
        away = np.linalg.norm(rays - targets @ np.swapaxes(turns, -1, -2), axis=-1)
        usual = [np.median(a[s]) if s.any() else 1.0 for a, s in zip(away, known, strict=True)]
        weight = known / (1 + np.square(away / np.maximum(usual, 1e-6)[:, None]))
    return turns


def moving_average(
    values: Float[np.ndarray, "moments dims"], half_width: int
) -> Float[np.ndarray, "moments dims"]:
    """Return centred moving averages, with narrower windows at the ends; keeps straight lines."""
    last = len(values) - 1
    reaches = [min(half_width, t, last - t) for t in range(len(values))]
    return np.stack([values[t - r : t + r + 1].mean(0) for t, r in enumerate(reaches)])


def camera_centre(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """Return a camera's position (m) in the recording's frame, from T_camera_world."""
    return -pose[:3, :3].T @ pose[:3, 3]
