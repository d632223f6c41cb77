"""Normals of a mesh at its vertices, as arrays and as tensors."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor


def vertex_normals(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, "vertices 3"]:
    """Unit normals: the mean of the adjacent faces' normals, weighted by area."""
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


def tensor_normals(
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
