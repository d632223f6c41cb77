"""HuMoR's state of a body in one frame, its canonical coordinates, and steps between states."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.humor.networks import STATE
from recon.body.model import BodyModel, forward_kinematics
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.core.motion import Motion
from recon.core.skeleton import CONTACT_JOINTS, JOINTS
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS

_SIZES = (3, 3, 9, 3, 189, 66, 66)
"""Sizes of the parts of a packed state, in the order of `State`'s fields."""

_RAW_SIZES = (3, 3, 3, 3, 63, 66, 66, len(CONTACT_JOINTS))

assert sum(_SIZES) == STATE


@dataclass(frozen=True)
class State(TensorStruct):
    """Pose, joints and their velocities of a body in one frame; z up, metres and seconds."""

    translation: Float[Tensor, "*batch 3"]
    """SMPL translation: the pelvis is at translation + rest pelvis."""
    velocity: Float[Tensor, "*batch 3"]
    """Velocity of the translation, m/s; the pelvis joint has the same."""
    root: Float[Tensor, "*batch 3 3"]
    angular_velocity: Float[Tensor, "*batch 3"]
    """Angular velocity of the root, in the frame of the translation, rad/s."""
    pose: Float[Tensor, "*batch 21 3 3"]
    """Rotations of the body joints relative to their parents."""
    joints: Float[Tensor, "*batch 22 3"]
    joint_velocities: Float[Tensor, "*batch 22 3"]

    @property
    def rotations(self) -> Float[Tensor, "*batch 22 3 3"]:
        """Rotations of all joints relative to their parents, the root's first."""
        return torch.cat((self.root[..., None, :, :], self.pose), -3)

    def pack(self) -> Float[Tensor, "*batch 339"]:
        """Concatenate a state's fields to the networks' input vector, matrices row by row."""
        batch = self.translation.shape[:-1]
        parts = (t.reshape(*batch, -1) for t in self.tensors().values())
        return torch.cat(tuple(parts), -1)

    @classmethod
    def unpack(cls, packed: Float[Tensor, "*batch 339"]) -> "State":
        """Split a packed vector into the fields of a state; the inverse of `pack`."""
        parts = packed.split(_SIZES, -1)
        return cls(
            translation=parts[0],
            velocity=parts[1],
            root=parts[2].unflatten(-1, (3, 3)),
            angular_velocity=parts[3],
            pose=parts[4].unflatten(-1, (len(JOINTS) - 1, 3, 3)),
            joints=parts[5].unflatten(-1, (len(JOINTS), 3)),
            joint_velocities=parts[6].unflatten(-1, (len(JOINTS), 3)),
        )


@dataclass(frozen=True)
class Frame(TensorStruct):
    """The canonical frame of a state: the body above the origin, its right side along +x."""

    turn: Float[Tensor, "*batch 3 3"]
    """Rotation about the vertical from the outer frame to this one."""
    origin: Float[Tensor, "*batch 3"]
    """Origin in the outer frame, on the ground, metres."""

    @classmethod
    def of(cls, state: State) -> "Frame":
        """Compute a state's canonical frame from its heading and horizontal translation."""
        place = state.translation
        return cls(
            so3.undo_heading(state.root),
            place * cached_constant((1.0, 1.0, 0.0), place.device, place.dtype),
        )

    def to_frame(self, state: State, pelvis: Float[Tensor, "*#batch 3"]) -> State:
        """Transform a state from the outer frame (usually the world) into this frame.

        Args:
            state: in the outer frame.
            pelvis: of the body at rest, horizontally (`rest_pelvis`). The pelvis is beside the
                translation by it whatever the rotation, so joints turn about it, not the origin.
        """
        turn = self.turn
        moved = state.translation - self.origin
        joints = state.joints - (self.origin + pelvis)[..., None, :]
        return State(
            translation=_rotated(turn, moved),
            velocity=_rotated(turn, state.velocity),
            root=turn @ state.root,
            angular_velocity=_rotated(turn, state.angular_velocity),
            pose=state.pose,
            joints=joints @ turn.mT + pelvis[..., None, :],
            joint_velocities=state.joint_velocities @ turn.mT,
        )

    def from_frame(self, state: State, pelvis: Float[Tensor, "*#batch 3"]) -> State:
        """Transform a state from this frame to the outer one; the inverse of `to_frame`."""
        back = self.turn.mT
        joints = (state.joints - pelvis[..., None, :]) @ self.turn
        return State(
            translation=_rotated(back, state.translation) + self.origin,
            velocity=_rotated(back, state.velocity),
            root=back @ state.root,
            angular_velocity=_rotated(back, state.angular_velocity),
            pose=state.pose,
            joints=joints + (self.origin + pelvis)[..., None, :],
            joint_velocities=state.joint_velocities @ self.turn,
        )


def rest_pelvis(state: State) -> Float[Tensor, "*batch 3"]:
    """Horizontal offset of the pelvis from the translation, constant for a body; z is zero."""
    level = state.translation.new_tensor([1.0, 1.0, 0.0])
    return (state.joints[..., 0, :] - state.translation) * level


def canonical_state(state: State, pelvis: Float[Tensor, "*#batch 3"]) -> State:
    """Return a state in the coordinates of its own canonical frame."""
    return Frame.of(state).to_frame(state, pelvis)


def state_after_step(
    state: State, raw: Float[Tensor, "*batch 216"]
) -> tuple[State, Float[Tensor, "*batch 9"]]:
    """Apply the decoder's output (a raw step) to a state; return next state, contact logits.

    The new state is in the frame of the old one.
    """
    parts = raw.split(_RAW_SIZES, -1)
    after = State(
        translation=state.translation + parts[0],
        velocity=state.velocity + parts[1],
        root=so3.exp(parts[2]) @ state.root,
        angular_velocity=state.angular_velocity + parts[3],
        pose=so3.exp(parts[4].unflatten(-1, (-1, 3))) @ state.pose,
        joints=state.joints + parts[5].unflatten(-1, (-1, 3)),
        joint_velocities=state.joint_velocities + parts[6].unflatten(-1, (-1, 3)),
    )
    return after, parts[7]


def contact_probabilities(
    logits: Float[Tensor, "clips steps 9"],
) -> Float[Tensor, "clips time 22"]:
    """Contact probabilities of all joints in all frames, from the logits of steps.

    No step leads to the first frame, which has those of its successor.
    """
    probability = logits.sigmoid()
    contacts = probability.new_zeros(*probability.shape[:2], len(JOINTS))
    contacts[..., cached_constant(tuple(CONTACT_JOINTS), contacts.device)] = probability
    return torch.cat((contacts[:, :1], contacts), 1)


def step_between(before: State, after: State) -> Float[Tensor, "*batch 207"]:
    """Return the decoder output with which `state_after_step` gets from one state to another.

    Turns are axes times sines of angles: those of a step are small.
    """
    pairs = zip(before.tensors().values(), after.tensors().values(), strict=True)
    rotated = {2, 4}
    parts = [so3.axis_sine(b @ a.mT) if k in rotated else b - a for k, (a, b) in enumerate(pairs)]
    batch = before.translation.shape[:-1]
    return torch.cat([part.flatten(len(batch)) for part in parts], -1)


def _rotated(turn: Float[Tensor, "*batch 3 3"], vector: Float[Tensor, "*batch 3"]) -> Tensor:
    return (turn @ vector[..., None])[..., 0]


def at_tempo(motion: Motion, tempo: float) -> Motion:
    """Resample a motion so that, when read at 30 Hz, it runs at `tempo` times its speed.

    With a tempo of 1, frames are 1/30 s apart and the last one is less than a frame after the end
    of the motion. With another, it is at the end; the tempo is changed so that frames fit.
    """
    steps = math.ceil(motion.duration * REFERENCE_FPS / tempo - 1e-6)
    if tempo == 1.0:
        return motion.resample(REFERENCE_FPS, steps / REFERENCE_FPS)
    return motion.resample(steps / motion.duration)


def relabelled_at_30_hz(motion: Motion) -> Motion:
    """Return the motion's frames unchanged with the rate set to 30 Hz, as networks read them."""
    return motion.replace(fps=REFERENCE_FPS)


def states_of(motion: Motion, body: BodyModel) -> State:
    """Return HuMoR's states of all frames of a body's motion; see `posed_states`.

    Raises:
        ValueError: when a clip has fewer than two frames.
    """
    if bool((motion.valid.sum(-1) < 2).any()):
        raise ValueError("velocities need at least two frames of every clip; got one")
    return posed_states(motion, body.pose(motion).joints)


def posed_states(motion: Motion, joints: Float[Tensor, "*batch time 22 3"]) -> State:
    """HuMoR's states, axes (clips, time), of a motion whose joints are known.

    Velocities are central differences inside, one-sided ones at both ends of what exists (HuMoR,
    section 1.5, at the motion's own rate). Every clip has at least two frames.
    """
    roots = motion.rotations[..., 0, :, :]
    spin = so3.log(roots[..., 1:, :, :] @ roots[..., :-1, :, :].mT)
    return State(
        translation=motion.translation,
        velocity=_mean_rate(motion.translation.diff(dim=-2), motion),
        root=roots,
        angular_velocity=_mean_rate(spin, motion),
        pose=motion.rotations[..., 1:, :, :],
        joints=joints,
        joint_velocities=_mean_rate(joints.diff(dim=-3).flatten(-2), motion).unflatten(
            -1, (-1, 3)
        ),
    )


def _mean_rate(steps: Float[Tensor, "*batch steps numbers"], motion: Motion) -> Tensor:
    """Velocity of each frame: mean of the steps before and after it that exist, per second."""
    exists = motion.pairs[..., None].to(steps)
    end = torch.zeros_like(exists[..., :1, :])
    after, before = torch.cat((exists, end), -2), torch.cat((end, exists), -2)
    none = torch.zeros_like(steps[..., :1, :])
    total = torch.cat((steps * exists, none), -2) + torch.cat((none, steps * exists), -2)
    return total / (after + before).clamp(min=1) * motion.fps


def initial_features(state: State) -> Float[Tensor, "*batch 138"]:
    """The 138 numbers of a state that the mixture is over: joints and all velocities."""
    parts = (
        state.joints.flatten(-2),
        state.joint_velocities.flatten(-2),
        state.velocity,
        state.angular_velocity,
    )
    return torch.cat(parts, -1)


def independent_features() -> Int[Tensor, " features"]:
    """Indices of `initial_features` that cannot be computed from other features.

    The pelvis is where the rest pelvis is, horizontally, and moves as the translation does.
    """
    joints = 3 * len(JOINTS)
    repeated = {0, 1, joints, joints + 1, joints + 2}
    return torch.tensor([k for k in range(2 * joints + 6) if k not in repeated])


def posed_joints(state: State, rest: Float[Tensor, "clips 22 3"]) -> Float[Tensor, "clips 22 3"]:
    """Joints of the posed body by its translation and rotations, metres."""
    return forward_kinematics(state.rotations[:, None], rest)[1][:, 0] + state.translation[:, None]
