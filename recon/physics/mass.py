"""Masses of a body's vertices, and its centre of mass.

A skinned vertex is linear in the bones, v = Σ_j w_vj B_j (x_v, 1), so a sum over all vertices of
a body needs no vertex: Σ m v = Σ_j B_j Σ m w_vj (x_v, 1).
"""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.body.parts import Parts

GRAVITY = 9.81
"""m/s², downward."""
DE_LEVA = (0.0681, 0.4302, 0.0263, 0.0263, 0.0209, 0.0209, 0.1447, 0.1447, 0.059, 0.059)
"""Share of every part in the body's mass, mean of women and men (de Leva 1996, table 4)."""


def centre_of_mass(
    posed: PosedBody, masses: Float[Tensor, "*batch vertices"]
) -> Float[Tensor, "*batch time 3"]:
    """Centre of mass in every frame, metres, from the bones without computing vertices."""
    rest = posed.model.rest_vertices(posed.shape)
    place = torch.cat((rest, torch.ones_like(rest[..., :1])), -1)
    shares = masses / masses.sum(-1, keepdim=True)
    first = posed.model.weights.mT @ (shares[..., None] * place)
    return torch.einsum("...tjka,...jk->...ta", posed.bones, first)


def vertex_masses_of_segments(body: BodyModel) -> Float[Tensor, " vertices"]:
    """Vertex masses by de Leva's measured segment masses, which know of air in the trunk."""
    return spread_over_skin(body, body.template.new_tensor(DE_LEVA))


def spread_over_skin(body: BodyModel, part_masses: Tensor) -> Tensor:
    """Vertex masses from the masses of the ten parts; they sum to one."""
    parts = Parts.of(body)
    return (part_masses / part_masses.sum(-1, keepdim=True))[..., parts.of_vertex] * parts.skin
