"""Points of a surface of triangles that are nearest to given points."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_NEAR = 12
"""Triangles that are tried for every point: those with the nearest centres."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points on triangles, by what they are made of."""

    triangles: Int[np.ndarray, "points 3"]
    """Vertex numbers of the triangle of every point."""
    shares: Float[np.ndarray, "points 3"]
    """Barycentric coordinates: what each vertex contributes; they sum to one."""
    places: Float[np.ndarray, "points 3"]
    """Positions, metres."""


def closest_points(
    points: Float[np.ndarray, "points 3"],
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> SurfacePoints:
    """The nearest point of a surface to each point, among the triangles with the nearest centres.

    On meshes whose triangles are of like size it is the nearest of all.

    Args:
        points: metres.
        vertices: of the surface, metres.
        faces: its triangles, by vertex number.
    """
    from scipy.spatial import KDTree

    corners = vertices[faces]
    count = min(_NEAR, len(faces))
    _, near = KDTree(corners.mean(1)).query(points, k=count)
    near = np.asarray(near).reshape(len(points), count)
    shares = _barycentric(points[:, None], corners[near])
    places = np.einsum("pnc,pncd->pnd", shares, corners[near])
    best = np.square(places - points[:, None]).sum(-1).argmin(1)
    rows = np.arange(len(points))
    return SurfacePoints(faces[near[rows, best]], shares[rows, best], places[rows, best])


def _barycentric(
    points: Float[np.ndarray, "points 1 3"], corners: Float[np.ndarray, "points near 3 3"]
) -> Float[np.ndarray, "points near 3"]:
    """Coordinates of the nearest point of each triangle: inside it, or on its nearest edge."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    inside = _of_plane(points, a, b, c)
    edges = [_of_edge(points, corners, first, (first + 1) % 3) for first in range(3)]
    stacked = np.stack(edges, -2)
    places = np.einsum("pnec,pncd->pned", stacked, corners)
    nearest = np.square(places - points[..., None, :]).sum(-1).argmin(-1)
    edge = np.take_along_axis(stacked, nearest[..., None, None], -2)[..., 0, :]
    return np.where((inside >= 0).all(-1, keepdims=True), inside, edge)


def _of_plane(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Barycentric coordinates of the projection onto the plane; negative outside."""
    u, v, w = b - a, c - a, points - a
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    wu, wv = (w * u).sum(-1), (w * v).sum(-1)
    area = np.maximum(uu * vv - uv * uv, 1e-18)
    second, third = (vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area
    return np.stack((1 - second - third, second, third), -1)


def _of_edge(points: np.ndarray, corners: np.ndarray, first: int, last: int) -> np.ndarray:
    start, along = corners[..., first, :], corners[..., last, :] - corners[..., first, :]
    length = np.maximum((along * along).sum(-1), 1e-18)
    share = (((points - start) * along).sum(-1) / length).clip(0, 1)
    found = np.zeros((*share.shape, 3))
    found[..., first], found[..., last] = 1 - share, share
    return found
