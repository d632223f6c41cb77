"""A known motion as a sensor would have seen it: for tests, benchmarks and users' own checks."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Generator, Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from recon.body import BodyModel
from recon.formats.amass import load_motion
from recon.formats.observation import PositionsFile, save_observation
from recon.motion import Motion
from recon.skeleton import JOINTS
from recon.surface import KEYPOINTS_43, landmark

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Corruption:
    """What stands between the truth and the sensor."""

    noise: float = 0.0
    """Standard deviation of every coordinate, metres."""
    hide_below: float | None = None
    """Points lower than this height are hidden, metres."""
    hide_box: tuple[Corner, Corner] | None = None
    """Points between these two corners are hidden, metres."""
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
                raise ValueError(f"{name} is a share between 0 and 1, got {share}")
        if not self.noise >= 0:
            raise ValueError(f"noise is a standard deviation in metres, got {self.noise}")

    def visible(
        self, points: Float[Tensor, "time points 3"], generator: Generator
    ) -> Bool[Tensor, "time points"]:
        """Which of the true points the sensor sees."""
        time, count = points.shape[:2]
        seen = torch.rand(time, count, generator=generator) >= self.missing_points
        seen &= torch.rand(time, 1, generator=generator) >= self.missing_frames
        if self.hide_below is not None:
            seen &= points[..., 2] >= self.hide_below
        if self.hide_box is not None:
            low, high = points.new_tensor(self.hide_box)
            seen &= ~((points >= low) & (points <= high)).all(-1)
        return seen

    def disturb(
        self, points: Float[Tensor, "time points 3"], generator: Generator
    ) -> Float[Tensor, "time points 3"]:
        """The points with noise and outliers."""
        noise = torch.randn(points.shape, generator=generator, dtype=torch.float64)
        wild = torch.rand(points.shape, generator=generator, dtype=torch.float64) - 0.5
        hit = torch.rand(points.shape[:2], generator=generator) < self.outliers
        return points + (self.noise * noise + hit[..., None] * wild).to(points)


def joints3d(motion: Motion, body: BodyModel, corruption: Corruption, seed: int) -> Joints3D:
    """All 22 joints of one clip (no batch axis)."""
    truth = body.pose(motion).joints
    positions, visible = _observe(truth, corruption, seed)
    return Joints3D(positions, visible, tuple(range(22)), motion.fps, motion.start_time)


def markers3d(
    motion: Motion,
    body: BodyModel,
    corruption: Corruption,
    seed: int,
    names: tuple[str, ...] = KEYPOINTS_43,
) -> Markers3D:
    """Points of the surface of one clip (no batch axis); by default 43 spread over the body."""
    vertices = tuple(landmark(name) for name in names)
    truth = body.pose(motion).points(torch.tensor(vertices))
    positions, visible = _observe(truth, corruption, seed)
    return Markers3D(positions, visible, vertices, motion.fps, motion.start_time)


def exact(
    seen: Joints3D | Markers3D, truth: Motion, body: BodyModel
) -> Float[Tensor, "time points 3"]:
    """Where the tracked points really were."""
    posed = body.pose(truth)
    if isinstance(seen, Joints3D):
        return posed.joints[..., list(seen.joints), :]
    return posed.points(torch.tensor(seen.vertices))


def visible_joints(
    motion: Motion, body: BodyModel, corruption: Corruption, seed: int
) -> Bool[Tensor, "time 22"]:
    """Which joints of the truth the sensor could have seen; `evaluate` splits errors by it."""
    generator = torch.Generator().manual_seed(seed)
    return corruption.visible(body.pose(motion).joints, generator)


def _observe(truth: Tensor, corruption: Corruption, seed: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    visible = corruption.visible(truth, generator)
    positions = corruption.disturb(truth, generator)
    return torch.where(visible[..., None], positions, 0.0), visible


def simulate_file(
    motion: Path,
    out: Path,
    kind: Literal["joints3d", "markers3d"],
    corruption: Corruption,
    *,
    seed: int,
    fps: float | None = None,
    frames: tuple[int, int] | None = None,
    unknown_ground: bool = False,
) -> None:
    """Write what a sensor would have seen of a motion file.

    Raises:
        FileNotFoundError: when there is no such motion.
        ValueError: when it is damaged or has fewer frames than asked for.
    """
    truth = load_motion(motion).motion
    if frames is not None:
        if frames[1] > truth.frames:
            raise ValueError(f"{motion}: has {truth.frames} frames, asked for {frames}")
        truth = truth.window(*frames)
    truth = truth if fps is None else truth.resample(fps)
    body = BodyModel.load()
    see, names = (joints3d, JOINTS) if kind == "joints3d" else (markers3d, KEYPOINTS_43)
    seen = see(truth, body, corruption, seed)
    save_observation(
        out,
        PositionsFile(
            kind=kind,
            positions=seen.positions.double().numpy(),
            visible=seen.visible.numpy(),
            names=names,
            fps=truth.fps,
            start_time=truth.start_time,
            ground_known=not unknown_ground,
            truth_visible=visible_joints(truth, body, corruption, seed).numpy(),
        ),
    )
