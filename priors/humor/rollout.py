"""Rolling HuMoR's decoder out over time.

The weights are frozen, so their derivatives are never formed. What the latents add to every layer
is one product for all steps beforehand; what the conditional prior says of every step, and where
each step lies in the world, is computed for all steps afterwards.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from priors.humor.loop import (
    JOINTS_OF_VECTORS,
    SPIN,
    STATE_ORDER,
    VECTORS,
    FrozenDecoder,
    HeadingTurn,
    Unrolled,
    unroll_given,
)
from priors.humor.networks import STATE
from priors.humor.state import Frame, State
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct


@dataclass(frozen=True)
class Rollout(TensorStruct):
    """Consecutive steps, each in the canonical frame of the state it starts from."""

    inputs: Float[Tensor, "batch steps 339"]
    """Packed canonical states from which the steps start."""
    states: State
    """States to which the steps lead, axes (batch, steps)."""
    contacts: Float[Tensor, "batch steps 9"]
    """Logits."""
    headings: Float[Tensor, "batch steps 2"]
    """Unit vector (rx, ry) to the right of the body there."""

    def frames(self, first: Frame) -> Frame:
        """The canonical frame of every step in the world, given the frame of the first step.

        Headings add up, and each step's horizontal move, turned by the headings before it.
        """
        turned = torch.atan2(self.headings[..., 1], self.headings[..., 0])
        start = torch.atan2(first.turn[..., 0, 1], first.turn[..., 0, 0])
        angle = torch.cat((start[:, None], turned[:, :-1]), 1).cumsum(1)
        c, s = angle.cos(), angle.sin()
        zero, one = torch.zeros_like(c), torch.ones_like(c)
        entries = (c, s, zero, -s, c, zero, zero, zero, one)
        turn = torch.stack(entries, -1).unflatten(-1, (3, 3))
        level = torch.cat((self.states.translation[..., :2], zero[..., None]), -1)
        moves = (turn.mT @ level[..., None])[..., 0]
        origins = torch.cat((first.origin[:, None], moves[:, :-1]), 1).cumsum(1)
        return Frame(turn, origins)

    def in_world(self, first: Frame, pelvis: Float[Tensor, "batch 3"]) -> State:
        """All states in the world, given the canonical frame of the first state."""
        return self.frames(first).from_frame(self.states, pelvis[:, None])


def roll_out(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 339"],
    pelvis: Float[Tensor, "batch 3"],
    latents: Float[Tensor, "batch steps 48"],
) -> Rollout:
    """The steps that given latents make.

    Args:
        decoder: frozen weights.
        start: packed canonical state; its horizontal place is zero and not read.
        pelvis: horizontal offset of the pelvis from the translation, constant for a body.
        latents: of every step.
    """
    added = decoder.constant_inputs(latents.transpose(0, 1), pelvis)
    return _rollout(unroll_given(decoder, _to_loop_layout(start, pelvis), added), pelvis)


def _rollout(steps: Unrolled, pelvis: Float[Tensor, "batch 3"]) -> Rollout:
    _, move, contacts = (t.transpose(0, 1) for t in steps.rest.split((SPIN, 2, 9), -1))
    reached, turns = steps.vectors.transpose(0, 1), steps.turns.transpose(0, 1)
    translation = torch.cat((move, reached[..., -1:]), -1)
    vectors = reached[..., :-1].unflatten(-1, (3, VECTORS)).mT
    origin = pelvis[:, None] + functional.pad(move, (0, 1))
    states = State(
        translation=translation,
        velocity=vectors[..., 0, :],
        root=turns[..., 0, :, :],
        angular_velocity=vectors[..., 1, :],
        pose=turns[..., 1:, :, :],
        joints=vectors[..., JOINTS_OF_VECTORS, :] + origin[..., None, :],
        joint_velocities=vectors[..., JOINTS_OF_VECTORS.stop :, :],
    )
    inputs = _from_loop_layout(steps.inputs.transpose(0, 1), pelvis[:, None])
    return Rollout(inputs, states, contacts, HeadingTurn.like(turns).heading(turns))


def _to_loop_layout(
    packed: Float[Tensor, "batch 339"], pelvis: Float[Tensor, "batch 3"]
) -> Float[Tensor, "batch 337"]:
    """A canonical state in the loop's layout."""
    return (packed - _joints_at(pelvis))[:, STATE_ORDER.to(packed.device)]


def _from_loop_layout(
    x: Float[Tensor, "*batch 337"], pelvis: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 339"]:
    """The inverse of `_to_loop_layout`."""
    return functional.pad(x, (0, 2))[..., _PLACES.to(x.device)] + _joints_at(pelvis)


_PLACES = torch.cat((STATE_ORDER, torch.arange(2))).argsort()
"""Indices of a packed state's numbers in the loop's layout, which is followed by two zeros."""


def _joints_at(place: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 339"]:
    """A packed state with all joints at one position and zeros elsewhere."""
    joints = 3 * len(JOINTS)
    return functional.pad(torch.cat([place] * len(JOINTS), -1), (STATE - 2 * joints, joints))
