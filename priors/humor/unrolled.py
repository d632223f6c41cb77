"""Motions as a first state and latents: variables of the roll-out, and what they decode to."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from priors.humor.loop import (
    JOINTS_OF_VECTORS,
    SPIN,
    STATE_ORDER,
    VECTORS,
    FrozenDecoder,
    HeadingRotation,
    roll_out_with_biases,
)
from priors.humor.networks import STATE
from priors.humor.state import (
    Frame,
    State,
    at_tempo,
    contact_probabilities,
    initial_features,
    state_after_step,
    states_of,
)
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, carried_translation
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Decoded

_LOG_TWO_PI = math.log(2 * math.pi)


@dataclass(frozen=True)
class HumorVariables(TensorStruct):
    """Variables of a roll-out at 30 Hz: steps of the first state's rotations, and latents."""

    translation: Float[Tensor, "clips 3"]
    """SMPL translation of the first frame, metres."""
    root: Float[Tensor, "clips 3"]
    """Rotation vector of the root, relative to `base`, radians."""
    pose: Float[Tensor, "clips 21 3"]
    """Rotation vectors of the other joints: R = base · Exp(pose), radians."""
    velocity: Float[Tensor, "clips 3"]
    """Velocity of the pelvis in the first frame, m/s."""
    angular_velocity: Float[Tensor, "clips 3"]
    """Angular velocity of the root in the world, rad/s."""
    joint_velocities: Float[Tensor, "clips 21 3"]
    """Velocities in the world of all joints but the pelvis, m/s."""
    latents: Float[Tensor, "clips steps 48"]
    shape: Float[Tensor, "clips shape"]
    base: Float[Tensor, "clips 22 3 3"]
    valid: Bool[Tensor, "clips time"]
    start_time: float

    def carried(self, T: Float[Tensor, "clips 4 4"], body: BodyModel) -> "HumorVariables":
        """Variables of the same motion after a rigid transform of its first state.

        Latents are changes as the body sees them and stay. Where the transform tilts, the
        roll-out from there is another motion, because the decoder knows where up is.
        """
        turn, pelvis = T[:, :3, :3], body.rest_joints(self.shape)[:, 0]
        return self.replace(
            translation=carried_translation(self.translation[:, None], T, pelvis)[:, 0],
            velocity=(turn @ self.velocity[..., None])[..., 0],
            angular_velocity=(turn @ self.angular_velocity[..., None])[..., 0],
            joint_velocities=self.joint_velocities @ turn.mT,
            base=torch.cat((turn[:, None] @ self.base[:, :1], self.base[:, 1:]), 1),
        )

    def first_frames(self, frames: int) -> "HumorVariables":
        """Return the variables of the first `frames` frames of the motion."""
        return self.derived(latents=self.latents[:, : frames - 1], valid=self.valid[:, :frames])


def encoded_variables(humor: Any, motion: Motion) -> HumorVariables:
    """Encode a motion as its first state and a latent per step; see `Humor.encode`."""
    motion = at_tempo(motion, 1.0)
    states = states_of(motion, humor.body)
    first = states[:, 0]
    zero = torch.zeros_like(motion.rotations[:, 0, :, 0])
    return HumorVariables(
        translation=first.translation,
        root=zero[:, 0],
        pose=zero[:, 1:],
        velocity=first.velocity,
        angular_velocity=first.angular_velocity,
        joint_velocities=first.joint_velocities[:, 1:],
        latents=_latents_of_steps(humor, states, humor.pelvis(motion.shape)),
        shape=motion.shape,
        base=motion.rotations[:, 0],
        valid=motion.valid,
        start_time=motion.start_time,
    )


def decoded_motion(humor: Any, variables: HumorVariables) -> Decoded:
    """Roll out the motion of a first state and latents; see `Humor.decode`."""
    first, pelvis = _first_state(humor, variables), humor.pelvis(variables.shape)
    frame = Frame.of(first)
    start = frame.to_frame(first, pelvis)
    rollout = roll_out(humor.decoder, start.pack(), pelvis, variables.latents)
    states = rollout.in_world(frame, pelvis)
    mean, log_variance = humor.networks.prior(rollout.inputs)
    away = (variables.latents - mean).square() * (-log_variance).exp()
    nats = 0.5 * (away + log_variance + _LOG_TWO_PI).sum(-1)
    motion = _motion_of_states(first, states, variables.shape, variables.start_time)
    return Decoded(
        motion=motion.replace(valid=variables.valid),
        energies={
            "transition": nats.where(variables.valid[:, 1:], 0.0).sum(-1),
            "initial": humor.initial.energy(initial_features(start)),
        },
        contacts=contact_probabilities(rollout.contacts),
        joints=torch.cat((first.joints[:, None], states.joints), 1),
    )


def _first_state(humor: Any, variables: HumorVariables) -> State:
    steps = torch.cat((variables.root[:, None], variables.pose), 1)
    rotations = variables.base @ so3.exp(steps)
    motion = Motion.create(
        variables.translation[:, None], rotations[:, None], variables.shape, REFERENCE_FPS
    )
    velocities = torch.cat((variables.velocity[:, None], variables.joint_velocities), 1)
    return State(
        translation=variables.translation,
        velocity=variables.velocity,
        root=rotations[:, 0],
        angular_velocity=variables.angular_velocity,
        pose=rotations[:, 1:],
        joints=humor.body.pose(motion).joints[:, 0],
        joint_velocities=velocities,
    )


def _latents_of_steps(
    humor: Any, states: State, pelvis: Float[Tensor, "clips 3"]
) -> Float[Tensor, "clips steps 48"]:
    """Encode each step from the state that decoding the previous latents has reached.

    Were each taken from the true state before, errors would add up over the roll-out.
    """
    frame = Frame.of(states[:, 0])
    here = frame.to_frame(states[:, 0], pelvis).pack()
    latents: list[Tensor] = []
    for step in range(1, states.translation.shape[1]):
        ahead = frame.to_frame(states[:, step], pelvis).pack()
        latents.append(humor.networks.posterior(here, ahead)[0])
        raw = humor.networks.decode(here, latents[-1])
        reached = frame.from_frame(state_after_step(State.unpack(here), raw)[0], pelvis)
        frame = Frame.of(reached)
        here = frame.to_frame(reached, pelvis).pack()
    return torch.stack(latents, 1)


def _motion_of_states(
    first: State, states: State, shape: Float[Tensor, "clips shape"], start_time: float
) -> Motion:
    roots = torch.cat((first.root[:, None], states.root), 1)
    poses = torch.cat((first.pose[:, None], states.pose), 1)
    return Motion.create(
        translation=torch.cat((first.translation[:, None], states.translation), 1),
        rotations=torch.cat((roots[:, :, None], poses), 2),
        shape=shape,
        fps=REFERENCE_FPS,
        start_time=start_time,
    )


@dataclass(frozen=True)
class Rollout(TensorStruct):
    """Result of a roll-out: the state after every step, in the canonical frame of its start."""

    inputs: Float[Tensor, "batch steps 339"]
    """Packed canonical states from which the steps start."""
    states: State
    """States to which the steps lead, axes (batch, steps)."""
    contacts: Float[Tensor, "batch steps 9"]
    """Logits."""
    headings: Float[Tensor, "batch steps 2"]
    """Unit vector (rx, ry) to the right of the body there."""

    def canonical_frames(self, first: Frame) -> Frame:
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
        return self.canonical_frames(first).from_frame(self.states, pelvis[:, None])


def roll_out(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 339"],
    pelvis: Float[Tensor, "batch 3"],
    latents: Float[Tensor, "batch steps 48"],
) -> Rollout:
    """Roll out the steps that given latents decode to.

    Args:
        decoder: frozen weights.
        start: packed canonical state; its horizontal place is zero and not read.
        pelvis: horizontal offset of the pelvis from the translation, constant for a body.
        latents: of every step.
    """
    added = decoder.constant_inputs(latents.transpose(0, 1), pelvis)
    steps = roll_out_with_biases(decoder, _to_decoder_order(start, pelvis), added)
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
    inputs = _from_decoder_order(steps.inputs.transpose(0, 1), pelvis[:, None])
    return Rollout(inputs, states, contacts, HeadingRotation.like(turns).heading(turns))


def _to_decoder_order(
    packed: Float[Tensor, "batch 339"], pelvis: Float[Tensor, "batch 3"]
) -> Float[Tensor, "batch 337"]:
    """Rearrange a canonical state to the layout of `FrozenDecoder`."""
    return (packed - _state_with_joints_at(pelvis))[:, STATE_ORDER.to(packed.device)]


def _from_decoder_order(
    x: Float[Tensor, "*batch 337"], pelvis: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 339"]:
    """The inverse of `_to_decoder_order`."""
    return functional.pad(x, (0, 2))[..., _PLACES.to(x.device)] + _state_with_joints_at(pelvis)


_PLACES = torch.cat((STATE_ORDER, torch.arange(2))).argsort()
"""Indices of a packed state's numbers in the loop's layout, which is followed by two zeros."""


def _state_with_joints_at(place: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 339"]:
    """Return a packed state with all joints at one position and all other entries zero."""
    joints = 3 * len(JOINTS)
    return functional.pad(torch.cat([place] * len(JOINTS), -1), (STATE - 2 * joints, joints))
