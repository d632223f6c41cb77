"""Viewpoints of pictures: a pinhole camera at three-quarter view that follows the person."""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from recon.view.scene import Figure, Show

FIELD_OF_VIEW = math.radians(32)
"""Angle of view along a picture's shorter side: a portrait lens keeps limbs in proportion."""
AZIMUTH = math.radians(38)
"""Angle, seen from above, between the person's front and the direction to the camera."""
ELEVATION = math.radians(13)
OVERVIEW_ELEVATION = math.radians(20)
OVERVIEW_REACH = 10.0
"""Distance from the people, metres, within which cameras are kept in the picture."""
MARGIN = 0.9
"""Share of the picture, around its middle, within which people are kept."""
FOLLOW_SECONDS = 0.4
"""Standard deviation of the Gaussian window that smooths the followed path, seconds."""


@dataclass(frozen=True)
class Viewpoint:
    """A pinhole camera in the world (OpenCV axes: x right, y down, z forward)."""

    R_camera_world: Float[np.ndarray, "3 3"]
    position: Float[np.ndarray, "3"]
    """Position in the world, metres."""
    target: Float[np.ndarray, "3"]
    """Point on the viewing axis in the middle of what is shown; world, metres."""
    focal: float
    """Focal length, pixels."""
    size: tuple[int, int]
    """Width and height, pixels."""
    centre: tuple[float, float]
    """Principal point, pixels."""

    def scaled(self, factor: int) -> "Viewpoint":
        """Return the same view with `factor` times as many pixels along each side."""
        x, y = self.centre
        return dataclasses.replace(
            self,
            focal=self.focal * factor,
            size=(self.size[0] * factor, self.size[1] * factor),
            centre=(x * factor, y * factor),
        )

    def part(self, left: int, top: int, right: int, bottom: int) -> "Viewpoint":
        """Cut out a rectangle of the picture, without column `right` and row `bottom`."""
        x, y = self.centre
        size, centre = (right - left, bottom - top), (x - left, y - top)
        return dataclasses.replace(self, size=size, centre=centre)

    def project(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
        """Project points to pixels (the first pixel's centre is 0.5) and depths, metres."""
        local = (points - self.position) @ self.R_camera_world.T
        depth = local[:, 2]
        safe = np.where(np.abs(depth) < 1e-6, 1e-6, depth)
        return local[:, :2] / safe[:, None] * self.focal + self.centre, depth

    def coordinates_along(
        self, axes: Float[np.ndarray, "axes 3"], depth: Float[np.ndarray, "height width"]
    ) -> Float[np.ndarray, "axes height width"]:
        """Return coordinates along axes of the points at given depths in all pixels, metres."""
        x = (np.arange(self.size[0]) + 0.5 - self.centre[0]) / self.focal
        y = (np.arange(self.size[1]) + 0.5 - self.centre[1]) / self.focal
        x, y = x.astype(np.float32), y.astype(np.float32)[:, None]
        local = (axes @ self.R_camera_world.T).astype(np.float32)
        starts = (axes @ self.position).astype(np.float32)
        along = [
            start + depth * (a * x + (b * y + c))
            for start, (a, b, c) in zip(starts, local, strict=True)
        ]
        return np.stack(along)


def viewpoints(show: Show, size: tuple[int, int]) -> tuple[Viewpoint, ...]:
    """Choose a viewpoint per frame that follows the person, or is fixed if cameras are shown."""
    centres = [
        view.at(frame).T_world_camera[:3, 3].numpy()
        for view in show.cameras
        for frame in (range(show.frames) if view.camera.T_camera_world.ndim == 3 else (0,))
    ]
    if centres:
        return fixed_viewpoint(show.figures, np.stack(centres), size)
    return following_viewpoints(show.figures, size)


def following_viewpoints(
    figures: Sequence[Figure], size: tuple[int, int]
) -> tuple[Viewpoint, ...]:
    """Choose viewpoints per frame that keep all figures in view from a constant direction.

    The direction is `AZIMUTH` from the first figure's mean heading, the distance the smallest at
    which the surface stays within `MARGIN` of the picture in 98 % of the frames.
    """
    surface = np.concatenate([_sparse_vertices(figure) for figure in figures], 1)
    pelvis = np.mean([figure.posed.joints[:, 0].numpy() for figure in figures], 0)
    target = _smoothed_path(pelvis.astype(np.float64), figures[0].motion.fps * FOLLOW_SECONDS)
    target[:, 2] = (max(surface[..., 2].max(), 0.5) + min(surface[..., 2].min(), 0)) / 2

    R_camera_world = _three_quarter_axes(figures[0], ELEVATION)
    needed = _distance_needed((surface - target[:, None]) @ R_camera_world.T, size)
    back = float(np.quantile(needed.max(1), 0.98)) * R_camera_world[2]
    lens = _focal_length(size), size, (size[0] / 2, size[1] / 2)
    return tuple(Viewpoint(R_camera_world, place - back, place, *lens) for place in target)


def fixed_viewpoint(
    figures: Sequence[Figure],
    others: Float[np.ndarray, "points 3"],
    size: tuple[int, int],
) -> tuple[Viewpoint, ...]:
    """Choose a fixed viewpoint, repeated for every frame, that shows figures and other points.

    Other points farther than `OVERVIEW_REACH` from the figures need not be in view.
    """
    surface = np.concatenate([_sparse_vertices(figure) for figure in figures], 1).reshape(-1, 3)
    middle = (surface.min(0) + surface.max(0)) / 2
    reach = OVERVIEW_REACH + np.ptp(surface, axis=0).max() / 2
    kept = others[np.linalg.norm(others - middle, axis=1) < reach]
    points = np.concatenate([surface, kept])
    R_camera_world = _three_quarter_axes(figures[0], OVERVIEW_ELEVATION)
    local = points @ R_camera_world.T
    target = (local.min(0) + local.max(0)) / 2 @ R_camera_world
    needed = _distance_needed((points - target) @ R_camera_world.T, size)
    place = target - float(needed.max()) * R_camera_world[2]
    middle = (size[0] / 2, size[1] / 2)
    view = Viewpoint(R_camera_world, place, target, _focal_length(size), size, middle)
    return (view,) * figures[0].motion.frames


def _focal_length(size: tuple[int, int]) -> float:
    """Return the focal length, pixels, for `FIELD_OF_VIEW` and a picture of a given size."""
    return min(size) / 2 / math.tan(FIELD_OF_VIEW / 2)


def _distance_needed(
    local: Float[np.ndarray, "*shape 3"], size: tuple[int, int]
) -> Float[np.ndarray, "*shape"]:
    """Return how far from the target a camera must be to show points within `MARGIN`, metres.

    The points are given from the target along the camera's axes.
    """
    reach = np.array(size) / 2 * MARGIN / _focal_length(size)
    return (np.abs(local[..., :2]) / reach).max(-1) - local[..., 2]


def direction_to_the_right(figure: Figure) -> Float[np.ndarray, "3"]:
    """Return the horizontal unit vector that points to the right in pictures of a figure."""
    return _three_quarter_axes(figure, ELEVATION)[0]


def _three_quarter_axes(figure: Figure, elevation: float) -> Float[np.ndarray, "3 3"]:
    """Return R_camera_world of a camera at an angle to a figure's mean heading, looking down."""
    front = figure.posed.orientations[:, 0, :2, 2].double().numpy().sum(0)
    heading = math.atan2(front[1], front[0]) - AZIMUTH
    level = np.array([math.cos(heading), math.sin(heading), 0.0])
    toward = math.cos(elevation) * level + np.array([0.0, 0.0, math.sin(elevation)])
    right = np.array([-math.sin(heading), math.cos(heading), 0.0])
    return np.stack([right, np.cross(-toward, right), -toward])


def _sparse_vertices(figure: Figure) -> Float[np.ndarray, "time points 3"]:
    """Return every fortieth vertex over time, enough to know how far a body reaches."""
    some = torch.arange(0, len(figure.body.template), 40)
    return figure.posed.points(some).double().numpy()


def _smoothed_path(
    path: Float[np.ndarray, "time 3"], window_std: float
) -> Float[np.ndarray, "time 3"]:
    """Smooth a path by local linear regression with a Gaussian window, without lag."""
    offset = np.arange(len(path))[None] - np.arange(len(path))[:, None]
    window = np.exp(-0.5 * (offset / max(window_std, 1e-3)) ** 2)
    first, second = window * offset, window * offset**2
    first = first.sum(1)
    second = second.sum(1) + 1e-6  # no 0/0 for a single frame
    # weights of a local linear regression, evaluated at offset zero, with sum 1
    weights = window * (second[:, None] - first[:, None] * offset)
    return (weights / weights.sum(1, keepdims=True)) @ path
