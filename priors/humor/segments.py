"""HuMoR's decoder unrolled in segments: a free state at the start of each (multiple shooting)."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from priors.humor.prior import Humor, HumorVariables, Rolled
from priors.humor.state import State, states_of, step_between
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Decoded

_STATE = (
    "translation", "root", "pose", "velocity", "angular_velocity", "joint_velocities", "base",
)  # fmt: skip
"""Tensors of `HumorVariables` that every segment has of its own."""


@dataclass(frozen=True)
class SegmentedVariables(TensorStruct):
    """A state at the start of every segment and the latents of all steps; at 30 Hz.

    Tensors are those of `HumorVariables`, with an axis of segments where they are of a state.
    """

    translation: Float[Tensor, "clips segments 3"]
    root: Float[Tensor, "clips segments 3"]
    pose: Float[Tensor, "clips segments 21 3"]
    velocity: Float[Tensor, "clips segments 3"]
    angular_velocity: Float[Tensor, "clips segments 3"]
    joint_velocities: Float[Tensor, "clips segments 21 3"]
    latents: Float[Tensor, "clips steps 48"]
    shape: Float[Tensor, "clips shape"]
    base: Float[Tensor, "clips segments 22 3 3"]
    valid: Bool[Tensor, "clips time"]
    start_time: float

    @property
    def segments(self) -> int:
        """Number of segments; all but the last have as many steps."""
        return self.translation.shape[1]

    def carried(self, T: Float[Tensor, "clips 4 4"], body: BodyModel) -> "SegmentedVariables":
        """Every state after a rigid transform; see `HumorVariables.carried`."""
        each = T.repeat_interleave(self.segments, 0)
        moved = self.apart(self.latents.shape[1]).carried(each, body)
        return self.replace(**_by_segment(moved, self.segments))

    def apart(self, length: int) -> HumorVariables:
        """Every segment as a clip of its own, of `length` steps; clips follow each other.

        Steps beyond the end of a motion have latents of zero and do not exist.
        """
        count, steps = self.segments, self.latents.shape[1]
        missing = count * length - steps
        latents = functional.pad(self.latents, (0, 0, 0, missing))
        valid = functional.pad(self.valid, (0, missing))
        return HumorVariables(
            **{name: getattr(self, name).flatten(0, 1) for name in _STATE},
            latents=latents.unflatten(1, (count, length)).flatten(0, 1),
            shape=self.shape.repeat_interleave(count, 0),
            valid=valid.unfold(1, length + 1, length).flatten(0, 1),
            start_time=self.start_time,
        )


@dataclass(frozen=True, eq=False)
class SegmentedHumor:
    """HuMoR with a free state at the start of every segment of `length` steps.

    A segment of all steps is the roll-out, `Humor`. With shorter ones a state no longer follows
    from all latents before it, but only from those of its segment; that segments join is an
    energy of the defect between the state that one leads to and the state that the next begins
    with.
    """

    level: ClassVar[bool] = True
    humor: Humor
    length: int
    """Steps of a segment; the last one may be shorter."""

    def encode(self, motion: Motion) -> SegmentedVariables:
        """The motion's states where segments begin, and posterior means; see `Humor.encode`.

        Raises:
            ValueError: when it has fewer than two frames.
        """
        own = self.humor.like(motion.translation)
        motion = motion.resample(REFERENCE_FPS)
        states, steps = states_of(motion, own.body), motion.frames - 1
        count = -(-steps // self.length)
        starts = torch.arange(0, count * self.length, self.length)
        frames = starts[:, None] + torch.arange(self.length + 1)
        along = states.map(lambda tensor: tensor[:, frames.clamp(max=steps)].flatten(0, 1))
        pelvis = own.pelvis(motion.shape).repeat_interleave(count, 0)
        latents = own.latents_along(along, pelvis).unflatten(0, (-1, count)).flatten(1, 2)
        first = states[:, starts]
        zero = torch.zeros_like(motion.rotations[:, starts, :, 0])
        return SegmentedVariables(
            translation=first.translation,
            root=zero[:, :, 0],
            pose=zero[:, :, 1:],
            velocity=first.velocity,
            angular_velocity=first.angular_velocity,
            joint_velocities=first.joint_velocities[:, :, 1:],
            latents=latents[:, :steps],
            shape=motion.shape,
            base=motion.rotations[:, starts],
            valid=motion.valid,
            start_time=motion.start_time,
        )

    def decode(self, variables: SegmentedVariables) -> Decoded:
        """The motion of all segments, one after the other.

        `energies["transition"]` is -Σ log p(z_t | x_(t-1)) of all steps, `energies["initial"]`
        -log p(x_0) of the first state, and `energies["defect"]` Σ ½ eᵀ C⁻¹ e over the joints of
        segments, nats: e is what leads from the state that a segment ends in to the one that the
        next begins with, in the canonical frame that the segment's last step starts from, and C
        the covariance of the decoder's errors over the training corpus. So with one step a
        segment, these are the errors of `CollocatedHumor`.
        """
        own = self.humor.like(variables.translation)
        apart = variables.apart(self.length)
        rolled = own.rolled(apart)
        decoded = own.decoded(apart, rolled)
        count, frames = variables.segments, variables.valid.shape[1]
        assert decoded.contacts is not None
        assert decoded.joints is not None
        transition, initial = (
            decoded.energies[name].unflatten(0, (-1, count)) for name in ("transition", "initial")
        )
        joins = variables.valid[:, self.length : frames - 1 : self.length]
        defects = self._defects(own, rolled, count).where(joins, 0.0)
        motion = decoded.motion
        return Decoded(
            motion=Motion.create(
                _begun(motion.translation, count, frames),
                _begun(motion.rotations, count, frames),
                variables.shape,
                REFERENCE_FPS,
                start_time=variables.start_time,
            ).replace(valid=variables.valid),
            energies={
                "transition": transition.sum(1),
                "initial": initial[:, 0],
                "defect": defects.sum(1),
            },
            contacts=_reached(decoded.contacts, count, frames),
            joints=_reached(decoded.joints, count, frames),
        )

    def _defects(self, own: Humor, rolled: Rolled, count: int) -> Float[Tensor, "clips joins"]:
        """½ eᵀ C⁻¹ e of every join of two segments, nats."""

        def by_clip(tensor: Tensor) -> Tensor:
            return tensor.unflatten(0, (-1, count))

        frame = rolled.rollout.frames(rolled.frame)[:, -1].map(lambda t: by_clip(t)[:, :-1])
        landed: State = rolled.rollout.states[:, -1].map(lambda t: by_clip(t)[:, :-1])
        begins = rolled.first.map(lambda t: by_clip(t)[:, 1:])
        error = step_between(landed, frame.enter(begins, by_clip(rolled.pelvis)[:, 1:]))
        return 0.5 * (error @ own.error_whitening).square().sum(-1)


def _begun(tensor: Tensor, count: int, frames: int) -> Tensor:
    """Frames of all segments in a row, where two join those of the later one.

    Args:
        tensor: axes (clips times segments, frames of a segment, ...).
        count: segments of a clip.
        frames: of a clip.
    """
    parts = tensor.unflatten(0, (-1, count))
    return torch.cat((parts[:, :, :-1].flatten(1, 2), parts[:, -1, -1:]), 1)[:, :frames]


def _reached(tensor: Tensor, count: int, frames: int) -> Tensor:
    """The same, where two join that of the earlier one: what its steps lead to."""
    parts = tensor.unflatten(0, (-1, count))
    return torch.cat((parts[:, 0, :1], parts[:, :, 1:].flatten(1, 2)), 1)[:, :frames]


def _by_segment(variables: HumorVariables, count: int) -> dict[str, Tensor]:
    """Tensors of states, with an axis of segments again."""
    return {name: getattr(variables, name).unflatten(0, (-1, count)) for name in _STATE}
