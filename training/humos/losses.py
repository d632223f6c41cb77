"""Losses of the HUMOS prior: transfer of a motion to another body and back."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humos.frames import BodyFrames
from priors.humos.networks import WindowNetworks
from priors.humos.prior import FPS
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.protocols import Decoded, Estimate
from recon.physics import energies as physics
from training.descent import divergence_from_normal, drawn_code
from training.humos.corpus import BodyBatch

_NUMBER, _JOINT, _STEP = 0.02, 0.02, 0.005
"""Metres: errors of numbers, of joints, and of a joint's step to the next frame, that cost ½."""
_FLYING = 0.03
"""Lengths of leg above which the lowest point of a recorded body flies."""


@dataclass(frozen=True)
class Codes:
    """The encoder's distribution q(z | motion, body) of latent codes, and one draw from it."""

    mean: Float[Tensor, "clips memory latent"]
    log_variance: Float[Tensor, "clips memory latent"]
    drawn: Float[Tensor, "clips memory latent"]


def encoded_motions(
    networks: WindowNetworks,
    rows: Float[Tensor, "clips time numbers"],
    shape: Float[Tensor, "clips shape"],
    exists: Bool[Tensor, "clips windows"],
    random: torch.Generator | None,
) -> Codes:
    """Encode motions and draw their latent codes; the means are taken if `random` is None."""
    mean, log_variance = networks.posterior(rows, shape, exists)
    return Codes(mean, log_variance, drawn_code(mean, log_variance, random))


def reconstruction_error(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch, body: BodyModel
) -> Float[Tensor, ""]:
    """½ mean |error|² / σ² of features, joints, and joints' displacements between frames.

    The first is HUMOS's loss of rotations and translation in metres, the others are what feet
    need: orientations a degree off move a foot by centimetres.
    """
    made, true = BodyFrames.unpack(rows), batch.frames
    valid = batch.valid[..., None]
    numbers = (rows - true.pack()).square()
    away = made.joints(batch.shape, body) - true.joints(batch.shape, body)
    step = away.diff(dim=1).square().sum(-1)
    both = valid[:, 1:] & valid[:, :-1]
    return 0.5 * (
        _mean_over_valid(numbers, valid) / _NUMBER**2
        + _mean_over_valid(away.square().sum(-1), valid) / _JOINT**2
        + _mean_over_valid(step, both) / _STEP**2
    )


def feature_error(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch
) -> Float[Tensor, ""]:
    """½ mean |error|² / σ² of features alone, for transfers to another body and back."""
    return (
        0.5
        * _mean_over_valid((rows - batch.frames.pack()).square(), batch.valid[..., None])
        / _NUMBER**2
    )


def code_divergence(codes: Codes, exists: Bool[Tensor, "clips windows"]) -> Float[Tensor, ""]:
    """Mean KL(q || N(0, 1)) per number of a code that exists, nats."""
    kl = divergence_from_normal(codes.mean, codes.log_variance)
    return _mean_over_valid(kl, exists[..., None])


@dataclass(frozen=True)
class PhysicsLosses:
    """Physics energies of generated motions, per frame, in the units of the other losses."""

    ground: Float[Tensor, ""]
    """Penetration and float."""
    slide: Float[Tensor, ""]
    balance: Float[Tensor, ""]
    bounce: Float[Tensor, ""]
    """Second differences of the pelvis' height beside those that were recorded."""


def physics_losses(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch, body: BodyModel
) -> PhysicsLosses:
    """Losses of penetration, floating (unless the recorded body flies), sliding and balance.

    And vertical acceleration: a body whose lowest point is put on the ground in every frame may
    tremble, which no loss of poses sees.
    """
    motion = motion_of_other_body(rows, batch, body)
    estimate = Estimate(
        Decoded(motion), body.pose(motion), Scene.create(len(rows), like=motion.translation)
    )
    frames = batch.valid.sum() * (30 / FPS)
    flying = batch.frames.clearance > _FLYING
    ground = physics.penetration(estimate) + physics.FloatingUnlessFlying(flying)(estimate)
    return PhysicsLosses(
        ground=ground.sum() / frames,
        slide=physics.slide(estimate).sum() / frames,
        balance=physics.dynamic_stability(estimate).sum() / frames,
        bounce=0.5
        * _mean_over_valid(
            _pelvis_acceleration_error(motion, batch, body)[..., None], batch.valid[:, 2:, None]
        ),
    )


def _pelvis_acceleration_error(
    motion: Motion, batch: BodyBatch, body: BodyModel
) -> Float[Tensor, "clips inner"]:
    """Squared second difference of the error of the pelvis' height, metres² per metre² of leg."""
    pelvis = motion.translation[..., 2] + body.rest_joints(motion.shape)[:, :1, 2]
    height = pelvis / leg_length(body, motion.shape)[:, None]
    return (height - batch.height).diff(n=2, dim=-1).square()


def motion_of_other_body(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch, body: BodyModel
) -> Motion:
    """Decode feature rows to motions of the batch's other body shapes, from the origin."""
    base = so3.rigid(torch.eye(3), torch.zeros(3)).expand(len(rows), 4, 4)
    return BodyFrames.unpack(rows).motion(batch.other, body, FPS, base).replace(valid=batch.valid)


def _mean_over_valid(values: Tensor, valid: Bool[Tensor, "*batch 1"]) -> Float[Tensor, ""]:
    return values.where(valid, 0.0).sum() / (valid.sum() * values.shape[-1]).clamp(min=1)


def mean_joint_distance_cm(
    one: BodyFrames, other: BodyFrames, batch: BodyBatch, body: BodyModel
) -> float:
    """Mean distance of joints about the level of the pelvis on the bodies of a batch, cm."""
    a, b = (frames.joints(batch.shape, body) for frames in (one, other))
    return 100 * float((a - b).norm(dim=-1).mean(-1)[batch.valid].mean())


def clearance_error(rows: Tensor, batch: BodyBatch) -> float:
    """Mean error of the lowest point's height, cm per metre of leg."""
    error = BodyFrames.unpack(rows).clearance - batch.frames.clearance
    return 100 * float(error.abs()[batch.valid].mean())
