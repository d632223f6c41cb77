"""A known motion as scanners all around would have seen it: points all over the surface."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Int

from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.formats.observations import PointsFile
from recon.simulation.points import Corruption

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
    """Points of one clip (no batch axis) spread evenly over the whole posed surface.

    Every frame has points of its own, so none can be followed from frame to frame. The
    corruption's noise is that of every coordinate, its box and height hide what is inside.

    Args:
        motion: the truth.
        body: whose motion it is; `recon.simulation.clothes.clothed` dresses one.
        corruption: what stands in the way.
        seed: of everything random.
        points: of a frame, before some are hidden.

    Raises:
        ValueError: when there are no points, or the corruption hides all of them.
    """
    if points < 1:
        raise ReconError(f"scans have one point a frame or more, got {points}")
    random, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    posed = body.pose(motion)
    faces = body.faces.cpu().numpy()
    clouds = [
        spread(frame, faces, points, random) for frame in posed.vertices.double().cpu().numpy()
    ]
    true = torch.from_numpy(np.stack(clouds))
    visible = corruption.visible(true, generator, motion.times)
    seen = corruption.disturb(true, generator)
    if not visible.any():
        raise ReconError("the corruption hides every point of every frame")
    clear = replace(corruption, missing_points=0.0, missing_frames=0.0)
    return PointsFile(
        points=seen[visible].numpy(),
        frame=visible.nonzero()[:, 0].numpy(),
        fps=motion.fps,
        start_time=motion.start_time,
        truth_visible=clear.visible(posed.joints, generator, motion.times).numpy(),
    )


def spread(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    count: int,
    random: np.random.Generator,
) -> Float[np.ndarray, "points 3"]:
    """Points drawn uniformly by area from a mesh.

    A triangle is drawn by its area, then a point a + s ((1 - t) (b - a) + t (c - a)) of it with
    s² and t uniform (Osada et al. 2002).
    """
    a, b, c = vertices[faces].swapaxes(0, 1)
    b, c = b - a, c - a
    reach = np.linalg.norm(np.cross(b, c), axis=1).cumsum()
    face = np.searchsorted(reach, reach[-1] * random.random(count), side="right")
    s, t = np.sqrt(random.random((count, 1))), random.random((count, 1))
    return a[face] + s * ((1 - t) * b[face] + t * c[face])
