"""Triangles to pixels on the processor, in numpy: which face each pixel sees, and how near.

Open3D's ray caster would serve as well, but its import needs system libraries (libGL, libX11,
libusb) that servers and slim containers lack; a picture should never fail for want of those.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Raster:
    """The face, depth and place of one mesh that every pixel of a picture shows."""

    face: Int[np.ndarray, "height width"]
    """Index of the face; -1 where there is none."""
    barycentric: Float[np.ndarray, "height width 3"]
    """Weights of the face's corners, linear in the picture (faces are a few pixels wide)."""
    nearness: Float[np.ndarray, "height width"]
    """Interpolated nearness; -inf where there is no face."""


def rasterise(
    pixels: Float[np.ndarray, "vertices 2"],
    nearness: Float[np.ndarray, " vertices"],
    faces: Int[np.ndarray, "faces 3"],
    size: tuple[int, int],
) -> Raster:
    """Draw the faces whose corners run counter-clockwise seen by the viewer (y points down).

    `nearness` is interpolated linearly in the picture and the largest wins: 1 / depth for a
    pinhole camera, minus the distance for parallel rays.
    """
    width, height = size
    corners = pixels[faces].astype(np.float64)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = _cross(b - a, c - a)
    low = np.clip(np.ceil(corners.min(1) - 0.5), 0, (width, height)).astype(np.int64)
    high = np.clip(np.floor(corners.max(1) - 0.5) + 1, 0, (width, height)).astype(np.int64)
    extent = np.maximum(high - low, 0)
    drawn = np.flatnonzero((area < -1e-12) & (extent.prod(1) > 0))

    # One row per pixel of every face's bounding box.
    count = extent[drawn].prod(1)
    face = np.repeat(drawn, count)
    place = np.arange(len(face)) - np.repeat(count.cumsum() - count, count)
    across = extent[face, 0]
    x, y = low[face, 0] + place % across, low[face, 1] + place // across
    point = np.stack([x, y], 1) + 0.5
    first = _cross(b[face] - point, c[face] - point) / area[face]
    second = _cross(c[face] - point, a[face] - point) / area[face]
    third = 1 - first - second
    inside = np.flatnonzero(np.minimum(np.minimum(first, second), third) >= -1e-9)
    face, x, y = face[inside], x[inside], y[inside]
    weights = np.stack([first[inside], second[inside], third[inside]], 1)
    near = np.einsum("nk,nk->n", weights, nearness[faces[face]])

    # Painted from far to near: of equal indices numpy keeps the last.
    order = np.argsort(near, kind="stable")
    x, y = x[order], y[order]
    seen = np.full((height, width), -1, np.int64)
    barycentric = np.zeros((height, width, 3))
    buffer = np.full((height, width), -np.inf)
    seen[y, x], barycentric[y, x], buffer[y, x] = face[order], weights[order], near[order]
    return Raster(seen, barycentric, buffer)


def _cross(u: Float[np.ndarray, "n 2"], v: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
