"""Volumes of ten parts of a body; cut openings are closed by triangle fans.

Parts are read off the skinning weights, so any body of 22 joints has them.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.model import BodyModel
from recon.core.struct import TensorStruct

PARTS = (
    "head", "torso", "left_upper_arm", "right_upper_arm", "left_forearm", "right_forearm",
    "left_thigh", "right_thigh", "left_lower_leg", "right_lower_leg",
)  # fmt: skip
"""A forearm includes its hand, a lower leg its foot (HUMOS, IPMAN)."""

PART_OF_JOINT = (1, 6, 7, 1, 8, 9, 1, 8, 9, 1, 8, 9, 0, 1, 1, 0, 2, 3, 4, 5, 4, 5)
"""Part that each joint moves: the neck belongs to the head, hip joints to the thighs, pelvis,
spine and collars to the torso, shoulder joints to the upper arms."""


@dataclass(frozen=True)
class Parts(TensorStruct):
    """The part of every vertex and face, and the open edges between parts."""

    of_vertex: Int[Tensor, " vertices"]
    """Part whose joints carry most of the vertex."""
    faces: Int[Tensor, "faces 3"]
    of_face: Int[Tensor, " faces"]
    """Part of most corners; the parts tile the surface."""
    open_edges: Int[Tensor, "edges 2"]
    """Edges of a part that no other face of it shares, in the order of its own face."""
    loop_of_edge: Int[Tensor, " edges"]
    """Closed loop that each open edge belongs to."""
    part_of_loop: Int[Tensor, " loops"]
    skin: Float[Tensor, " vertices"]
    """Share of every vertex in the skin of its part, of the average body."""

    @classmethod
    def of(cls, body: BodyModel) -> "Parts":
        """Parts of a body; made once for each body and kept.

        Raises:
            ValueError: when a part has no face, so that it has no volume.
        """
        if body.template not in _KNOWN:
            _KNOWN[body.template] = _parts(body)
        return _KNOWN[body.template]

    @classmethod
    def of_labels(
        cls,
        template: Float[Tensor, "vertices 3"],
        faces: Int[Tensor, "faces 3"],
        of_vertex: Int[Tensor, " vertices"],
    ) -> "Parts":
        """Parts of any closed surface, given the part of every vertex."""
        of_face = of_vertex[faces].mode(-1).values
        edges, owner = _open_edges(faces, of_face, len(template))
        loop, part_of_loop = _loops(edges, owner, len(template))
        areas = vertex_areas(template, faces)
        whole = areas.new_zeros(len(PARTS)).index_add(0, of_vertex, areas)
        skin = areas / whole[of_vertex]
        return cls(of_vertex, faces, of_face, edges, loop, part_of_loop, skin)


_KNOWN: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def part_volumes(
    vertices: Float[Tensor, "*batch vertices 3"], parts: Parts
) -> Float[Tensor, "*batch 10"]:
    """Volume of every part, m³, differentiable in the vertices.

    Each open loop is closed by a fan of triangles about the mean of its vertices, then
    V = |Σ det[a, b, c]| / 6 about the mean vertex of the part. Two parts that share a loop share
    its fan, so the volumes add up to that of the body (HUMOS appendix S.1).
    """
    means = group_means(vertices, parts.of_vertex, len(PARTS))
    edges = _corners(vertices, parts.open_edges)
    # every vertex of a loop begins exactly one of its edges
    centres = group_means(edges[..., 0, :], parts.loop_of_edge, len(parts.part_of_loop))
    of_edge = parts.part_of_loop[parts.loop_of_edge]
    apex = centres.index_select(-2, parts.loop_of_edge)
    fan = torch.stack((apex, edges[..., 1, :], edges[..., 0, :]), -2)
    triangles = torch.cat((_corners(vertices, parts.faces), fan), -3)
    owner = torch.cat((parts.of_face, of_edge))
    a, b, c = (triangles - means.index_select(-2, owner)[..., None, :]).unbind(-2)
    solid = (a * torch.linalg.cross(b, c, dim=-1)).sum(-1) / 6
    empty = solid.new_zeros(*solid.shape[:-1], len(PARTS))
    return empty.index_add(-1, owner, solid).abs()


def group_means(
    points: Float[Tensor, "*batch points 3"], group: Int[Tensor, " points"], groups: int
) -> Float[Tensor, "*batch groups 3"]:
    """Mean point of every group; the origin for a group without points."""
    sums = points.new_zeros(*points.shape[:-2], groups, 3).index_add(-2, group, points)
    return sums / torch.bincount(group, minlength=groups).clamp(min=1)[:, None]


def _corners(vertices: Tensor, faces: Int[Tensor, "faces corners"]) -> Tensor:
    # its backward pass is cheaper than that of vertices[..., faces, :]
    return vertices.index_select(-2, faces.flatten()).unflatten(-2, tuple(faces.shape))


def vertex_areas(
    vertices: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"]
) -> Float[Tensor, " vertices"]:
    """Surface that belongs to every vertex: a third of each of its faces, m²."""
    a, b, c = vertices[faces].unbind(-2)
    area = torch.linalg.cross(b - a, c - a, dim=-1).norm(dim=-1) / 6
    return vertices.new_zeros(len(vertices)).index_add(
        0, faces.flatten(), area.repeat_interleave(3)
    )


def _parts(body: BodyModel) -> Parts:
    part = torch.tensor(PART_OF_JOINT, device=body.template.device)
    belonging = torch.nn.functional.one_hot(part, len(PARTS)).to(body.weights)
    parts = Parts.of_labels(body.template, body.faces, (body.weights @ belonging).argmax(-1))
    missing = [PARTS[p] for p in range(len(PARTS)) if not (parts.of_face == p).any()]
    if missing:
        raise ValueError(
            f"body {body.name!r} has no surface at its {', '.join(missing)}; masses need a body "
            "whose mesh covers all ten parts: load a body with faces"
        )
    return parts


def _open_edges(faces: Tensor, part: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Directed edges whose reverse is in no face of the same part, and the part of each."""
    edges = torch.cat([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    owner = part.repeat(3)
    forward = (owner * count + edges[:, 0]) * count + edges[:, 1]
    reverse = (owner * count + edges[:, 1]) * count + edges[:, 0]
    is_open = ~torch.isin(forward, reverse)
    return edges[is_open], owner[is_open]


def _loops(edges: Tensor, owner: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Loop of every open edge, and part of every loop."""
    # one node per part and vertex, so that loops of neighbouring parts stay apart
    names, place = torch.unique(owner[:, None] * count + edges, return_inverse=True)
    first = torch.arange(len(names), device=edges.device)
    while True:
        # connected components by pointer jumping: every node takes the least label of its
        # neighbours;
        # importing a graph library would take longer than this computation
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
    return loop, owner.new_zeros(len(roots)).scatter(0, loop, owner)
