"""Masses of a body's vertices, and the centre of mass.

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
    """Centre of mass in every frame, metres; of all vertices, without computing one."""
    rest = posed.model.rest_vertices(posed.shape)
    place = torch.cat((rest, torch.ones_like(rest[..., :1])), -1)
    shares = masses / masses.sum(-1, keepdim=True)
    first = posed.model.weights.mT @ (shares[..., None] * place)
    return torch.einsum("...tjka,...jk->...ta", posed.bones, first)


def vertex_masses_of_segments(body: BodyModel) -> Float[Tensor, " vertices"]:
    """Masses by de Leva's measured segment shares, which account for the air in the trunk."""
    return spread_over_skin(body, body.template.new_tensor(DE_LEVA))


def spread_over_skin(body: BodyModel, of_part: Tensor) -> Tensor:
    """Masses of vertices from those of the ten parts; they sum to one."""
    parts = Parts.of(body)
    return (of_part / of_part.sum(-1, keepdim=True))[..., parts.of_vertex] * parts.skin
