"""Finds ground, walls and clusters in point clouds of a depth sensor, and their noise."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from recon.core.camera import Ground
from recon.core.residuals import NORMAL_MAD

_CANDIDATES = 4
"""Planes looked at: the largest, the largest of what it leaves, ..."""
_SAMPLE = 20_000
"""Points that planes are counted on."""
_FRAMES = 24
"""Frames, evenly over the clip, that tell what stands still."""
_TOLERANCE = 0.03
"""Metres from a plane within which a point belongs to it."""
_LEAST_SHARE = 0.05
"""Share of all points that a plane must have."""
_TRIALS, _REFINEMENTS = 300, 5
"""Planes through three random points that are tried, and fits of the best one to its inliers."""
_LEVEL = math.cos(math.radians(40))
"""Part of a ground's unit normal along the given up direction, at least."""
_WIDTH = 0.8
"""Metres that a ground extends over across its length: more than somebody lying on it."""
_STEEP = 0.5
"""Vertical part of the unit normal of a wall, at most."""
_WALL = 1.2
"""Metres that a wall extends over across its length: more than somebody with arms spread."""


_START, _END = 0.1, 0.9
"""Quantiles of the points of a plane between which its extent is measured."""
_NOWHERE = np.array([[np.inf] * 2, [-np.inf] * 2])


@dataclass(frozen=True)
class FoundGround:
    """The result of a search for the ground: a plane or None, and the reason as a text."""

    ground: Ground | None
    """Normal up, in the frame of the points; None when there is no such plane."""
    reason: str


def find_ground(
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    up: Float[np.ndarray, "3"],
) -> FoundGround:
    """Find the ground: the largest roughly level plane that has few points below it.

    Planes are found by RANSAC (Fischler & Bolles 1981) and refined by least squares on their
    inliers, the largest first. A table is level, too, but the floor around it lies below. The
    soles of a walker are near one plane all along the way; a ground is wide in most frames, so
    the median of the widths of single frames counts.

    Args:
        clouds: points of a whole scene in every frame, metres; frames may be empty.
        up: roughly upwards; (0, -1, 0) in the frame of a camera held level.
    """
    up = np.asarray(up, np.float64) / max(float(np.linalg.norm(up)), 1e-12)
    if not all(np.isfinite(cloud).all() for cloud in clouds):
        raise ValueError("expected clouds of finite points, got NaN or infinity; leave these out")
    generator = np.random.default_rng(0)
    sample, rejected = _SampledPoints.of(clouds, generator), "no plane"
    for normal, offset, rows in _planes_by_size(sample.points, generator):
        if normal @ up < 0:
            normal, offset = -normal, -offset
        if normal @ up < _LEVEL:
            rejected = f"a plane {math.degrees(math.acos(normal @ up)):.0f} degrees from level"
            continue
        if np.median([_plane_width(one, normal) for one in sample.by_frame(rows)]) < _WIDTH:
            rejected = "a level plane no wider than a body"
            continue
        below = float((sample.points @ normal < offset - 2 * _TOLERANCE).mean())
        share = len(rows) / len(sample.points)
        if below > max(0.05, share / 2):
            rejected = f"a level plane with {below:.0%} of the points below it"
            continue
        ground = Ground.create(torch.from_numpy(normal), torch.tensor(offset).double())
        return FoundGround(ground, f"a plane with {share:.0%} of the points")
    return FoundGround(None, f"no ground is seen in the points (found {rejected})")


def find_walls(
    clouds: Sequence[Float[np.ndarray, "_ 3"]],
    eye: Float[np.ndarray, "3"],
) -> list[tuple[Float[np.ndarray, "3"], float]]:
    """Find walls: steep planes that do not move; return unit normal n and offset n·x = d.

    Who walks in a straight line is near one steep plane all along the way. A wall, however, fills
    the same rectangle of its plane, too wide for a person, in most frames, and little is seen
    through that rectangle. The largest planes are looked at first, as in `find_ground`.

    Args:
        clouds: points of a whole scene in every frame, metres, z up; frames may be empty.
        eye: where the sensor is, metres.
    """
    generator = np.random.default_rng(0)
    sample = _SampledPoints.of(clouds, generator)
    walls: list[tuple[np.ndarray, float]] = []
    for normal, offset, rows in _planes_by_size(sample.points, generator):
        if abs(normal[2]) >= _STEEP:
            continue
        axes = _principal_axes(sample.points[rows])[:, 1:]
        low, high = _common_rectangle([one @ axes for one in sample.by_frame(rows)])
        if (high - low).min() / (_END - _START) <= _WALL:
            continue
        away, far = sample.points - eye, offset - normal @ eye
        depth = away @ normal * np.sign(far)
        behind = depth > abs(far) + 2 * _TOLERANCE
        across = (eye + away[behind] * (abs(far) / depth[behind])[:, None]) @ axes
        through = ((across > low) & (across < high)).all(1).sum()
        if through < len(rows):
            walls.append((normal, offset))
    return walls


@dataclass(frozen=True)
class _SampledPoints:
    """Points sampled from evenly spread frames of a clip, about equally many per frame."""

    points: Float[np.ndarray, "points 3"]
    frame: Int[np.ndarray, " points"]
    """Number of each point's frame among those that were drawn, 0, 1, ..."""
    frames: int

    @classmethod
    def of(
        cls, clouds: Sequence[Float[np.ndarray, "_ 3"]], generator: np.random.Generator
    ) -> "_SampledPoints":
        shown = [cloud for cloud in clouds if len(cloud) > 0]
        chosen = np.unique(np.linspace(0, len(shown) - 1, _FRAMES).round().astype(int))
        shown = [shown[k] for k in chosen] if shown else [np.zeros((0, 3))]
        most = _SAMPLE // len(shown)
        some = [
            cloud if len(cloud) <= most else cloud[generator.permutation(len(cloud))[:most]]
            for cloud in shown
        ]
        frame = np.repeat(np.arange(len(some)), [len(cloud) for cloud in some])
        return cls(np.concatenate(some), frame, len(some))

    def by_frame(self, rows: Int[np.ndarray, " rows"]) -> list[Float[np.ndarray, "_ 3"]]:
        """Return the points with the given indices, split by frame."""
        ends = np.searchsorted(self.frame[rows], np.arange(1, self.frames))
        return np.split(self.points[rows], ends)


def _planes_by_size(
    points: Float[np.ndarray, "points 3"], generator: np.random.Generator
) -> Iterator[tuple[Float[np.ndarray, "3"], float, Int[np.ndarray, " inliers"]]]:
    """Yield unit normal, offset and inlier indices of planes, those of most points first."""
    left = np.arange(len(points))
    for _ in range(_CANDIDATES):
        found = _largest_plane(points[left], generator)
        if found is None or found[2].sum() < _LEAST_SHARE * len(points):
            return
        normal, offset, inliers = found
        yield normal, offset, left[inliers]
        left = left[~inliers]


def _common_rectangle(
    frames: Sequence[Float[np.ndarray, "_ 2"]],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Return two corners of the rectangle that the points of at least half of the frames fill.

    Three quarters of the frames begin before it along either axis, and three quarters end after.
    """
    ends = [
        np.quantile(one, (_START, _END), axis=0) if len(one) > 0 else _NOWHERE for one in frames
    ]
    low, high = np.stack(ends, axis=1)
    return (
        np.quantile(low, 0.75, axis=0, method="higher"),
        np.quantile(high, 0.25, axis=0, method="lower"),
    )


def in_front_of_plane(
    points: Float[np.ndarray, "points 3"],
    normal: Float[np.ndarray, "3"],
    offset: float,
    eye: Float[np.ndarray, "3"],
    min_distance: float = 0.06,
) -> Bool[np.ndarray, " points"]:
    """Mask of points on the sensor's side of a plane, more than `min_distance` metres away."""
    side = np.sign(normal @ eye - offset)
    return side * (points @ normal - offset) > min_distance


def _plane_width(points: Float[np.ndarray, "points 3"], normal: Float[np.ndarray, "3"]) -> float:
    """Return the smaller extent (m) of a plane's points, from the 10 to the 90 % quantile."""
    if len(points) == 0:
        return 0.0
    across = np.cross(normal, _principal_axes(points)[:, 2]) @ (points - points.mean(0)).T
    return float(np.subtract(*np.quantile(across, (_END, _START))) / (_END - _START))


def _principal_axes(points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the principal axes of points as columns, the longest one last."""
    centred = points - points.mean(0)
    return np.linalg.eigh(centred.T @ centred)[1]


def _largest_plane(
    points: Float[np.ndarray, "points 3"], generator: np.random.Generator
) -> tuple[Float[np.ndarray, "3"], float, Bool[np.ndarray, " points"]] | None:
    """RANSAC: return unit normal n, offset n·x = d and inlier mask of the largest plane."""
    if len(points) < 3:
        return None
    corners = points[generator.integers(0, len(points), (_TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    proper = length > 1e-9
    if not proper.any():
        return None
    normals = normals[proper] / length[proper, None]
    offsets = np.einsum("nk,nk->n", normals, corners[proper, 0])
    few = points[:: max(1, len(points) // 4000)]
    counts = (np.abs(few @ normals.T - offsets) < _TOLERANCE).sum(0)
    best = int(counts.argmax())
    normal, offset = normals[best], float(offsets[best])
    for _ in range(_REFINEMENTS):
        inliers = np.abs(points @ normal - offset) < _TOLERANCE
        if inliers.sum() < 3:
            return None
        middle = points[inliers].mean(0)
        centred = points[inliers] - middle
        normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        offset = float(normal @ middle)
    return normal, offset, np.abs(points @ normal - offset) < _TOLERANCE


def above_ground(
    points: Float[np.ndarray, "points 3"], ground: Ground, min_height: float = 0.04
) -> Bool[np.ndarray, " points"]:
    """Mask of points that are more than `min_height` metres above the ground."""
    return ground.heights(torch.from_numpy(points).to(ground.normal)).numpy() > min_height


def point_spacing(clouds: Sequence[np.ndarray]) -> float:
    """Return the median distance of points from their nearest neighbour, metres; 0 if none.

    Clouds have axes (points, 3), each its own number of points.
    """
    from scipy.spatial import KDTree

    nearest = [KDTree(cloud).query(cloud, 2)[0][:, 1] for cloud in clouds if len(cloud) > 1]
    return float(np.median(np.concatenate(nearest))) if nearest else 0.0


def cluster_numbers(
    points: Float[np.ndarray, "points 3"], max_gap: float = 0.08
) -> Int[np.ndarray, " points"]:
    """Cluster number of each point; neighbours within `max_gap` metres join; 0 is the largest.

    Points are first gathered into cells of that size, so that any number of them is quick.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if len(points) == 0:
        return np.zeros(0, np.int64)
    whole = np.floor(points / max_gap).astype(np.int64)
    cells, member = np.unique(whole, axis=0, return_inverse=True)
    member = member.reshape(-1)
    pairs: Int[np.ndarray, "pairs 2"] = KDTree(cells).query_pairs(1.8, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    label = connected_components(links, directed=False)[1][member]
    rank = np.argsort(np.argsort(-np.bincount(label), kind="stable"), kind="stable")
    return rank[label]


_NEIGHBOURS = 8
_LEAST = 30
"""Points of a moment that tell its noise."""
_MOMENTS = 30
"""Moments that are looked at; noise changes as slowly as distance."""
_AROUND = 2
"""Looked-at moments to either side whose median one takes."""
_WILD = 3.0
"""Multiple of the median deviation beyond which a point flies, and is no neighbour."""


def depth_noise(
    points: Float[np.ndarray, "moments points 3"],
    present: Bool[np.ndarray, "moments points"],
    eye: Float[np.ndarray, "moments 3"],
) -> Float[np.ndarray, " moments"]:
    """Estimate the standard deviation of measured depths in every frame, metres.

    Every point is compared with the plane through its neighbours in the image: a deviation is
    noise, or the curvature of limbs where points are sparse (half a thousand points of a body
    0.5 to 1 cm). The median of the deviations sees neither edges nor flying pixels. Moments with
    few points take the value of the nearest one with more; without any, it is zero.

    Args:
        points: of the surface, metres.
        present: which of them exist.
        eye: the sensor's place at every moment, metres.
    """
    enough = np.flatnonzero(present.sum(1) >= _LEAST)
    if len(enough) == 0:
        return np.zeros(len(points))
    measured = enough[:: -(-len(enough) // _MOMENTS)]
    found: list[float] = []
    for moment in measured:
        away = (points[moment, present[moment]] - eye[moment]).astype(np.float64)
        deviations = _plane_deviations(away)
        kept = deviations <= _WILD * np.median(deviations)
        found.append(float(np.median(_plane_deviations(away[kept]))) / NORMAL_MAD)
    padded = np.pad(found, _AROUND, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
    return np.interp(np.arange(len(points)), measured, np.median(around, 1))


def _plane_deviations(from_sensor: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, " points"]:
    """Return each point's distance along its ray from a plane fitted to its neighbours."""
    from scipy.spatial import KDTree

    far = np.linalg.norm(from_sensor, axis=1)
    rays = from_sensor / np.maximum(far, 1e-9)[:, None]
    near = np.asarray(KDTree(rays).query(rays, k=_NEIGHBOURS + 1)[1])[:, 1:]
    # project the neighbouring rays onto the plane perpendicular to their mean
    _, _, axes = np.linalg.svd(rays.mean(0)[None])
    image = rays @ axes[1:].T
    beside = image[near] - image[:, None]
    scale = np.maximum(np.abs(beside).max((1, 2)), 1e-9)[:, None, None]
    design = np.concatenate((np.ones((*near.shape, 1)), beside / scale), 2)
    normal = design.transpose(0, 2, 1) @ design + 1e-6 * np.eye(3)
    inverse = np.linalg.inv(normal)
    plane = inverse @ (design.transpose(0, 2, 1) @ far[near][..., None])
    # the fitted plane is uncertain too, because the points that it was fitted to are noisy
    spread = np.sqrt(1 + inverse[:, 0, 0])
    return np.abs(far - plane[:, 0, 0]) / spread
