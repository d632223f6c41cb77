"""Chamfer distance between a body's surface and scans."""

import numpy as np
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.formats.observations import PointsFile


def chamfer(
    vertices: Float[np.ndarray, "vertices 3"], points: Float[np.ndarray, "points 3"]
) -> float:
    """Half of mean_v min_p |v - p| + mean_p min_v |v - p| for one frame, metres.

    Distances, not their squares. Neither set knows the surface between its members, so two
    samples of the same surface are not at zero.

    Raises:
        ValueError: when one of them is empty.
    """
    from scipy.spatial import KDTree

    if len(vertices) == 0 or len(points) == 0:
        raise ValueError(
            f"expected vertices and points, got {len(vertices)} and {len(points)} of them"
        )
    to_points = KDTree(points).query(vertices)[0].mean()
    to_vertices = KDTree(vertices).query(points)[0].mean()
    return float(to_points + to_vertices) / 2


def chamfer_of_clip(motion: Motion, body: BodyModel, scans: PointsFile) -> float:
    """Mean over the frames that have points of `chamfer` with the body at their moments, metres.

    Args:
        motion: one clip (no batch axis), at any rate.
        body: whose vertices are compared.
        scans: in the world.

    Raises:
        ValueError: when a scan was taken outside the motion's time, there is none, or the points
            are in the frame of a camera without pose.
    """
    if scans.camera is not None and scans.camera.T_camera_world is None:
        raise ValueError("points in the frame of a camera without pose have no place in the world")
    frames, rows = np.unique(scans.frame, return_inverse=True)
    if len(frames) == 0:
        raise ValueError("expected scans with points, got none")
    times = motion.times.new_tensor(scans.start_time + frames / scans.fps)
    vertices = body.pose(motion.at(times, scans.fps)).vertices.detach().cpu().double().numpy()
    clouds = np.split(
        scans.points[np.argsort(rows, kind="stable")], np.cumsum(np.bincount(rows))[:-1]
    )
    return float(np.mean([chamfer(v, p) for v, p in zip(vertices, clouds, strict=True)]))
