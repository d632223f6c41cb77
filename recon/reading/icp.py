"""Finds poses of depth cameras from their clouds: by paths of moving points, then by ICP.

The neighbour of a point is sought in the same frame of the clip, as the person moves. The residual
of a pair is its distance along the mean of both normals (Rusinkiewicz 2019), which is zero for
adjacent points of a curved surface, too. It is weighted by Geman & McClure's kernel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.core.errors import ObservationError

_APART = 100.0
"""Metres that frames are apart in the search for neighbours, as its fourth dimension."""
_NEIGHBOURS = 40
"""Points that tell a normal: fewer tell the noise of depths from 3 m on."""
_FLAT = 0.3
"""Variance across a surface as a share of the next larger one, at most, where it has a normal."""
_ROUNDS = ((0.4, 0.1, 0.5, 8), (0.2, 0.06, 0.5, 8), (0.1, 0.03, 0.7, 4), (0.05, 0.015, 0.8, 2))
"""From coarse to fine: distance of neighbours and scale of the kernel, metres, the cosine between
their normals, at least, and the step at which points are looked at."""
_TURNS, _LOOKED, _ROUGHLY, _ALIKE = 72, 4000, (0.2, 0.5), 0.2
"""Turns that are tried, points that are looked at, distance of neighbours in metres and cosine
between their normals, and metres that paths may be apart, where nothing tells a pose."""
_CELL, _STAYS = 0.1, 0.5
"""Metres of a cell, and share of the frames from which on what is seen there stays."""
_STEPS, _STILL = 50, 3e-5
"""Steps of a round, at most, and metres and radians of one that ends it."""


@dataclass(frozen=True)
class OrientedCloud:
    """Points with normals that one camera saw, metres, in that camera's own coordinates."""

    points: Float[np.ndarray, "points 3"]
    frame: Int[np.ndarray, " points"]
    """In which frame each point was seen, counted from the same moment for all cameras."""
    normals: Float[np.ndarray, "points 3"]
    """Of unit length, towards the camera; zero where the surface is not flat."""

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "points 3"],
        frame: Int[np.ndarray, " points"],
        eye: Float[np.ndarray, "3"],
    ) -> "OrientedCloud":
        """Add normals to points: the least principal components of their neighbourhoods."""
        from scipy.spatial import KDTree

        placed = _with_frame_as_coordinate(points, frame)
        near = points[KDTree(placed).query(placed, min(_NEIGHBOURS, len(points)))[1]]
        centred = near - near.mean(1, keepdims=True)
        spread, axes = np.linalg.eigh(centred.transpose(0, 2, 1) @ centred)
        normals = axes[..., 0] * np.sign((axes[..., 0] * (eye - points)).sum(1, keepdims=True))
        return cls(points, frame, normals * (spread[:, :1] < _FLAT * spread[:, 1:2]))

    def __getitem__(self, rows: slice) -> "OrientedCloud":
        """Return the cloud of a range of rows."""
        return OrientedCloud(self.points[rows], self.frame[rows], self.normals[rows])


def rough_poses(
    views: Sequence[OrientedCloud], base: int, names: Sequence[str]
) -> Float[np.ndarray, "cameras 4 4"]:
    """Find rough poses T_base_view of level cameras by matching the paths of moving points.

    Each view is turned about z in steps, with the middle of its path on that of the base view. The
    best turn has the least distance of paths and most points with a neighbour in the base view.

    Args:
        views: what each camera saw, with z up and the ground at z = 0.
        base: number of the view that the others are brought to.
        names: of the cameras, for messages.

    Raises:
        ObservationError: when the moving points of a view have another path than in the base view.
    """
    from scipy.spatial import KDTree

    base_view, paths = views[base], [_path_of_moving_points(one) for one in views]
    tree = KDTree(_with_frame_as_coordinate(base_view.points, base_view.frame))
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    for number in set(range(len(views))) - {base}:
        common = sorted(paths[number].keys() & paths[base].keys())
        base_path, path = (
            np.array([paths[k][frame] for frame in common]).reshape(-1, 3) for k in (base, number)
        )
        some = views[number][:: max(len(views[number].points) // _LOOKED, 1)]
        best, apart = 0.0, np.inf
        for turn in np.linspace(0, 2 * np.pi, _TURNS, endpoint=False) if common else ():
            T = _moved_pose(np.eye(4), np.array([0, 0, turn, 0, 0, 0]))
            T[:3, 3] = (base_path - path @ T[:3, :3].T).mean(0)
            off = float(np.linalg.norm(path @ T[:3, :3].T + T[:3, 3] - base_path, axis=1).mean())
            pairs, _ = _residuals_and_jacobian(some, base_view, T, np.eye(4), tree, *_ROUGHLY)
            if len(pairs) / (off + _CELL) > best:
                best, apart, poses[number] = len(pairs) / (off + _CELL), off, T
        if apart > _ALIKE:
            raise ObservationError(
                f"{names[number]}: something moves along another path than in {names[base]}, "
                "expected the same person at the same time; give files with rough poses "
                "(T_camera_world)"
            )
    return poses


def _path_of_moving_points(view: OrientedCloud) -> dict[int, Float[np.ndarray, "3"]]:
    """Return the centre of the moving points by frame; cells always occupied are left out."""
    cells = np.floor(view.points / _CELL).astype(np.int64)
    each, frame = np.unique(np.c_[cells, view.frame], axis=0), np.unique(view.frame)
    places, counts = np.unique(each[:, :3], axis=0, return_counts=True)
    stay = {tuple(one) for one in places[counts > _STAYS * len(frame)].tolist()}
    moves = np.array([tuple(one) not in stay for one in cells.tolist()])
    shown = ((one, view.points[moves & (view.frame == one)]) for one in frame.tolist())
    return {k: np.median(some, axis=0) * (1, 1, 0) for k, some in shown if len(some)}


def refined_poses(
    views: Sequence[OrientedCloud],
    poses: Float[np.ndarray, "cameras 4 4"],
    base: int,
    level: Bool[np.ndarray, " cameras"],
) -> tuple[Float[np.ndarray, "cameras 4 4"], Float[np.ndarray, " cameras"]]:
    """Refine poses by ICP; return them, and each view's share of points with a neighbour.

    Args:
        views: what each camera saw.
        poses: T_world_view to begin with, off by 0.3 m and 10 degrees at most.
        base: number of the camera that stays.
        level: cameras whose frame stands on the ground as that of `base` does: they only turn
            about z and move along x and y.
    """
    from scipy.spatial import KDTree

    trees = [KDTree(_with_frame_as_coordinate(one.points, one.frame)) for one in views]
    count = len(views)
    free = np.ones((count, 6), np.bool_)
    free[level] = [False, False, True, True, True, False]
    free[base] = False
    moving = np.flatnonzero(free)
    shares = np.zeros(count)
    for reach, kernel, along, every in _ROUNDS:
        for _ in range(_STEPS):
            hessian, gradient = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
            shares = np.zeros(count)
            for i, j in permutations(range(count), 2):
                T, some = np.linalg.inv(poses[j]) @ poses[i], views[i][::every]
                residuals, jacobian = _residuals_and_jacobian(
                    some, views[j], T, poses[j], trees[j], reach, along
                )
                weighted = jacobian * ((1 + (residuals / kernel) ** 2) ** -2)[:, None]
                sign = np.eye(count)[i] - np.eye(count)[j]
                hessian += np.kron(np.outer(sign, sign), weighted.T @ jacobian)
                gradient += np.kron(sign, weighted.T @ residuals)
                shares[i] = max(shares[i], len(residuals) / len(some.points))
            damped = hessian + (1e-6 * np.trace(hessian) + 1e-9) * np.eye(6 * count)
            step = np.zeros(6 * count)
            step[moving] = -np.linalg.solve(damped[np.ix_(moving, moving)], gradient[moving])
            poses = np.stack(
                [_moved_pose(*pair) for pair in zip(poses, step.reshape(-1, 6), strict=True)]
            )
            if np.abs(step).max() < _STILL:
                break
    return poses, shares


def _residuals_and_jacobian(
    one: OrientedCloud,
    other: OrientedCloud,
    T_other_one: Float[np.ndarray, "4 4"],
    T_world_other: Float[np.ndarray, "4 4"],
    other_tree: Any,
    reach: float,
    along: float,
) -> tuple[Float[np.ndarray, " pairs"], Float[np.ndarray, "pairs 6"]]:
    """Return ICP residuals of the points of one view with a neighbour in another, and Jacobian.

    The Jacobian is by a small rotation and translation of the first view in the world; that by the
    second view's is its negative.
    """
    here = one.points @ T_other_one[:3, :3].T + T_other_one[:3, 3]
    turned = one.normals @ T_other_one[:3, :3].T
    distance, near = other_tree.query(
        _with_frame_as_coordinate(here, one.frame), distance_upper_bound=reach
    )
    rows = np.flatnonzero(distance < reach)
    rows = rows[(turned[rows] * other.normals[near[rows]]).sum(1) > along]
    near, here = near[rows], here[rows]
    middle = turned[rows] + other.normals[near]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    residuals = ((here - other.points[near]) * middle).sum(1)
    normals = middle @ T_world_other[:3, :3].T
    places = (here + other.points[near]) / 2 @ T_world_other[:3, :3].T + T_world_other[:3, 3]
    return residuals, np.concatenate((np.cross(places, normals), normals), 1)


def _moved_pose(
    T: Float[np.ndarray, "4 4"], step: Float[np.ndarray, "6"]
) -> Float[np.ndarray, "4 4"]:
    """Return a pose after a small rotation and translation (a 6-vector) in the world."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    moved = T.copy()
    moved[:3, :3], moved[:3, 3] = turn @ T[:3, :3], turn @ T[:3, 3] + step[3:]
    return moved


def _with_frame_as_coordinate(
    points: Float[np.ndarray, "points 3"], frame: Int[np.ndarray, " points"]
) -> Float[np.ndarray, "points 4"]:
    return np.concatenate((points, _APART * frame[:, None]), 1)
