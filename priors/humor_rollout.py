"""Rolling HuMoR's decoder out over time: a loop with as little in it as can be.

The weights are frozen, so their derivatives are never formed. What the latents add to every layer
is one product for all steps beforehand; what the conditional prior says of every step, and where
each step lies in the world, is computed for all steps afterwards. Inside the loop a state is laid
out by coordinates, all x, all y, all z, then all rotations, so that turning it to its own heading
is one small product.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from priors.humor_nets import LATENT, RAW, STATE, Perceptron
from priors.humor_state import Frame, State
from recon.kinematics import forward_kinematics
from recon.skeleton import JOINTS
from recon.struct import TensorStruct

_VECTORS = 3 + 2 * len(JOINTS)
"""Of a state: translation, its velocity, that of the root's turning, joints, their velocities."""

_JOINTS = slice(3, 3 + len(JOINTS))
"""The joints among the vectors."""

_PLANAR = 3 * _VECTORS

_UPRIGHT = 1e-12
"""Added to the right side's x, so that a body lying on its side has a heading: none."""


@dataclass(frozen=True)
class FrozenDecoder:
    """The decoder's weights, transposed, with their inputs and outputs in the loop's layout."""

    layers: tuple[Float[Tensor, "_ _"], ...]
    """From the state or the units before."""
    latent: Float[Tensor, "48 all_outputs"]
    """From the latent to all layers' outputs side by side."""
    bias: Float[Tensor, " all_outputs"]
    norms: tuple[tuple[Float[Tensor, " _"], Float[Tensor, " _"]], ...]
    groups: int

    @classmethod
    def of(cls, decoder: Perceptron) -> "FrozenDecoder":
        """A copy of a network's weights, cut from it."""
        linear = [m for m in decoder.net if isinstance(m, nn.Linear)]
        norms = [m for m in decoder.net if isinstance(m, nn.GroupNorm)]
        rows = _planar(_STATE_STARTS, _STATE_TURNS, STATE)
        columns = _planar(_RAW_STARTS, _RAW_TURNS, RAW)
        weights = [m.weight.detach() for m in linear]
        biases = [m.bias.detach() for m in linear]
        weights[-1], biases[-1] = weights[-1][columns], biases[-1][columns]
        inputs = [w[:, : w.shape[1] - LATENT].mT.clone() for w in weights]
        inputs[0] = inputs[0][rows]
        return cls(
            layers=tuple(inputs),
            latent=torch.cat([w[:, w.shape[1] - LATENT :].mT for w in weights], 1),
            bias=torch.cat(biases),
            norms=tuple((m.weight.detach().clone(), m.bias.detach().clone()) for m in norms),
            groups=norms[0].num_groups,
        )

    def biases(self, latents: Float[Tensor, "*batch 48"]) -> tuple[Tensor, ...]:
        """What the latents and the biases add to each layer."""
        added = latents @ self.latent + self.bias
        return added.split([len(w[0]) for w in self.layers], -1)

    def __call__(
        self, x: Float[Tensor, "batch 339"], biases: tuple[Tensor, ...]
    ) -> Float[Tensor, "batch 216"]:
        """The raw step from a state, both in the loop's layout."""
        for weight, bias, (scale, shift) in zip(
            self.layers[:-1], biases[:-1], self.norms, strict=True
        ):
            x = torch.addmm(bias, x, weight)
            x = functional.group_norm(x, self.groups, scale, shift).relu_()
        return torch.addmm(biases[-1], x, self.layers[-1])


@dataclass(frozen=True)
class Rollout(TensorStruct):
    """Steps in a row; each in the canonical frame of the state it starts from."""

    inputs: Float[Tensor, "batch steps 339"]
    """Where each step starts: packed canonical states."""
    states: State
    """Where it leads, axes (batch, steps)."""
    contacts: Float[Tensor, "batch steps 9"]
    """Logits."""
    headings: Float[Tensor, "batch steps 2"]
    """Unit vector (rx, ry) to the right of the body there."""

    def frames(self, first: Frame) -> Frame:
        """The canonical frame of every step in the world, given that of the first.

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
        """All states reached, in the frame that the first one's frame is given in."""
        return self.frames(first).leave(self.states, pelvis[:, None])


def roll_out(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 339"],
    pelvis: Float[Tensor, "batch 3"],
    latents: Float[Tensor, "batch steps 48"],
    rest: Float[Tensor, "batch 22 3"] | None = None,
) -> Rollout:
    """The steps that given latents make.

    Args:
        decoder: frozen weights.
        start: packed canonical state.
        pelvis: horizontal offset of the pelvis from the translation, constant for a body.
        latents: of every step.
        rest: joints of the unposed body; if given, every step starts from the joints that its
            body has, not from those that the network predicted (HuMoR-Qual).
    """
    biases = [b.unbind(0) for b in decoder.biases(latents.transpose(0, 1))]
    ready = list(zip(*biases, strict=True))
    return _loop(decoder, start, pelvis, len(ready), lambda step, _: ready[step], rest)


Draw = Callable[[Float[Tensor, "batch 339"]], Float[Tensor, "batch 48"]]
"""A latent for the step that starts at a packed canonical state."""


def roll_on(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 339"],
    pelvis: Float[Tensor, "batch 3"],
    steps: int,
    draw: Draw,
    rest: Float[Tensor, "batch 22 3"] | None = None,
) -> Rollout:
    """As many steps as asked for, their latents drawn on the way."""
    back = _planar(_STATE_STARTS, _STATE_TURNS, STATE).to(start.device).argsort()

    def biases(_: int, x: Tensor) -> tuple[Tensor, ...]:
        return decoder.biases(draw(x[:, back]))

    return _loop(decoder, start, pelvis, steps, biases, rest)


def _loop(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 339"],
    pelvis: Float[Tensor, "batch 3"],
    steps: int,
    biases: Callable[[int, Tensor], tuple[Tensor, ...]],
    rest: Float[Tensor, "batch 22 3"] | None,
) -> Rollout:
    order = _planar(_STATE_STARTS, _STATE_TURNS, STATE).to(start.device)
    about, moving = _masks(start)
    offset = pelvis[:, :2, None] * about
    upright = start.new_tensor([_UPRIGHT, 0.0])
    quarter = start.new_tensor([[0.0, 1.0], [-1.0, 0.0]])

    x = start[:, order]
    inputs: list[Tensor] = []
    vectors: list[Tensor] = []
    turns: list[Tensor] = []
    contacts: list[Tensor] = []
    headings: list[Tensor] = []
    for step in range(steps):
        raw = decoder(x, biases(step, x))
        change, spin, logits = raw.split((_PLANAR, RAW - _PLANAR - 9, 9), 1)
        before, rotations = x.split((_PLANAR, STATE - _PLANAR), 1)
        v = (before + change).view(-1, 3, _VECTORS)
        r = _turned(spin.view(-1, len(JOINTS), 3), rotations.view(-1, len(JOINTS), 3, 3))
        right = functional.normalize(upright - r[:, 0, :2, 0], dim=-1)
        inputs.append(x)
        vectors.append(v)
        turns.append(r)
        contacts.append(logits)
        headings.append(right)

        if rest is not None:
            v = _with_joints(v, r, rest)
        turn = torch.stack((right, right @ quarter), 1)
        level = torch.addcmul(v[:, :2], v[:, :2, :1], moving, value=-1) - offset
        level = torch.baddbmm(offset, turn, level)
        root = turn @ r[:, 0, :2]
        parts = (level.flatten(1), v[:, 2], root.flatten(1), r.flatten(1)[:, 6:])
        x = torch.cat(parts, 1)
    v, r = torch.stack(vectors, 1), torch.stack(turns, 1)
    vector = v.transpose(-1, -2)
    states = State(
        translation=vector[..., 0, :],
        velocity=vector[..., 1, :],
        root=r[..., 0, :, :],
        angular_velocity=vector[..., 2, :],
        pose=r[..., 1:, :, :],
        joints=vector[..., _JOINTS, :],
        joint_velocities=vector[..., _JOINTS.stop :, :],
    )
    packed = torch.stack(inputs, 1)[..., order.argsort()]
    return Rollout(packed, states, torch.stack(contacts, 1), torch.stack(headings, 1))


def _turned(
    vector: Float[Tensor, "batch 22 3"], matrix: Float[Tensor, "batch 22 3 3"]
) -> Float[Tensor, "batch 22 3 3"]:
    """Exp(vector) matrix, column by column: m + sin(a)/a v × m + (1 - cos a)/a² v × (v × m).

    A half angle no smaller than 1e-9 keeps value and derivative exact to double precision at
    zero; with h = a/2 the factors are s cos h and s²/2, s = sin(h)/h, free of cancellation.
    """
    half = (vector.square().sum(-1, keepdim=True) + 4e-18).sqrt() / 2
    s = half.sin() / half
    axis = vector[..., None]
    once = torch.linalg.cross(axis, matrix, dim=-2)
    twice = torch.linalg.cross(axis, once, dim=-2)
    a, b = (s * half.cos())[..., None], (0.5 * s.square())[..., None]
    return torch.addcmul(torch.addcmul(matrix, a, once), b, twice)


def _with_joints(
    vectors: Float[Tensor, "batch 3 47"],
    rotations: Float[Tensor, "batch 22 3 3"],
    rest: Float[Tensor, "batch 22 3"],
) -> Float[Tensor, "batch 3 47"]:
    """The vectors with the body's joints in place of the predicted ones."""
    joints = forward_kinematics(rotations[:, None], rest)[1][:, 0].mT + vectors[:, :, :1]
    return torch.cat((vectors[..., : _JOINTS.start], joints, vectors[..., _JOINTS.stop :]), -1)


def _masks(like: Tensor) -> tuple[Float[Tensor, " vectors"], Float[Tensor, " vectors"]]:
    """Vectors that turn about the pelvis, the joints; and those that move with the origin."""
    about, moving = like.new_zeros(_VECTORS), like.new_zeros(_VECTORS)
    about[_JOINTS] = 1
    moving[_JOINTS] = 1
    moving[0] = 1
    return about, moving


_STATE_STARTS = (0, 3, 15, 207, 273)
_RAW_STARTS = (0, 3, 9, 75, 141)
"""Where translation, velocity, angular velocity, joints and their velocities begin."""

_STATE_TURNS = (slice(6, 15), slice(18, 207))
_RAW_TURNS = (slice(6, 9), slice(12, 75))
"""Where root and pose are."""


def _planar(starts: tuple[int, ...], turns: tuple[slice, ...], size: int) -> Int[Tensor, " n"]:
    """For every number in the loop's layout, where the networks have it."""
    first = [*starts[:3], *(s + 3 * j for s in starts[3:] for j in range(len(JOINTS)))]
    order = [place + axis for axis in range(3) for place in first]
    order += [place for turn in turns for place in range(turn.start, turn.stop)]
    order += sorted(set(range(size)) - set(order))  # the contact logits, last in both
    return torch.tensor(cast(list[int], order))
