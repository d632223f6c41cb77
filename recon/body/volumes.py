"""Volumes of the parts of a body; cut openings are closed by triangle fans."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.parts import PARTS, Parts


@dataclass(frozen=True)
class Openings:
    """The body part of every face, and the loops of open edges at which parts are cut."""

    of_face: Int[Tensor, " faces"]
    """Part that most of the face's corners belong to."""
    edges: Int[Tensor, "edges 2"]
    """Edges that only one face of their part has, in the direction of this face."""
    loop_of_edge: Int[Tensor, " edges"]
    """Closed loop that each edge belongs to."""
    part_of_loop: Int[Tensor, " loops"]

    @classmethod
    def of(cls, parts: Parts) -> "Openings":
        """Find the loops of open edges that remain when a closed surface is cut into parts."""
        of_face, count = parts.of_vertex[parts.faces].mode(-1).values, len(parts.of_vertex)
        edges, owner = _open_edges(parts.faces, of_face, count)
        return cls(of_face, edges, *_loops_of_edges(edges, owner, count))


_KNOWN: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def part_volumes(
    vertices: Float[Tensor, "*batch vertices 3"], parts: Parts
) -> Float[Tensor, "*batch 10"]:
    """Volume of every part, m³, differentiable in the vertices.

    Each open loop is closed by a fan of triangles about the mean of its vertices, then
    V = |Σ det[a, b, c]| / 6 about the mean vertex of the part. Two parts that share a loop share
    its fan, so the volumes add up to that of the body (HUMOS appendix S.1).
    """
    means = _group_means(vertices, parts.of_vertex, len(PARTS))
    if parts.of_vertex not in _KNOWN:
        _KNOWN[parts.of_vertex] = Openings.of(parts)
    openings = _KNOWN[parts.of_vertex]
    edges = _corners_of_faces(vertices, openings.edges)
    # each vertex of a loop is the start of one edge: the mean of starts is the mean of vertices
    centres = _group_means(edges[..., 0, :], openings.loop_of_edge, len(openings.part_of_loop))
    of_edge = openings.part_of_loop[openings.loop_of_edge]
    apex = centres.index_select(-2, openings.loop_of_edge)
    fan = torch.stack((apex, edges[..., 1, :], edges[..., 0, :]), -2)
    triangles = torch.cat((_corners_of_faces(vertices, parts.faces), fan), -3)
    owner = torch.cat((openings.of_face, of_edge))
    a, b, c = (triangles - means.index_select(-2, owner)[..., None, :]).unbind(-2)
    solid = (a * torch.linalg.cross(b, c, dim=-1)).sum(-1) / 6
    empty = solid.new_zeros(*solid.shape[:-1], len(PARTS))
    return empty.index_add(-1, owner, solid).abs()


def _group_means(
    points: Float[Tensor, "*batch points 3"], group: Int[Tensor, " points"], groups: int
) -> Float[Tensor, "*batch groups 3"]:
    """Mean point of every group; the origin for a group without points."""
    sums = points.new_zeros(*points.shape[:-2], groups, 3).index_add(-2, group, points)
    return sums / torch.bincount(group, minlength=groups).clamp(min=1)[:, None]


def _corners_of_faces(vertices: Tensor, faces: Int[Tensor, "faces corners"]) -> Tensor:
    # the backward pass of index_select takes less time than that of vertices[..., faces, :]
    return vertices.index_select(-2, faces.flatten()).unflatten(-2, tuple(faces.shape))


def _open_edges(faces: Tensor, part: Tensor, vertex_count: int) -> tuple[Tensor, Tensor]:
    """Return the directed edges whose reverse is in no face of their part, and their parts."""
    edges = torch.cat([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    owner = part.repeat(3)
    forward = (owner * vertex_count + edges[:, 0]) * vertex_count + edges[:, 1]
    reverse = (owner * vertex_count + edges[:, 1]) * vertex_count + edges[:, 0]
    is_open = ~torch.isin(forward, reverse)
    return edges[is_open], owner[is_open]


def _loops_of_edges(edges: Tensor, part: Tensor, vertex_count: int) -> tuple[Tensor, Tensor]:
    """Group open edges into closed loops; return each edge's loop and each loop's part."""
    # one node per part and vertex, so that loops of neighbouring parts stay apart
    nodes, place = torch.unique(part[:, None] * vertex_count + edges, return_inverse=True)
    first = torch.arange(len(nodes), device=edges.device)
    while True:
        # connected components by pointer jumping: nodes take the least label of their neighbours
        least = first[place].amin(-1)
        lower = first.clone()
        for end in range(2):
            lower.scatter_reduce_(0, place[:, end], least, "amin")
        lower = lower[lower]
        if torch.equal(lower, first):
            break
        first = lower
    roots, loop_of_node = torch.unique(first, return_inverse=True)
    loop = loop_of_node[place[:, 0]]
    return loop, part.new_zeros(len(roots)).scatter(0, loop, part)
