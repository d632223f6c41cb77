"""A CPU rasteriser: which face of a mesh every pixel shows, and its depth.

OpenCV's rasteriser does the work. It draws what a pinhole camera sees; corners are therefore given
to it at the places where a camera of 90 degrees sees them at the asked pixels, so that lenses with
distortion and parallel projections are drawn as well.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_SLACK = 1e-3
"""Share of its depth by which the drawn range reaches beyond the nearest and the farthest corner.
The range is kept this tight because depths are single-precision shares of it."""


@dataclass(frozen=True)
class Raster:
    """A drawn picture: depth of the nearest face and interpolated values at every pixel."""

    depth: Float[np.ndarray, "height width"]
    """Depth of the nearest face; infinity where there is none."""
    values: Float[np.ndarray, "height width 3"]
    """Values of the face's corners, interpolated over the face; 0 where there is none."""

    @cached_property
    def covered(self) -> Bool[np.ndarray, "height width"]:
        """Mask of the pixels that show a face of the mesh."""
        return np.isfinite(self.depth)


def rasterise(
    pixels: Float[np.ndarray, "vertices 2"],
    depth: Float[np.ndarray, " vertices"],
    faces: Int[np.ndarray, "faces 3"],
    size: tuple[int, int],
    values: Float[np.ndarray, "vertices 3"] | None = None,
) -> Raster:
    """Draw the faces whose corners run counter-clockwise seen by the viewer (y points down).

    `depth` is positive at every corner that a face uses; it and `values` are interpolated linearly
    in space, not in the picture. The centre of the first pixel is (0.5, 0.5). Without `values`
    those of the result are 0.
    """
    width, height = size
    nothing = Raster(
        np.full((height, width), np.inf, np.float32), np.zeros((height, width, 3), np.float32)
    )
    if len(faces) == 0:
        return nothing
    near, far = (float(end(depth[faces])) for end in (np.min, np.max))
    if not near > 0:
        raise ValueError(f"faces must lie in front of the viewer, got depths from {near:.3g} on")
    beyond = (1 + _SLACK / 2) * far  # pixels deeper than this show no face
    near, far = (1 - _SLACK) * near, (1 + _SLACK) * far

    corners = np.empty((len(pixels), 3), np.float32)
    corners[:, 0] = (pixels[:, 0] - width / 2) * depth * (2 / height)
    corners[:, 1] = (height / 2 - pixels[:, 1]) * depth * (2 / height)
    corners[:, 2] = -depth
    drawn = np.ascontiguousarray(faces, np.int32)
    buffer = np.full((height, width), far, np.float32)
    camera = (np.eye(4, dtype=np.float32), math.pi / 2, near, far)
    settings = cv2.TriangleRasterizeSettings().setCullingMode(cv2.RASTERIZE_CULLING_CW)
    if values is None:
        cv2.triangleRasterizeDepth(corners, drawn, buffer, *camera, settings)
    else:
        settings = settings.setShadingType(cv2.RASTERIZE_SHADING_SHADED)
        shades = np.ascontiguousarray(values, np.float32)
        cv2.triangleRasterize(corners, drawn, shades, nothing.values, buffer, *camera, settings)
    buffer[buffer > beyond] = np.inf
    return Raster(buffer, nothing.values)


def vertex_normals(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, "vertices 3"]:
    """Return unit normals of vertices: adjacent faces' normals, averaged by area."""
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    normal = np.cross(b - a, c - a)
    total = np.stack(
        [
            np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), len(vertices))
            for axis in range(3)
        ],
        1,
    )
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def differentiable_normals(
    vertices: Float[Tensor, "vertices 3"], faces: Tensor
) -> Float[Tensor, "vertices 3"]:
    """Unit normals of vertices, differentiable; a vertex of faces without area gets the y axis."""
    corners = vertices[faces]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = torch.zeros_like(vertices)
    for corner in range(3):
        total.index_add_(0, faces[:, corner], normal)
    length = total.norm(dim=-1, keepdim=True)
    vertical = torch.tensor([0.0, 1.0, 0.0]).to(vertices)
    return torch.where(length > 1e-12, total / length.clamp(min=1e-12), vertical)


def are_facing_eye(
    middles: Float[Tensor, "*batch discs 3"],
    normals: Float[Tensor, "*batch discs 3"],
    eye: Float[Tensor, "*batch 3"],
) -> Bool[Tensor, "*batch discs"]:
    """Return a mask of the surface discs whose outward normal points towards the eye."""
    return ((eye[..., None, :] - middles) * normals).sum(-1) >= 0
