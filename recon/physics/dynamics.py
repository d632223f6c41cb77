"""Acceleration of a body's centre of mass, and the rate of its angular momentum.

A skinned vertex is linear in the bones, v = A_t u_v, so sums over all vertices of a body need no
vertex: Σ m v aᵀ = A_t (Σ m u uᵀ) A''_tᵀ.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from recon.body.model import BodyModel, PosedBody
from recon.body.parts import PARTS, Parts, spread_over_skin
from recon.body.volumes import part_volumes
from recon.core.struct import TensorStruct

SPAN = 1 / 20
"""Seconds between the samples of a second difference: the frame time of HUMOS."""


@dataclass(frozen=True)
class Dynamics(TensorStruct):
    """Mass, centre of mass, its acceleration and rate of angular momentum; no end frames."""

    mass: Float[Tensor, "*batch"]
    """kg, or 1 where only the distribution of mass is known; it cancels out of the ZMP."""
    centre: Float[Tensor, "*batch inner 3"]
    """Centre of mass G, metres."""
    acceleration: Float[Tensor, "*batch inner 3"]
    """Acceleration of the centre of mass, m/s²."""
    spin: Float[Tensor, "*batch inner 3"]
    """Rate of angular momentum about G, Σ m (v - G) × a, N m."""


def difference_step(fps: float) -> int:
    """Return the number of frames in 1/20 s, at least one: the step of second differences."""
    return max(1, round(fps * SPAN))


def second_differences(
    values: Float[Tensor, "*batch time rows columns"], fps: float
) -> Float[Tensor, "*batch inner rows columns"]:
    """Accelerations (x[t+s] - 2 x[t] + x[t-s]) / (s dt)², s dt about 1/20 s; none at the ends.

    A fixed span keeps the noise of fast recordings out: 1 mm of it is 1 m/s² at 20 Hz and
    25 m/s² at 100 Hz.
    """
    step = difference_step(fps)
    last = values.shape[-3]
    before = values[..., : max(last - 2 * step, 0), :, :]
    after = values[..., 2 * step :, :, :]
    return (after - 2 * inner_frames(values, fps) + before) * (fps / step) ** 2


def inner_frames(
    values: Float[Tensor, "*batch time rows columns"], fps: float
) -> Float[Tensor, "*batch inner rows columns"]:
    """Cut off first and last frames, in which second differences do not exist."""
    step = difference_step(fps)
    return values[..., step : max(values.shape[-3] - step, step), :, :]


def body_dynamics(
    posed: PosedBody, masses: Float[Tensor, "*batch vertices"], fps: float
) -> Dynamics:
    """Dynamics of a body's mass, from its bones, without computing vertices.

    With bones side by side, A_t = [R_j | s_j], and the second moments S = Σ m u uᵀ of
    u = [w_vj (x_v, 1)]: Σ m v aᵀ = A S A''ᵀ, whose skew part less that of M G a_Gᵀ is the rate
    of angular momentum.
    Exact for linear blend skinning; pose-dependent offsets (SMPL files) are left out.

    Args:
        posed: The body in every frame.
        masses: Of its vertices, see `vertex_masses`.
        fps: Frames per second.
    """
    total = masses.sum(-1)
    moments = _mass_moments(posed.model, posed.shape, masses / total[..., None])
    return _dynamics_of_moments(posed, total, moments, fps)


_AVERAGE: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def average_dynamics(posed: PosedBody, fps: float) -> Dynamics:
    """Dynamics of mass 1 spread over the joints' segments as on the average body.

    The moments of mass are then the same for all shapes, made once and kept: the volumes of a
    shape's parts and their derivatives cost several times what all else of `body_dynamics` does.
    """
    model = posed.model
    if model.weights not in _AVERAGE:
        zero = model.template.new_zeros(model.shape_size)
        _AVERAGE[model.weights] = _mass_moments(model, zero, vertex_masses(model, zero))
    moments = _AVERAGE[model.weights].expand(*posed.rest.shape[:-2], -1, -1)
    average = replace(posed, rest=model.joint_template.expand_as(posed.rest))
    return _dynamics_of_moments(average, moments.new_ones(moments.shape[:-2]), moments, fps)


def _dynamics_of_moments(posed: PosedBody, total: Tensor, moments: Tensor, fps: float) -> Dynamics:
    """Compute `Dynamics` from the posed bones and the second moments of the body's mass."""
    bones = posed.bones.flatten(-3, -2).mT.contiguous()
    accelerations, places = second_differences(bones, fps), inner_frames(bones, fps)
    # Σ m u out of Σ m u uᵀ: every 4th entry of u is a skinning weight, and these sum to one
    first_moment = moments.unflatten(-1, (-1, 4))[..., 3].sum(-1)[..., None, :, None]
    centre, acceleration = (places @ first_moment)[..., 0], (accelerations @ first_moment)[..., 0]
    product = places @ moments[..., None, :, :] @ accelerations.mT
    product = product - centre[..., :, None] * acceleration[..., None, :]
    skew = product - product.mT
    spin = torch.stack((skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1]), -1)
    return Dynamics(total, centre, acceleration, total[..., None, None] * spin)


def _mass_moments(
    body: BodyModel, shape: Float[Tensor, "*batch shape"], masses: Float[Tensor, "*batch vertices"]
) -> Float[Tensor, "*batch 88 88"]:
    """Return second moments of mass, Σ m u uᵀ over vertices, u = [w_vj (x_v, 1)] by bone j."""
    rest = body.rest_vertices(shape)
    pairs, weights = _bone_pairs(body)
    place = torch.cat((rest, torch.ones_like(rest[..., :1])), -1)
    squares = (masses[..., None, None] * place[..., None] * place[..., None, :]).flatten(-2)
    blocks = weights @ squares
    bones = body.weights.shape[-1]
    table = blocks.new_zeros(*blocks.shape[:-2], bones * bones, 16)
    table = table.index_add(-2, pairs, blocks).unflatten(-1, (4, 4)).unflatten(-3, (bones, bones))
    return table.transpose(-3, -2).flatten(-2).flatten(-3, -2)


_PAIRS: WeakTensorKeyDictionary = WeakTensorKeyDictionary()


def _bone_pairs(body: BodyModel) -> tuple[Int[Tensor, " pairs"], Float[Tensor, "pairs vertices"]]:
    """Return pairs 22 j + k of bones with common vertices, and products of their weights."""
    if body.weights not in _PAIRS:
        touching = (body.weights > 0).to(body.weights)
        first, second = (touching.mT @ touching).nonzero(as_tuple=True)
        shared = (body.weights[:, first] * body.weights[:, second]).mT.contiguous()
        _PAIRS[body.weights] = (first * body.weights.shape[-1] + second, shared)
    return _PAIRS[body.weights]


def vertex_masses(
    body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> Float[Tensor, "*batch vertices"]:
    """Each vertex's share of the body's mass: its part's volume, spread evenly over the skin.

    m_v = V_part a_v / Σ_part a / Σ V. Volumes are those of the rest pose of this shape; the
    spread within a part is that of the average body.
    """
    return spread_over_skin(body, part_volumes(body.rest_vertices(shape), Parts.of(body)))


def vertex_masses_as_published(
    vertices: Float[Tensor, "*batch vertices 3"], parts: Parts
) -> Float[Tensor, "*batch vertices"]:
    """Masses as in HUMOS's code: a part's volume by the number of its vertices; sum 1.

    Densely meshed skin (face, fingers) counts more than it weighs.

    Args:
        vertices: Of the first frame, metres.
        parts: Of the body.
    """
    volumes = part_volumes(vertices, parts)
    count = torch.bincount(parts.of_vertex, minlength=len(PARTS))
    return (volumes / volumes.sum(-1, keepdim=True) / count)[..., parts.of_vertex]
