"""Energies of contact with the ground z = 0: penetration, floating, sliding, balance.

Sums over frames are scaled to 30 frames per second, as in `recon.method.terms`. Heights are those
of a few hundred vertices (`SampledSurface`), dynamics those of all. Every energy is
continuous with its gradient.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from recon.body.model import PosedBody
from recon.body.parts import PARTS
from recon.body.sampled import SampledSurface
from recon.core.errors import ReconError
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.terms import Term
from recon.physics.dynamics import (
    Dynamics,
    body_dynamics,
    difference_step,
    inner_frames,
    vertex_masses,
)
from recon.physics.zmp import centre_of_pressure, share_carried, smoothstep, zmp

TOLERANCE = 0.005
"""Metres below and above the ground that are neither penetration nor float (HUMOS)."""

SOFTNESS = 0.002
"""Metres over which the lowest point is averaged, so that its gradient does not jump."""

CONTACT_HEIGHT = 0.02
CONTACT_SOFTNESS = 0.005
"""Metres: skin of a sole below the first is in contact, over a transition of the second."""

SLIP_SCALE = 0.5
"""m/s: faster soles are taken for swinging ones and pull less and less."""

BALANCE_SCALE = 0.3
"""Metres: a ZMP farther from the centre of pressure pulls less and less."""

NEAR_GROUND = (0.03, 0.07)
"""Metres: a body whose lowest point is above the second has no ground to push on."""


def penetration(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ_t Σ_parts max(0, -b - 5 mm)², b the lowest point of each of ten parts; metres²."""
    depth = (-lowest_of_parts(estimate) - TOLERANCE).clamp(min=0).square().sum(-1)
    return 0.5 * _sum_over_frames(depth, estimate)


def floating(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ_t w_t max(0, b_t - 5 mm)², b the lowest point, w from 0 in flight to 1; metres².

    w is one while the motion itself needs the ground, and zero in flight: where less than a tenth
    of the weight is carried (`zmp.share_carried`). The first and last frames take their
    neighbour's weight; a clip too short for accelerations is all supported.
    """
    weight = _for_all_frames(share_carried(dynamics_of(estimate)), estimate)
    return 0.5 * _sum_over_frames(weight * _floating_height(estimate).square(), estimate)


@dataclass(frozen=True)
class FloatingUnlessFlying(TensorStruct):
    """The energy `floating` when the frames of flight are known, as in retargeting."""

    flying: Bool[Tensor, "*batch time"]

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ_t max(0, b_t - 5 mm)² over the frames without flight; metres²."""
        height = _floating_height(estimate).square()
        return 0.5 * _sum_over_frames(height.where(~self.flying, 0.0), estimate)


def slide(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ_t Σ_feet mean over the sole of c_t c_(t+1) ρ(|step|), c its contact; metres².

    c = sigmoid((2 cm - height) / 5 mm) says that a point of the sole, weighted by its skin, is in
    contact; ρ(r) = s² r² / (s² + r²) with s of 0.5 m/s lets go of a foot that swings low.
    """
    motion, surface = estimate.motion, SampledSurface.of(estimate.body.model)
    points = _surface_points(estimate.body)[..., surface.sole, :]
    contact = ((CONTACT_HEIGHT - points[..., 2]) / CONTACT_SOFTNESS).sigmoid()
    step = points[..., :2].diff(dim=-3).square().sum(-1) * (motion.fps / REFERENCE_FPS) ** 2
    cost = (
        contact[..., 1:, :]
        * contact[..., :-1, :]
        * _geman_mcclure(step, SLIP_SCALE / REFERENCE_FPS)
    )
    areas = surface.areas[surface.sole]
    feet = [(cost[..., foot] @ areas[foot]) / areas[foot].sum() for foot in surface.soles]
    total = (feet[0] + feet[1]).where(motion.pairs, 0.0).sum(-1)
    return 0.5 * total * (REFERENCE_FPS / motion.fps)


def dynamic_stability(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """½ Σ_t w_t ρ(|CoP - ZMP|), a robust distance from centre of pressure to ZMP; metres².

    w is zero in flight: it falls to zero where the ground carries less than 0.3 to 0.1 of the
    weight, and where the lowest point rises from 3 to 7 cm. HUMOS equation 5 with the ZMP
    corrected, the robust scale on the distance, and the gate that its text describes.
    """
    surface = SampledSurface.of(estimate.body.model)
    step = difference_step(estimate.motion.fps)
    points = inner_frames(_surface_points(estimate.body), estimate.motion.fps)
    moving = dynamics_of(estimate)
    away = (centre_of_pressure(points, surface.areas) - zmp(moving)).square().sum(-1)
    near = 1 - smoothstep(lowest_point(points[..., 2]), *NEAR_GROUND)
    cost = share_carried(moving) * near * _geman_mcclure(away, BALANCE_SCALE)
    total = cost.where(estimate.motion.inner(step), 0.0).sum(-1)
    return 0.5 * total * (REFERENCE_FPS / estimate.motion.fps)


def lowest_of_parts(estimate: Estimate) -> Float[Tensor, "*batch time 10"]:
    """Return a smooth minimum of the heights of each of ten body parts, metres."""
    surface = SampledSurface.of(estimate.body.model)
    heights = _surface_points(estimate.body)[..., 2]
    parts = [heights[..., surface.rows_of(part)] for part in range(len(PARTS))]
    return torch.stack([lowest_point(part) for part in parts], -1)


def _floating_height(estimate: Estimate) -> Float[Tensor, "*batch time"]:
    lowest = lowest_point(_surface_points(estimate.body)[..., 2])
    return (lowest - TOLERANCE).clamp(min=0)


def lowest_point(heights: Float[Tensor, "*batch points"]) -> Float[Tensor, "*batch"]:
    """Return a smooth minimum of points' heights, Σ h softmax(-h / 2 mm), metres."""
    return (heights * (-heights / SOFTNESS).softmax(-1)).sum(-1)


def _geman_mcclure(square: Float[Tensor, "*shape"], scale: float) -> Float[Tensor, "*shape"]:
    """Geman and McClure's ρ of a squared distance: the square itself near zero, s² far away."""
    return square * scale**2 / (square + scale**2)


_POINTS: WeakIdKeyDictionary = WeakIdKeyDictionary()
_DYNAMICS: WeakIdKeyDictionary = WeakIdKeyDictionary()
"""Dynamics by body in use: the energies of one estimate share them, as they share its vertices."""


def _surface_points(posed: PosedBody) -> Float[Tensor, "*batch time points 3"]:
    if posed not in _POINTS:
        _POINTS[posed] = posed.points(SampledSurface.of(posed.model).vertices)
    return _POINTS[posed]


def dynamics_of(estimate: Estimate) -> Dynamics:
    """Return acceleration and angular momentum of an estimate's body; cached per estimate."""
    posed = estimate.body
    if posed not in _DYNAMICS:
        masses = vertex_masses(posed.model, posed.shape)
        _DYNAMICS[posed] = body_dynamics(posed, masses, estimate.motion.fps)
    return _DYNAMICS[posed]


def _sum_over_frames(
    cost: Float[Tensor, "*batch time"], estimate: Estimate
) -> Float[Tensor, "*batch"]:
    motion = estimate.motion
    return cost.where(motion.valid, 0.0).sum(-1) * (REFERENCE_FPS / motion.fps)


def _for_all_frames(
    values: Float[Tensor, "*batch inner"], estimate: Estimate
) -> Float[Tensor, "*batch time"]:
    """Extend values of inner frames to first and last frames; ones if no frame is inner."""
    motion = estimate.motion
    if values.shape[-1] == 0:
        return motion.translation.new_ones(motion.valid.shape)
    step = difference_step(motion.fps)
    # index in `values` of the last inner frame of each clip of the batch
    last = (motion.inner(step).sum(-1, keepdim=True) - 1).clamp(min=0)
    frame = torch.arange(motion.frames, device=values.device) - step
    nearest = frame.clamp(min=0).expand(motion.valid.shape).minimum(last)
    known = motion.inner(step).any(-1, keepdim=True)
    return values.gather(-1, nearest).where(known, 1.0)


_PHYSICS = (
    ("penetration", penetration, 0.002),
    ("slide", slide, 0.003),
    ("floating", floating, 0.006),
    ("dynamic stability", dynamic_stability, 0.2),
)
"""Standard deviations, metres: of depth, of the step of a sole per 1/30 s, of height, and of the
distance from the centre of pressure to the zero moment point. Chosen on validation windows."""


def physics_terms(noise: float, strength: float = 1.0) -> tuple[Term, ...]:
    """Return the four energies as weighted terms for data with the given noise.

    Each weighs noise² / deviation², as a negative log-probability does beside ½ |error|².

    Args:
        noise: of the observation's coordinates, metres; at least 8 mm is taken.
        strength: multiplier of all of them.

    Raises:
        ValueError: when the strength is not a number above 0.
    """
    if not 0 < strength < float("inf"):
        raise ReconError(
            "physics multiplies the weights of contact with the ground: expected a number of at "
            f"least 0 (0 leaves them out, 1 keeps the chosen weights), got {strength:g}"
        )
    variance = strength * max(noise, 0.008) ** 2
    return tuple(Term(name, energy, variance / s**2) for name, energy, s in _PHYSICS)
