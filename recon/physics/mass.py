"""Masses, centre of mass, its acceleration, and the rate of angular momentum.

A skinned vertex is linear in the bones, v = A_t u_v, so sums over all vertices of a body need no
vertex: Σ m v aᵀ = A_t (Σ m u uᵀ) A''_tᵀ.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.model import BodyModel, PosedBody
from recon.body.parts import PARTS, Parts, part_volumes
from recon.core.struct import TensorStruct

GRAVITY = 9.81
"""m/s², downward."""
SPAN = 1 / 20
"""Seconds between the samples of a second difference: the frame time of HUMOS."""

DE_LEVA = (0.0681, 0.4302, 0.0263, 0.0263, 0.0209, 0.0209, 0.1447, 0.1447, 0.059, 0.059)
"""Share of every part in the body's mass, mean of women and men (de Leva 1996, table 4)."""


@dataclass(frozen=True)
class Dynamics(TensorStruct):
    """The motion of the body's mass, in the frames that have a neighbour on both sides."""

    mass: Float[Tensor, "*batch"]
    """kg, or 1 where only the distribution of mass is known; it cancels out of the ZMP."""
    centre: Float[Tensor, "*batch inner 3"]
    """Centre of mass G, metres."""
    acceleration: Float[Tensor, "*batch inner 3"]
    """Acceleration of the centre of mass, m/s²."""
    spin: Float[Tensor, "*batch inner 3"]
    """Rate of angular momentum about G, Σ m (v - G) × a, N m."""


def difference_step(fps: float) -> int:
    """Frames between the samples of a second difference: 1/20 s, at least one frame."""
    return max(1, round(fps * SPAN))


def second_differences(
    values: Float[Tensor, "*batch time rows columns"], fps: float
) -> Float[Tensor, "*batch inner rows columns"]:
    """(x[t+s] - 2 x[t] + x[t-s]) / (s dt)² with s dt of 1/20 s at any rate; none at the ends.

    A fixed span keeps the noise of fast recordings out: 1 mm of it is 1 m/s² at 20 Hz and
    25 m/s² at 100 Hz.
    """
    step = difference_step(fps)
    last = values.shape[-3]
    before = values[..., : max(last - 2 * step, 0), :, :]
    after = values[..., 2 * step :, :, :]
    return (after - 2 * inner(values, fps) + before) * (fps / step) ** 2


def inner(
    values: Float[Tensor, "*batch time rows columns"], fps: float
) -> Float[Tensor, "*batch inner rows columns"]:
    """Values in the frames where second differences exist."""
    step = difference_step(fps)
    return values[..., step : max(values.shape[-3] - step, step), :, :]


def body_dynamics(
    posed: PosedBody, masses: Float[Tensor, "*batch vertices"], fps: float
) -> Dynamics:
    """Dynamics of all vertices of a body, without computing one.

    With bones A_t = [R_j | s_j] and the second moments S = Σ m u uᵀ of u = [w_vj (x_v, 1)]:
    Σ m v aᵀ = A S A''ᵀ, whose skew part less that of M G a_Gᵀ is the rate of angular momentum.
    Exact for linear blend skinning; pose-dependent offsets (SMPL files) are left out.

    Args:
        posed: The body in every frame.
        masses: Of its vertices, see `vertex_masses`.
        fps: Frames per second.
    """
    total = masses.sum(-1)
    moments = mass_moments(posed, masses / total[..., None])
    bones = _bones(posed)
    bends, places = second_differences(bones, fps), inner(bones, fps)
    first = _first_moment(moments)
    centre, acceleration = (places @ first)[..., 0], (bends @ first)[..., 0]
    product = places @ moments[..., None, :, :] @ bends.mT
    product = product - centre[..., :, None] * acceleration[..., None, :]
    skew = product - product.mT
    spin = torch.stack((skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1]), -1)
    return Dynamics(total, centre, acceleration, total[..., None, None] * spin)


def centre_of_mass(
    posed: PosedBody, masses: Float[Tensor, "*batch vertices"]
) -> Float[Tensor, "*batch time 3"]:
    """Centre of mass in every frame, metres; of all vertices, without computing one."""
    moments = mass_moments(posed, masses / masses.sum(-1, keepdim=True))
    return (_bones(posed) @ _first_moment(moments))[..., 0]


def vertex_masses(
    body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> Float[Tensor, "*batch vertices"]:
    """Share of every vertex in the body's mass: its part's volume, spread evenly over its skin.

    m_v = V_part a_v / Σ_part a / Σ V. Volumes are those of the rest pose of this shape; the
    spread within a part is that of the average body.
    """
    return _spread(body, part_volumes(body.rest_vertices(shape), Parts.of(body)))


def vertex_masses_as_published(
    vertices: Float[Tensor, "*batch vertices 3"], parts: Parts
) -> Float[Tensor, "*batch vertices"]:
    """V_part / N_part for each of the N_part vertices of a part, as released by HUMOS; sums to 1.

    Densely meshed skin (face, fingers) counts more than it weighs.

    Args:
        vertices: Of the first frame, metres.
        parts: Of the body.
    """
    volumes = part_volumes(vertices, parts)
    count = torch.bincount(parts.of_vertex, minlength=len(PARTS))
    return (volumes / volumes.sum(-1, keepdim=True) / count)[..., parts.of_vertex]


def vertex_masses_of_segments(body: BodyModel) -> Float[Tensor, " vertices"]:
    """Masses by the shares that de Leva measured, which know that a trunk is partly air."""
    return _spread(body, body.template.new_tensor(DE_LEVA))


def mass_moments(
    posed: PosedBody, masses: Float[Tensor, "*batch vertices"]
) -> Float[Tensor, "*batch 88 88"]:
    """S = Σ m u uᵀ over all vertices, u = [w_vj (x_v, 1)] for the 22 bones j."""
    rest = posed.model.rest_vertices(posed.shape)
    pairs, weights = _bone_pairs(posed.model)
    place = torch.cat((rest, torch.ones_like(rest[..., :1])), -1)
    squares = (masses[..., None, None] * place[..., None] * place[..., None, :]).flatten(-2)
    blocks = weights @ squares
    bones = posed.model.weights.shape[-1]
    table = blocks.new_zeros(*blocks.shape[:-2], bones * bones, 16)
    table = table.index_add(-2, pairs, blocks).unflatten(-1, (4, 4)).unflatten(-3, (bones, bones))
    return table.transpose(-3, -2).flatten(-2).flatten(-3, -2)


def _first_moment(moments: Tensor) -> Tensor:
    """Σ m u as a column: a vertex' weights sum to one, so the fourth entries of u do."""
    return moments.unflatten(-1, (-1, 4))[..., 3].sum(-1)[..., None, :, None]


def _bones(posed: PosedBody) -> Float[Tensor, "*batch time 3 88"]:
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


def _spread(body: BodyModel, of_part: Tensor) -> Tensor:
    parts = Parts.of(body)
    return (of_part / of_part.sum(-1, keepdim=True))[..., parts.of_vertex] * parts.skin
