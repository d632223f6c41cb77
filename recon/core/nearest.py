"""Nearest neighbours, frame by frame: which point of the body an observed point belongs to."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

_CHUNK = 1 << 24
"""Distances held in memory at once on an accelerator."""


def nearest(
    points: Float[Tensor, "*batch moments points 3"],
    present: Bool[Tensor, "*batch moments points"],
    surface: Float[Tensor, "*batch moments surface 3"],
    allowed: Bool[Tensor, "*batch moments surface"],
) -> Int[Tensor, "*batch moments points"]:
    """Index of the nearest allowed point of the surface of the same moment; no gradient.

    Exact: by a k-d tree for every moment on the processor, by all distances in chunks elsewhere.
    Where a moment allows nothing, everything is allowed; zero where a point is not present.
    """
    allowed = allowed | ~allowed.any(-1, keepdim=True)
    points, surface = points.detach(), surface.detach()
    frames = [
        tensor.flatten(0, -3 if tensor.is_floating_point() else -2)
        for tensor in (points, present, surface, allowed)
    ]
    search = _nearest_by_trees if points.device.type == "cpu" else _nearest_by_distances
    return search(*frames).unflatten(0, points.shape[:-2])


def _nearest_by_trees(points: Tensor, present: Tensor, surface: Tensor, allowed: Tensor) -> Tensor:
    from scipy.spatial import KDTree

    found = np.zeros(present.shape, np.int64)
    rows = zip(points.numpy(), present.numpy(), surface.numpy(), allowed.numpy(), strict=True)
    for row, (seen, here, body, usable) in enumerate(rows):
        if not here.any():
            continue
        candidates = np.flatnonzero(usable)
        # an unbalanced tree is built several times faster and answers almost as fast
        tree = KDTree(body[candidates], balanced_tree=False, compact_nodes=False)
        found[row, here] = candidates[tree.query(seen[here])[1]]
    return torch.from_numpy(found)


def _nearest_by_distances(
    points: Tensor, present: Tensor, surface: Tensor, allowed: Tensor
) -> Tensor:
    found = torch.zeros(present.shape, dtype=torch.long, device=points.device)
    rows = max(1, _CHUNK // max(points.shape[-2] * surface.shape[-2], 1))
    for batch in torch.arange(len(points), device=points.device).split(rows):
        distance = torch.cdist(
            points[batch], surface[batch], compute_mode="donot_use_mm_for_euclid_dist"
        )
        distance = torch.where(allowed[batch][:, None], distance, torch.inf)
        found[batch] = distance.argmin(-1)
    return torch.where(present, found, 0)


_AT_ONCE = 16
"""Moments whose costs are in memory together; so few that they stay in the cache."""


def nearest_alike(
    points: Float[Tensor, "moments points 3"],
    present: Bool[Tensor, "moments points"],
    kinds: Float[Tensor, "moments points kinds"],
    surface: Float[Tensor, "moments surface 3"],
    allowed: Bool[Tensor, "moments surface"],
    surface_kinds: Float[Tensor, "surface kinds"],
) -> Int[Tensor, "moments points"]:
    """Index of the allowed surface point nearest in position and in kind; no gradient.

    Point i costs |p_i - s_j|² + k_i · k_j, with k_i its row of `kinds`: what it costs to be of a
    kind, metres². Where a moment allows nothing, everything is allowed; zero where a point is not
    present.

    Args:
        points: that were seen, metres.
        present: which of them exist.
        kinds: k_i.
        surface: places of the surface at every moment, metres.
        allowed: which of them may be seen.
        surface_kinds: k_j.
    """
    allowed = allowed | ~allowed.any(-1, keepdim=True)
    found = torch.zeros(present.shape, dtype=torch.long, device=points.device)
    moments = present.any(-1).nonzero()[:, 0]
    for first in range(0, len(moments), _AT_ONCE):  # torch would split none into one empty batch
        batch = moments[first : first + _AT_ONCE]
        usable = allowed[batch]
        most = int(usable.sum(-1).max())
        # indices of the allowed points, then those of all others, both in ascending order
        pick = torch.argsort(~usable, dim=-1, stable=True)[:, :most]
        there = surface[batch].gather(1, pick[..., None].expand(*pick.shape, 3)).detach()
        middle = there.mean(1, keepdim=True)  # centred, to keep rounding errors small
        there, here = there - middle, points[batch].detach() - middle
        size = there.square().sum(-1, keepdim=True)
        size = size.masked_fill(~usable.gather(1, pick)[..., None], 1e9)
        left = torch.cat((-2 * here, torch.ones_like(here[..., :1]), kinds[batch]), -1)
        right = torch.cat((there, size, surface_kinds[pick]), -1)
        best = (left @ right.mT).min(-1).indices  # min is several times as fast as argmin
        found[batch] = pick.gather(1, best)
    return torch.where(present, found, 0)


_NEAR = 12
"""Triangles that are tried for every point: those with the nearest centres."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a mesh: position, triangle and barycentric coordinates of each."""

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
    """Return, for each point, the nearest point of a mesh, among triangles of nearest centres.

    On meshes whose triangles are of like size it is the nearest of all.

    Args:
        points: metres.
        vertices: of the surface, metres.
        faces: its triangles, by vertex number.
    """
    from scipy.spatial import KDTree
    from trimesh import triangles

    faces = faces[triangles.nondegenerate(vertices[faces])]
    corners = vertices[faces]
    count = min(_NEAR, len(faces))
    _, near = KDTree(corners.mean(1)).query(points, k=count)
    near = np.asarray(near).reshape(len(points), count)
    places = triangles.closest_point(corners[near.ravel()], points.repeat(count, 0))
    places = places.reshape(len(points), count, 3)
    rows = np.arange(len(points))
    best = np.square(places - points[:, None]).sum(-1).argmin(1)
    near, places = near[rows, best], places[rows, best]
    shares = triangles.points_to_barycentric(corners[near], places)
    return SurfacePoints(faces[near], shares, places)
