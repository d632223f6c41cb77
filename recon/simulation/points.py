"""Simulates joints, markers and scans of a known motion."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.body.landmarks import KEYPOINTS_43, LANDMARKS_16, landmark
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.formats.observations import PointsFile

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Corruption:
    """Settings that degrade simulated data: noise, outliers, missing and hidden points."""

    noise: float = 0.0
    """Standard deviation of every coordinate, metres; pixels in images."""
    hide_below: float | None = None
    """Points lower than this height are hidden, metres."""
    hide_box: tuple[Corner, Corner] | None = None
    """Points between these two corners are hidden, metres; in images what lies behind it, too."""
    during: tuple[float, float] | None = None
    """Seconds of the motion's clock in which things are hidden; None is always."""
    missing_points: float = 0.0
    """Share of points missing at random."""
    missing_frames: float = 0.0
    """Share of frames in which nothing is seen, at random."""
    outliers: float = 0.0
    """Share of visible points that are up to half a metre off in a random direction."""

    def __post_init__(self) -> None:
        for name in ("missing_points", "missing_frames", "outliers"):
            share = getattr(self, name)
            if not 0 <= share <= 1:
                raise ReconError(f"{name} must be a share between 0 and 1, got {share}")
        if not self.noise >= 0:
            raise ReconError(f"noise must be a standard deviation, zero or more, got {self.noise}")
        if self.during is not None and not self.during[0] < self.during[1]:
            raise ReconError(f"during must be two times A < B in seconds, got {self.during}")

    def active(self, times: Float[Tensor, " time"]) -> Bool[Tensor, " time"]:
        """Return a mask of the times at which `hide_below` and `hide_box` are in effect."""
        first, last = (-math.inf, math.inf) if self.during is None else self.during
        return (times >= first) & (times < last)

    def visible(
        self,
        points: Float[Tensor, "time points 3"],
        generator: Generator,
        times: Float[Tensor, " time"],
    ) -> Bool[Tensor, "time points"]:
        """Draw a mask of the points that are neither missing at random nor hidden."""
        active = self.active(times)[:, None]
        time, count = points.shape[:2]
        seen = torch.rand(time, count, generator=generator) >= self.missing_points
        seen &= torch.rand(time, 1, generator=generator) >= self.missing_frames
        if self.hide_below is not None:
            seen &= (points[..., 2] >= self.hide_below) | ~active
        if self.hide_box is not None:
            low, high = points.new_tensor(self.hide_box).sort(0).values
            seen &= ~(((points >= low) & (points <= high)).all(-1) & active)
        return seen

    def with_noise(
        self, points: Float[Tensor, "time points 3"], generator: Generator
    ) -> Float[Tensor, "time points 3"]:
        """Add Gaussian noise to points, and move some at random as outliers."""
        noise = torch.randn(points.shape, generator=generator, dtype=torch.float64)
        shift = torch.rand(points.shape, generator=generator, dtype=torch.float64) - 0.5
        is_outlier = torch.rand(points.shape[:2], generator=generator) < self.outliers
        return points + (self.noise * noise + is_outlier[..., None] * shift).to(points)


def joints3d(motion: Motion, body: BodyModel, corruption: Corruption, seed: int) -> Joints3D:
    """Simulate the 22 joints of one clip (no batch axis)."""
    truth = body.pose(motion).joints
    positions, visible = _disturbed_and_visible(truth, corruption, seed, motion.times)
    return Joints3D(positions, visible, tuple(range(22)), motion.fps, motion.start_time)


def markers3d(
    motion: Motion,
    body: BodyModel,
    corruption: Corruption,
    seed: int,
    names: tuple[str, ...] = KEYPOINTS_43,
    skin_offset: float = 0.0,
) -> Markers3D:
    """Simulate markers of one clip (no batch axis); by default 43 spread over the body.

    Each keeps one offset, N(0, skin_offset² I), in the frame of the bone that carries its vertex,
    as a person places markers beside their landmarks.

    Raises:
        ValueError: when the offset's standard deviation is negative.
    """
    if not skin_offset >= 0:
        raise ReconError(f"skin_offset is a standard deviation, zero or more, got {skin_offset}")
    vertices = tuple(landmark(name) for name in names)
    posed = body.pose(motion)
    truth = posed.points(torch.tensor(vertices))
    if skin_offset > 0:
        bones = body.weights[list(vertices)].argmax(-1)
        # a generator of its own, so that offsets do not depend on the noise
        generator = Generator().manual_seed(seed ^ 0x5EED)
        away = skin_offset * torch.randn(len(names), 3, generator=generator, dtype=torch.float64)
        truth = truth + (posed.orientations[:, bones] @ away.to(truth)[..., None])[..., 0]
    positions, visible = _disturbed_and_visible(truth, corruption, seed, motion.times)
    return Markers3D(positions, visible, vertices, motion.fps, motion.start_time)


def landmarks3d(
    motion: Motion,
    body: BodyModel,
    corruption: Corruption,
    seed: int,
    *,
    skin_offset: float = 0.01,
    names: tuple[str, ...] = LANDMARKS_16,
) -> Markers3D:
    """Simulate markers that are placed by hand, and so miss their landmarks a little."""
    return markers3d(motion, body, corruption, seed, names, skin_offset)


def visible_joints(
    motion: Motion, body: BodyModel, corruption: Corruption, seed: int
) -> Bool[Tensor, "time 22"]:
    """Return a mask of the joints that are not hidden or missing, for `recon.evaluate`."""
    generator = torch.Generator().manual_seed(seed)
    return corruption.visible(body.pose(motion).joints, generator, motion.times)


def _disturbed_and_visible(
    truth: Tensor, corruption: Corruption, seed: int, times: Tensor
) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    visible = corruption.visible(truth, generator, times)
    positions = corruption.with_noise(truth, generator)
    return torch.where(visible[..., None], positions, 0.0), visible


POINTS = 4096
"""Points of a frame."""


def scan_points(
    motion: Motion,
    body: BodyModel,
    corruption: Corruption,
    seed: int,
    *,
    points: int = POINTS,
) -> PointsFile:
    """Simulate scans of one clip (no batch axis): points spread evenly over the surface.

    Every frame has points of its own, so none can be followed from frame to frame. The
    corruption's noise is that of every coordinate, its box and height hide what is inside.

    Args:
        motion: the truth.
        body: whose motion it is; `recon.simulation.scenery.clothed` dresses one.
        corruption: what stands in the way.
        seed: of everything random.
        points: of a frame, before some are hidden.

    Raises:
        ValueError: when there are no points, or the corruption hides all of them.
    """
    if points < 1:
        raise ReconError(f"scans need at least one point a frame, got {points}")
    random, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    posed = body.pose(motion)
    faces = body.faces.cpu().numpy()
    clouds = [
        sampled_on_surface(frame, faces, points, random)
        for frame in posed.vertices.double().cpu().numpy()
    ]
    true = torch.from_numpy(np.stack(clouds))
    visible = corruption.visible(true, generator, motion.times)
    seen = corruption.with_noise(true, generator)
    if not visible.any():
        raise ReconError("the corruption hides every point of every frame; hide less")
    clear = replace(corruption, missing_points=0.0, missing_frames=0.0)
    return PointsFile(
        points=seen[visible].numpy(),
        frame=visible.nonzero()[:, 0].numpy(),
        fps=motion.fps,
        start_time=motion.start_time,
        truth_visible=clear.visible(posed.joints, generator, motion.times).numpy(),
    )


def sampled_on_surface(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    count: int,
    random: np.random.Generator,
    values: Float[np.ndarray, "vertices values"] | None = None,
) -> Float[np.ndarray, "points values"]:
    """Sample mesh points uniformly by area; return them, or vertex `values` interpolated there.

    A triangle is drawn by its area, then a point a + s ((1 - t) (b - a) + t (c - a)) of it with
    s² and t uniform (Osada et al. 2002).
    """
    a, b, c = vertices[faces].swapaxes(0, 1)
    area_sum = np.linalg.norm(np.cross(b - a, c - a), axis=1).cumsum()
    face = np.searchsorted(area_sum, area_sum[-1] * random.random(count), side="right")
    s, t = np.sqrt(random.random((count, 1))), random.random((count, 1))
    a, b, c = (vertices if values is None else values)[faces[face]].swapaxes(0, 1)
    return a + s * ((1 - t) * (b - a) + t * (c - a))
