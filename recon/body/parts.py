"""Ten parts of a body, the part that every vertex of the skin belongs to, and their masses.

Parts are read off the skinning weights, so any body of 22 joints has them.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.model import BodyModel, PosedBody
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
    """The body part of every vertex, and the vertex's share of this part's skin area."""

    of_vertex: Int[Tensor, " vertices"]
    """Number of the part whose joints have most of the vertex's skinning weight."""
    faces: Int[Tensor, "faces 3"]
    skin: Float[Tensor, " vertices"]
    """Each vertex's share of the skin area of its part, on the average body."""

    @classmethod
    def of(cls, body: BodyModel) -> "Parts":
        """Split a body into ten parts by its skinning weights; cached per body.

        Raises:
            ValueError: when a part has no face, so that it has no volume.
        """
        if body.template in _KNOWN:
            return _KNOWN[body.template]
        part = torch.tensor(PART_OF_JOINT, device=body.template.device)
        belonging = torch.nn.functional.one_hot(part, len(PARTS)).to(body.weights)
        of_vertex = (body.weights @ belonging).argmax(-1)
        of_face = of_vertex[body.faces].mode(-1).values
        if missing := [PARTS[p] for p in range(len(PARTS)) if not (of_face == p).any()]:
            raise ValueError(
                f"body {body.name!r} has no surface at its {', '.join(missing)}; masses need a "
                "body whose mesh covers all ten parts: load a body with faces"
            )
        _KNOWN[body.template] = cls.of_labels(body.template, body.faces, of_vertex)
        return _KNOWN[body.template]

    @classmethod
    def of_labels(
        cls,
        template: Float[Tensor, "vertices 3"],
        faces: Int[Tensor, "faces 3"],
        of_vertex: Int[Tensor, " vertices"],
    ) -> "Parts":
        """Build the parts of a closed surface from the part number of every vertex."""
        areas = vertex_areas(template, faces)
        whole = areas.new_zeros(len(PARTS)).index_add(0, of_vertex, areas)
        return cls(of_vertex, faces, areas / whole[of_vertex])


_KNOWN: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def vertex_areas(
    vertices: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"]
) -> Float[Tensor, " vertices"]:
    """Return the surface area of every vertex: a third of its adjacent faces' area, m²."""
    a, b, c = vertices[faces].unbind(-2)
    area = torch.linalg.cross(b - a, c - a, dim=-1).norm(dim=-1) / 6
    return vertices.new_zeros(len(vertices)).index_add(
        0, faces.flatten(), area.repeat_interleave(3)
    )


def farthest_points(
    points: Float[Tensor, "points 3"], seeds: Int[Tensor, " seeds"], count: int
) -> Int[Tensor, " count"]:
    """Farthest point sampling: return indices of `count` points, the given seeds first."""
    distance = torch.cdist(points, points[seeds]).amin(-1)
    chosen = seeds.tolist()
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = distance.minimum((points - points[chosen[-1]]).norm(dim=-1))
    return torch.tensor(chosen, device=points.device)


GRAVITY = 9.81
"""m/s², downward."""
DE_LEVA = (0.0681, 0.4302, 0.0263, 0.0263, 0.0209, 0.0209, 0.1447, 0.1447, 0.059, 0.059)
"""Share of every part in the body's mass, mean of women and men (de Leva 1996, table 4)."""


def centre_of_mass(
    posed: PosedBody, masses: Float[Tensor, "*batch vertices"]
) -> Float[Tensor, "*batch time 3"]:
    """Centre of mass in every frame, metres, from the bones without computing vertices.

    A skinned vertex is linear in the bones, v = Σ_j w_vj B_j (x_v, 1), and so is the weighted sum
    of all: Σ_v m_v v = Σ_j B_j Σ_v m_v w_vj (x_v, 1).
    """
    rest = posed.model.rest_vertices(posed.shape)
    place = torch.cat((rest, torch.ones_like(rest[..., :1])), -1)
    shares = masses / masses.sum(-1, keepdim=True)
    first = posed.model.weights.mT @ (shares[..., None] * place)
    return torch.einsum("...tjka,...jk->...ta", posed.bones, first)


def vertex_masses_of_segments(body: BodyModel) -> Float[Tensor, " vertices"]:
    """Return each vertex's share of the body mass, by de Leva's measured segment masses."""
    return spread_over_skin(body, body.template.new_tensor(DE_LEVA))


def spread_over_skin(body: BodyModel, part_masses: Tensor) -> Tensor:
    """Distribute the masses of the ten parts over their vertices; the results sum to one."""
    parts = Parts.of(body)
    return (part_masses / part_masses.sum(-1, keepdim=True))[..., parts.of_vertex] * parts.skin
