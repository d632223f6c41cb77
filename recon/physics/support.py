"""Energy of support: a body that does not fall must have a foot at rest on the ground.

From the body alone, and so for every step of a minimisation. It says of legs that nobody saw what
no prior of motion can be trusted with on a stranger: legs that glide above the ground are easy to
predict, and carry nobody; and a foot beside the point about which the ground must push does not.
"""

import math
from dataclasses import dataclass
from itertools import combinations_with_replacement

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import heights_in_contact, rest_heights
from recon.body.parts import GRAVITY
from recon.core.arrays import cached_constant
from recon.core.skeleton import FEET
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.physics.dynamics import (
    average_dynamics,
    difference_step,
    inner_frames,
    second_differences,
)
from recon.physics.zmp import zmp
from recon.solver.banded import add_differences

TOLERANCE = 0.02
"""Metres a joint of a foot that carries the body may be above or below where it touches."""
HEIGHT = 0.03
"""Standard deviation of its height beyond that, metres."""
SPEED = 0.3
"""Standard deviation of its velocity, m/s."""
REACH = 0.05
"""Metres that soles reach beyond the line between two joints of feet."""
BALANCE = 0.1
"""Standard deviation of how far the zero-moment point is beyond that reach, metres."""
FAR = 5.0
"""Energy of one foot, in nats, beyond which it counts less and less: stairs, chairs and belts of
treadmills exist."""
SOFTNESS = 0.5
"""Nats over which the least energy of the pairs is taken softly, for a continuous gradient."""
_FIRST, _SECOND = zip(*combinations_with_replacement(range(len(FEET)), 2), strict=True)
"""Joints of feet that may carry the body together, or one alone, as places in `FEET`."""


@dataclass(frozen=True)
class SupportEnergy(TensorStruct):
    """An energy for clips with unseen legs, low if a resting foot supports the body."""

    unseen: Bool[Tensor, "*batch"]
    """Clips whose legs nobody saw; the others have an energy of zero."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Sum over frames of the load times the least energy of a pair of foot joints; nats.

        Σ_t l_t min_jk ρ(max(u_j, u_k) + ½ d_jk² / σ_d²), scaled to 30 frames per second.
        j and k are ankles and toes, also twice the same. l is the share of its weight that the
        ground carries, 1 + a / g between 0 and 1, by the vertical acceleration a of the pelvis:
        zero in flight. u = ½ (h² / σ_h² + v² / σ_v²) says how far a joint is from rest: h is the
        distance from the height at which it touches, v² its mean squared speed in the steps
        before and after. d is how far the zero-moment point of a body with average segments is
        from the line between the two joints, less the reach of soles, and ρ(x) = s log(1 + x / s).
        The first and the last frames, whose acceleration is not known, count nothing.
        """
        carried, nats = (
            _carried_weight(estimate),
            heavy_tailed(_energies_of_pairs(estimate, _squared_unrest(estimate))),
        )
        least = -SOFTNESS * ((-nats / SOFTNESS).logsumexp(-1) - math.log(len(_FIRST)))
        exists = estimate.motion.inner(_difference_step(estimate)) & self.unseen[..., None]
        return (carried * least).where(exists, 0.0).sum(-1) * _scale_to_30_hz(estimate)

    def add_curvature(
        self,
        weight: float,
        estimate: Estimate,
        clip: int,
        joints: Float[Tensor, "time 3 66"],
    ) -> None:
        """Add the Gauss-Newton Hessian of the joints that rest: their heights and velocities.

        Args:
            weight: of the energy.
            estimate: of all clips.
            clip: number of the clip.
            joints: coefficients of products of joints' coordinates that are added to
                (`recon.solver.banded.add_differences`).
        """
        if not bool(self.unseen[clip]):
            return
        span, motion = _difference_step(estimate), estimate.motion
        if motion.frames <= 2 * span:
            return
        unrest = _squared_unrest(estimate)
        nats, unrest = _energies_of_pairs(estimate, unrest)[clip].detach(), unrest[clip].detach()
        held = (-heavy_tailed(nats) / SOFTNESS).softmax(-1) / (1 + nats / FAR)
        share = (
            _summed_by_restless_joint(held, unrest)
            * _carried_weight(estimate)[clip, :, None].detach()
        )
        share = (
            share.where(motion.inner(span)[clip, :, None], 0.0)
            * weight
            * _scale_to_30_hz(estimate)
        )
        stiff = joints.new_zeros(len(joints), 22, 3)
        stiff[span:-span, FEET, 2] = share / HEIGHT**2
        add_differences(joints, (1.0,), stiff.flatten(1))
        held = joints.new_zeros(len(joints), 22, 3)
        held[span:-span, FEET] = (0.5 * (motion.fps / SPEED) ** 2 * share)[..., None]
        steps = (held[1:] + held[:-1]).flatten(1)
        add_differences(joints, (-1.0, 1.0), steps)


def carried_share(acceleration: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return which share (0 to 1) of the weight the ground carries, by vertical acceleration."""
    return (1 + acceleration / GRAVITY).clamp(0, 1)


def foot_energy(
    height: Float[Tensor, "*shape"], squared_speed: Float[Tensor, "*shape"]
) -> Float[Tensor, "*shape"]:
    """Energy ρ(½ (h² / σ_h² + v² / σ_v²)) of height h and speed v of foot joints; nats.

    Args:
        height: above the height at which the joint touches, metres; h is what exceeds 2 cm.
        squared_speed: v², m²/s².
    """
    return heavy_tailed(_unrest_nats(height, squared_speed))


def _unrest_nats(height: Tensor, squared_speed: Tensor) -> Tensor:
    away = (height.abs() - TOLERANCE).clamp(min=0)
    return 0.5 * ((away / HEIGHT).square() + squared_speed / SPEED**2)


def heavy_tailed(nats: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Robust kernel of an energy in nats: s log(1 + x / s), near x for small x."""
    return FAR * torch.log1p(nats / FAR)


def _carried_weight(estimate: Estimate) -> Float[Tensor, "*batch inner"]:
    """Return which share of the weight the ground carries, by the pelvis' acceleration."""
    pelvis = second_differences(estimate.body.joints[..., :1, :], estimate.motion.fps)
    return carried_share(pelvis[..., 0, 2])


def _squared_unrest(estimate: Estimate) -> Float[Tensor, "*batch inner 4"]:
    """Return ½ (h² / σ_h² + v² / σ_v²) for height and speed of ankles and toes; nats."""
    posed, fps, span = estimate.body, estimate.motion.fps, _difference_step(estimate)
    places = cached_constant(FEET, posed.joints.device)
    feet = posed.joints[..., places, :]
    resting = heights_in_contact(rest_heights(posed.model, posed.shape))[..., places]
    height = inner_frames(feet, fps)[..., 2] - resting[..., None, :]
    speed = feet.diff(dim=-3).square().sum(-1) * fps**2
    frames = height.shape[-2]
    before, after = speed[..., span - 1 :, :], speed[..., span:, :]
    return _unrest_nats(height, 0.5 * (before[..., :frames, :] + after[..., :frames, :]))


def _energies_of_pairs(
    estimate: Estimate, unrest: Float[Tensor, "*batch inner 4"]
) -> Float[Tensor, "*batch inner 10"]:
    """Return, per pair of foot joints, the larger unrest + ½ (excess ZMP distance / σ)²; nats."""
    one, other = (cached_constant(side, unrest.device) for side in (_FIRST, _SECOND))
    joints = estimate.body.joints[..., cached_constant(FEET, unrest.device), :2]
    feet = inner_frames(joints, estimate.motion.fps)
    first, second = feet[..., one, :], feet[..., other, :]
    moving = average_dynamics(estimate.body, estimate.motion.fps)
    line, away = second - first, zmp(moving)[..., None, :] - first
    share = ((away * line).sum(-1) / line.square().sum(-1).clamp(min=1e-8)).clamp(0, 1)
    # 1e-8 is added, since the square root has no derivative at zero
    distance = ((away - share[..., None] * line).square().sum(-1) + 1e-8).sqrt()
    beyond = (distance - REACH).clamp(min=0) / BALANCE
    return unrest[..., one].maximum(unrest[..., other]) + 0.5 * beyond.square()


def _summed_by_restless_joint(
    pairs: Float[Tensor, "inner 10"], unrest: Float[Tensor, "inner 4"]
) -> Float[Tensor, "inner 4"]:
    """Sum the pairs' weights by joint; a pair counts for its joint with the larger unrest."""
    first, second = (
        cached_constant(side, unrest.device).expand(pairs.shape) for side in (_FIRST, _SECOND)
    )
    restless = torch.where(unrest.gather(-1, first) >= unrest.gather(-1, second), first, second)
    return torch.zeros_like(unrest).scatter_add(-1, restless, pairs)


def _difference_step(estimate: Estimate) -> int:
    return difference_step(estimate.motion.fps)


def _scale_to_30_hz(estimate: Estimate) -> float:
    return REFERENCE_FPS / estimate.motion.fps
