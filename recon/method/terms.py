"""Weighted terms of an objective, and the energies that need no data.

Sums over frames are scaled to 30 frames per second whatever the motion's rate, so that published
weights keep their meaning. Frames that do not exist count nothing.
"""

from dataclasses import dataclass, replace
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.scene import TILT, ZOOM
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Energy, Estimate


@dataclass(frozen=True)
class Term:
    """One named, weighted energy of an objective."""

    name: str
    energy: Energy
    weight: float

    def rows(self, index: Tensor) -> "Term":
        """Return the term with the data of the clips `index` of the batch."""
        tensors = isinstance(self.energy, TensorStruct)
        return replace(self, energy=cast(Any, self.energy)[index]) if tensors else self

    def to(self, *, device: str) -> "Term":
        """Return the term with the data of its energy on the given device."""
        tensors = isinstance(self.energy, TensorStruct)
        return replace(self, energy=cast(Any, self.energy).to(device=device)) if tensors else self


@dataclass(frozen=True)
class PriorEnergy:
    """An energy: the part called `name` of -log p of the stage's prior."""

    name: str

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return the named part of -log p from the estimate's decoded energies."""
        return estimate.decoded.energies[self.name]


def prior_energy(name: str) -> PriorEnergy:
    """Return the energy that is the named part of -log p of the stage's prior."""
    return PriorEnergy(name)


def shape(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return |betas|² of the shape coefficients, times the number of frames at 30 per second.

    HuMoR section 6.5: shape_prior, scaled by the number of frames.
    """
    motion = estimate.motion
    return motion.shape.square().sum(-1) * motion.valid.sum(-1) * (REFERENCE_FPS / motion.fps)


def joint_velocity(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return ½ Σ |p_t - p_(t-1)|² of the 22 joints, displacements per 1/30 s; metres².

    HuMoR section 6.5: joints3d_smooth.
    """
    motion = estimate.motion
    step = estimate.body.joints.diff(dim=-3).square().sum((-1, -2))
    return 0.5 * step.where(motion.pairs, 0.0).sum(-1) * (motion.fps / REFERENCE_FPS)


def joint_acceleration(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return ½ Σ |p_(t+1) - 2 p_t + p_(t-1)|² of the 22 joints, per (1/30 s)²; metres²."""
    motion = estimate.motion
    bend = estimate.body.joints.diff(n=2, dim=-3).square().sum((-1, -2))
    return 0.5 * bend.where(motion.inner(), 0.0).sum(-1) * (motion.fps / REFERENCE_FPS) ** 3


def relative_acceleration(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return `joint_acceleration` of the body scaled to average size; metres²."""
    motion, body = estimate.motion, estimate.body.model
    own, average = (
        body.rest_joints(one) for one in (motion.shape, torch.zeros_like(motion.shape))
    )
    own, average = ((rest - rest[..., :1, :]).square().sum((-1, -2)) for rest in (own, average))
    return joint_acceleration(estimate) * average / own


def rest_pose(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return Σ (1 - cos angle) of 21 body joints' rotations from the rest pose, at 30 frames/s.

    It determines rotations that no observation does, such as twists about a bone.
    """
    motion = estimate.motion
    body = motion.rotations[..., 1:, :, :]
    identity = torch.eye(3, dtype=body.dtype, device=body.device)
    away = (body - identity).square().sum((-1, -2, -3)).where(motion.valid, 0.0) / 4
    return away.sum(-1) * (REFERENCE_FPS / motion.fps)


def offsets(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return ½ Σ |o|² of the points' offsets o from their place on the model; metres²."""
    return 0.5 * estimate.scene.offsets.square().sum((-1, -2))


def ground_moved(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return ½ (|tilt|² + lift²) of the ground from the recording's z = 0; radians², metres²."""
    unknown = estimate.scene.ground
    assert unknown is not None, "the ground is known: leave this term out"
    turn = TILT * unknown.tilt
    return 0.5 * (turn.square().sum(-1) + unknown.lift.square())


def lens_changed(estimate: Estimate) -> Float[Tensor, "*batch"]:
    """Return ½ log² of the ratio of the focal length to the guessed one; without unit."""
    unknown = estimate.scene.lens
    assert unknown is not None, "the focal length is known: leave this term out"
    return 0.5 * (ZOOM * unknown.zoom).square()
