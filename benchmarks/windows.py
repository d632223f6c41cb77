"""The listed windows as one batch of true motions, and what a sensor sees of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from priors.training.dataset import Part, Splits, clip_files
from recon.body import BodyModel
from recon.formats.amass import load_motion
from recon.motion import Motion
from recon.skeleton import JOINTS, PARENTS
from recon.struct import stack
from recon.surface import KEYPOINTS_43, landmark

FPS = 30.0
FRAMES = 60

BONE_ERROR = 0.005
"""Metres: how well a skeleton recording tells the length of a bone."""


@dataclass(frozen=True)
class Windows:
    """True motions, each clock starting at zero."""

    truth: Motion
    subjects: tuple[str, ...]
    names: tuple[str, ...]
    """Clip and start, for the report."""

    def of(self, subject: str) -> list[int]:
        """The windows of one subject."""
        return [i for i, own in enumerate(self.subjects) if own == subject]


def load_windows(
    corpus: str | Path, splits: Splits, part: Part, body: BodyModel, seed: int = 0
) -> Windows:
    """All windows that the splits list for a part, at 30 Hz.

    A skeleton recording does not tell the girth of a body, so one is drawn per subject.

    Raises:
        ValueError: when a listed clip is not in the corpus or too short.
    """
    files = clip_files(corpus)
    rows = splits.windows[part]
    if missing := sorted({clip for clip, _ in rows} - set(files)):
        raise ValueError(f"{corpus}: {part} clips are missing there: {', '.join(missing)}")
    whole = {clip: load_motion(files[clip]).motion.resample(FPS) for clip, _ in rows}
    shapes: dict[str, Tensor] = {}
    motions: list[Motion] = []
    for clip, seconds in rows:
        subject, first = splits.subject(clip), round(seconds * FPS)
        window = whole[clip].window(first, first + FRAMES)
        if window.frames < FRAMES:
            raise ValueError(f"{files[clip]}: no {FRAMES} frames from {seconds} s on")
        if subject not in shapes:
            generator = np.random.default_rng([seed, *subject.encode()])
            shapes[subject] = draw_girth(body, window.shape, generator)
        motions.append(window.replace(start_time=0.0, shape=shapes[subject]))
    return Windows(
        truth=stack(motions),
        subjects=tuple(splits.subject(clip) for clip, _ in rows),
        names=tuple(f"{clip}@{seconds:.2f}" for clip, seconds in rows),
    )


def draw_girth(
    body: BodyModel, shape: Float[Tensor, " shape"], random: np.random.Generator
) -> Float[Tensor, " shape"]:
    """A shape with about the same bones: drawn from what remains possible once they are known.

    Shapes are N(0, I) before and every coordinate of a bone is known to `BONE_ERROR`, so what is
    added to the fitted shape has covariance (I + JᵀJ / error²)⁻¹ with J the bones' derivative.
    """
    directions = body.joint_directions.double()
    bones = directions[1:] - directions[list(PARENTS[1:])]
    jacobian = bones.flatten(0, 1)[:, : len(shape)]
    precision = torch.eye(len(shape), dtype=torch.float64)
    precision = precision + jacobian.mT @ jacobian / BONE_ERROR**2
    noise = torch.from_numpy(random.standard_normal((len(shape), 1)))
    factor = torch.linalg.cholesky(precision)
    step = torch.linalg.solve_triangular(factor.mT, noise, upper=True)[:, 0]
    return shape + step.to(shape)


def noisy_joints(truth: Motion, body: BodyModel, seed: int, noise: float = 0.04) -> Joints3D:
    """All 22 joints with Gaussian noise, metres per coordinate."""
    positions = body.pose(truth).joints
    random = torch.Generator().manual_seed(seed)
    errors = torch.randn(positions.shape, generator=random, dtype=torch.float64)
    return Joints3D(
        positions=positions + noise * errors.to(positions),
        visible=torch.ones(positions.shape[:-1], dtype=torch.bool),
        joints=tuple(range(len(JOINTS))),
        fps=truth.fps,
    )


def occluded_points(
    truth: Motion, body: BodyModel, height: float = 0.9
) -> tuple[Markers3D, Float[Tensor, "clips time 43 3"]]:
    """43 points of the skin without noise, those below `height` metres hidden; and all of them."""
    vertices = tuple(landmark(name) for name in KEYPOINTS_43)
    points = body.pose(truth).points(torch.tensor(vertices))
    visible = points[..., 2] >= height
    return (
        Markers3D(
            positions=points.where(visible[..., None], 0.0),
            visible=visible,
            vertices=vertices,
            fps=truth.fps,
        ),
        points,
    )
