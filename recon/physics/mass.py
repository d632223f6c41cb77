"""Masses of a body's vertices, and the centre of mass.

A skinned vertex is linear in the bones, v = A_t u_v, so sums over all vertices of a body need no
vertex: Σ m v = A_t Σ m u.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

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
    moments = mass_moments(posed.model, posed.shape, masses / masses.sum(-1, keepdim=True))
    return (affine_bones(posed) @ first_moment(moments))[..., 0]


def vertex_masses_of_segments(body: BodyModel) -> Float[Tensor, " vertices"]:
    """Masses by the shares that de Leva measured, which know that a trunk is partly air."""
    return spread_over_skin(body, body.template.new_tensor(DE_LEVA))


def mass_moments(
    body: BodyModel, shape: Float[Tensor, "*batch shape"], masses: Float[Tensor, "*batch vertices"]
) -> Float[Tensor, "*batch 88 88"]:
    """S = Σ m u uᵀ over all vertices, u = [w_vj (x_v, 1)] for the 22 bones j."""
    rest = body.rest_vertices(shape)
    pairs, weights = _bone_pairs(body)
    place = torch.cat((rest, torch.ones_like(rest[..., :1])), -1)
    squares = (masses[..., None, None] * place[..., None] * place[..., None, :]).flatten(-2)
    blocks = weights @ squares
    bones = body.weights.shape[-1]
    table = blocks.new_zeros(*blocks.shape[:-2], bones * bones, 16)
    table = table.index_add(-2, pairs, blocks).unflatten(-1, (4, 4)).unflatten(-3, (bones, bones))
    return table.transpose(-3, -2).flatten(-2).flatten(-3, -2)


def first_moment(moments: Tensor) -> Tensor:
    """Σ m u as a column: a vertex' weights sum to one, so the fourth entries of u do."""
    return moments.unflatten(-1, (-1, 4))[..., 3].sum(-1)[..., None, :, None]


def affine_bones(posed: PosedBody) -> Float[Tensor, "*batch time 3 88"]:
    """The poses [R_j | s_j] of all bones side by side, for points of the unposed surface."""
    shift = posed.joints - (posed.orientations @ posed.rest[..., None, :, :, None])[..., 0]
    bones = torch.cat((posed.orientations, shift[..., None]), -1)
    return bones.transpose(-3, -2).flatten(-2)


_PAIRS: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def _bone_pairs(body: BodyModel) -> tuple[Int[Tensor, " pairs"], Float[Tensor, "pairs vertices"]]:
    """Pairs of bones that share a vertex, as 22 j + k, and w_vj w_vk; made once and kept."""
    if body.weights not in _PAIRS:
        touching = (body.weights > 0).to(body.weights)
        first, second = (touching.mT @ touching).nonzero(as_tuple=True)
        shared = (body.weights[:, first] * body.weights[:, second]).mT.contiguous()
        _PAIRS[body.weights] = (first * body.weights.shape[-1] + second, shared)
    return _PAIRS[body.weights]


def spread_over_skin(body: BodyModel, of_part: Tensor) -> Tensor:
    """Masses of vertices from those of the ten parts; they sum to one."""
    parts = Parts.of(body)
    return (of_part / of_part.sum(-1, keepdim=True))[..., parts.of_vertex] * parts.skin
