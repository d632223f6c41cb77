"""HuMoR's decoder unrolled over many steps, with its derivative written by hand for speed.

In the loop a canonical state is 337 numbers. The horizontal place, which is zero, is left out;
joints are seen from where the pelvis is at rest and, after a step, from where the translation
has come to. So a state is brought to its own heading by turning 46 vectors and the root, no more;
what the changes of origin would do is part of the weights. In order: x of all vectors, y, z; the
height of the translation; 22 rotations.
"""

from dataclasses import dataclass
from math import pi
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from priors.humor.networks import LATENT, RAW, STATE, Perceptron
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.core.skeleton import JOINTS

VECTORS = 2 + 2 * len(JOINTS)
"""Velocity of the translation, of the root's turning, joints, velocities of joints."""

JOINTS_OF_VECTORS = slice(2, 2 + len(JOINTS))

LEVEL = 2 * VECTORS
"""Numbers of the vectors' horizontal parts."""

MOVED = 3 * VECTORS + 1
"""Numbers that a step adds to: vectors and height."""

SPIN = 3 * len(JOINTS)

_UPRIGHT = 1e-12
"""Added to the right side's x, so that a body lying on its side has a heading: none."""


def _starts_of_vectors(velocity: int, spin: int, joints: int) -> list[int]:
    """Index of each vector's first coordinate in a packed state, or in the decoder's output."""
    return [velocity, spin, *range(joints, joints + 6 * len(JOINTS), 3)]


def _indices_in_loop_order(vector_starts: list[int], height: int, *others: range) -> list[int]:
    order = [start + axis for axis in range(3) for start in vector_starts]
    return [*order, height, *(place for places in others for place in places)]


_STATE_STARTS, _RAW_STARTS = _starts_of_vectors(3, 15, 207), _starts_of_vectors(3, 9, 75)

STATE_ORDER = torch.tensor(_indices_in_loop_order(_STATE_STARTS, 2, range(6, 15), range(18, 207)))
"""Indices of the loop's numbers in a packed state."""

_RAW_ORDER = torch.tensor(
    _indices_in_loop_order(_RAW_STARTS, 2, range(6, 9), range(12, 75), range(2), range(207, RAW))
)


@dataclass(frozen=True)
class FrozenDecoder:
    """The decoder's weights, transposed, with inputs and outputs in the order of the roll-out.

    Its outputs: what is added to vectors and height; half of each rotation vector; the horizontal
    move of the translation; contact logits.
    """

    layers: tuple[Float[Tensor, "_ _"], ...]
    """Weights of each layer for the state or the units of the layer before."""
    of_constants: Float[Tensor, "50 all_outputs"]
    """Weights of all layers, side by side, for the inputs latent and pelvis of a step."""
    bias: Float[Tensor, " all_outputs"]
    norms: tuple[tuple[Float[Tensor, " _"], Float[Tensor, " _"]], ...]
    """Scale and shift of the units."""
    groups: int
    epsilon: float
    """Added to the variance of a group."""

    @classmethod
    def of(cls, decoder: Perceptron) -> "FrozenDecoder":
        """Copy the weights of a decoder network, detached from it, into the loop's layout."""
        linear = [m for m in decoder.net if isinstance(m, nn.Linear)]
        norms = [m for m in decoder.net if isinstance(m, nn.GroupNorm)]
        weights = [m.weight.detach() for m in linear]
        biases = [m.bias.detach() for m in linear]
        weights[-1], biases[-1] = (
            _last_layer_in_loop_order(weights[-1]),
            _last_layer_in_loop_order(biases[-1]),
        )
        inputs = [w[:, : w.shape[1] - LATENT].mT.clone() for w in weights]
        latent = torch.cat([w[:, w.shape[1] - LATENT :].mT for w in weights], 1)
        place = latent.new_zeros(2, latent.shape[1])
        joints = torch.tensor(_STATE_STARTS[JOINTS_OF_VECTORS])
        for axis in range(2):
            place[axis, : len(biases[0])] = inputs[0][joints + axis].sum(0)
        return cls(
            layers=(inputs[0][STATE_ORDER], *inputs[1:]),
            of_constants=torch.cat((latent, place)),
            bias=torch.cat(biases),
            norms=tuple((m.weight.detach().clone(), m.bias.detach().clone()) for m in norms),
            groups=norms[0].num_groups,
            epsilon=norms[0].eps,
        )

    def constant_inputs(
        self, latents: Float[Tensor, "*batch 48"], pelvis: Float[Tensor, "*#batch 3"]
    ) -> Float[Tensor, "*batch all_outputs"]:
        """What latents, pelvis and biases add to the linear outputs of all layers."""
        place = pelvis[..., :2].expand(*latents.shape[:-1], 2)
        return torch.cat((latents, place), -1) @ self.of_constants + self.bias

    def split_by_layer(self, added: Float[Tensor, "*batch all_outputs"]) -> tuple[Tensor, ...]:
        """Split what `constant_inputs` returns into one tensor per layer."""
        return added.split([weight.shape[1] for weight in self.layers], -1)

    def grouped(self, units: Float[Tensor, "*batch units"]) -> Float[Tensor, "*batch groups _"]:
        """Reshape hidden units to the groups that group normalisation normalises together."""
        return units.view(*units.shape[:-1], self.groups, -1)

    def __call__(
        self, x: Float[Tensor, "batch 337"], added: tuple[Tensor, ...]
    ) -> tuple[Tensor, ...]:
        """Return the linear outputs of all layers; the last one's are the decoder's output."""
        units: list[Tensor] = []
        for weight, bias, norm in zip(self.layers[:-1], added[:-1], self.norms, strict=True):
            units.append(torch.addmm(bias, x, weight))
            groups = self.grouped(units[-1])
            normal = functional.layer_norm(groups, groups.shape[2:], eps=self.epsilon)
            x = torch.addcmul(norm[1], normal.flatten(1), norm[0]).relu_()
        return (*units, torch.addmm(added[-1], x, self.layers[-1]))


def _last_layer_in_loop_order(rows: Float[Tensor, "outputs ..."]) -> Float[Tensor, "outputs ..."]:
    """Reorder the last layer's rows for the loop, with joints relative to the translation."""
    looped = rows[_RAW_ORDER]
    for axis in range(2):
        joints = slice(VECTORS * axis + 2, VECTORS * axis + 2 + len(JOINTS))
        looped[joints] -= rows[axis]
    looped[MOVED : MOVED + SPIN] /= 2
    return looped


@dataclass(frozen=True)
class HeadingRotation:
    """Computes the rotation about the vertical that brings a state to its canonical frame.

    The body's right side along +x.
    """

    upright: Float[Tensor, " 2"]
    quarters: Float[Tensor, "2 4"]
    """The matrix that maps (c, s) to (c, s, -s, c)."""

    @classmethod
    def like(cls, tensor: Tensor) -> "HeadingRotation":
        """Make the constants `upright` and `quarters` with a tensor's precision and device."""
        quarters = ((1.0, 0.0, 0.0, 1.0), (0.0, 1.0, -1.0, 0.0))
        like = (tensor.device, tensor.dtype)
        return cls(cached_constant((_UPRIGHT, 0.0), *like), cached_constant(quarters, *like))

    def right_side(self, turns: Float[Tensor, "*batch 22 3 3"]) -> Float[Tensor, "*batch 2"]:
        """Horizontal part of the vector to the body's right, not normalised."""
        return self.upright - turns[..., 0, :2, 0]

    def heading(self, turns: Float[Tensor, "*batch 22 3 3"]) -> Float[Tensor, "*batch 2"]:
        """Horizontal unit vector (c, s) to the body's right, which defines its heading."""
        side = self.right_side(turns)
        return side / torch.linalg.vector_norm(side, dim=-1, keepdim=True)

    def __call__(self, turns: Float[Tensor, "*batch 22 3 3"]) -> Float[Tensor, "*batch 2 2"]:
        """Return the rotation [[c, s], [-s, c]] of horizontal vectors into the canonical frame."""
        return (self.heading(turns) @ self.quarters).unflatten(-1, (2, 2))


@dataclass(frozen=True)
class RolledOutSteps:
    """States and decoder outputs of a roll-out, in the canonical frames of the steps' starts."""

    inputs: Float[Tensor, "steps batch 337"]
    """The state from which each step starts."""
    vectors: Float[Tensor, "steps batch 139"]
    """Vectors and height of the state to which each step leads."""
    turns: Float[Tensor, "steps batch 22 3 3"]
    rest: Float[Tensor, "steps batch 77"]
    """Half of the rotation vectors, the translation's horizontal move, contact logits."""


def _rolled_out(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 337"],
    added: Float[Tensor, "steps batch all_outputs"],
) -> tuple[RolledOutSteps, list[Float[Tensor, "steps batch _"]]]:
    """Roll out all steps from a canonical state; also return every hidden layer's outputs."""
    turn = HeadingRotation.like(start)
    x = start
    records: list[tuple[Tensor, ...]] = []
    for each in zip(*(part.unbind(0) for part in decoder.split_by_layer(added)), strict=True):
        *units, raw = decoder(x, each)
        change, rest = raw[:, :MOVED], raw[:, MOVED:]
        before, matrices = x[:, :MOVED], x[:, MOVED:].view(-1, len(JOINTS), 3, 3)
        vectors = before + change
        turns = _rotated_by_twice(rest[:, :SPIN].view(-1, len(JOINTS), 3), matrices)
        records.append((x, vectors, turns, rest, *units))
        to_own = turn(turns)
        level = torch.bmm(to_own, vectors[:, :LEVEL].view(-1, 2, VECTORS))
        root = torch.bmm(to_own, turns[:, 0, :2])
        parts = (level.flatten(1), vectors[:, LEVEL:], root.flatten(1), turns.flatten(1)[:, 6:])
        x = torch.cat(parts, 1)
    inputs, vectors, turns, rest, *units = (torch.stack(r) for r in zip(*records, strict=True))
    return RolledOutSteps(inputs, vectors, turns, rest), units


def _rotated_by_twice(
    half: Float[Tensor, "batch 22 3"], matrix: Float[Tensor, "batch 22 3 3"]
) -> Float[Tensor, "batch 22 3 3"]:
    """Return Exp(2 half) m by the unit quaternion (c, q): m + 2 q × (c m + q × m)."""
    angle = torch.linalg.vector_norm(half, dim=-1, keepdim=True)
    c, q = angle.cos()[..., None], (torch.sinc(angle / pi) * half)[..., None]
    once = torch.linalg.cross(q, matrix, dim=-2)
    twice = torch.linalg.cross(q, torch.addcmul(once, c, matrix), dim=-2)
    return torch.add(matrix, twice, alpha=2)


assert len(STATE_ORDER) == STATE - 2


def roll_out_with_biases(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 337"],
    added: Float[Tensor, "steps batch all_outputs"],
) -> RolledOutSteps:
    """Roll out steps from a canonical state with given biases of layers; differentiable once."""
    return RolledOutSteps(*_RollOut.apply(start, added, decoder))


class _RollOut(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, start: Tensor, biases: Tensor, decoder: FrozenDecoder
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        made, activations = _rolled_out(decoder, start, biases)
        ctx.decoder = decoder
        ctx.save_for_backward(made.inputs, made.turns, made.rest, *activations)
        return made.inputs, made.vectors, made.turns, made.rest

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *gradients: Tensor
    ) -> tuple[Tensor, Tensor, None]:
        inputs, turns, rest, *units = ctx.saved_tensors
        decoder: FrozenDecoder = ctx.decoder
        layers = [_LayerBackward.of(decoder, k, values) for k, values in enumerate(units)][::-1]
        exponential, jacobian = _adjoints_of_rotation(rest[..., :SPIN].unflatten(-1, (-1, 3)))
        to_own = HeadingRotation.like(turns)(turns).mT
        quarter = _derivatives_by_heading(inputs)[..., None]
        heading = _heading_adjoints(turns)

        # gradients by steps' starts, outputs, rotations; later steps' are added to earlier ones'
        starts = gradients[0].clone()
        raws = torch.cat((gradients[1], gradients[3]), -1)
        ends = gradients[2].flatten(2).contiguous().clone()
        for t in reversed(range(len(inputs))):
            start, raw, end = starts[t], raws[t], ends[t]
            if t + 1 < len(inputs):
                ahead = starts[t + 1]
                _horizontal_vectors(raw).baddbmm_(to_own[t], _horizontal_vectors(ahead))
                raw[:, LEVEL:MOVED].add_(ahead[:, LEVEL:MOVED])
                _horizontal_root(end).baddbmm_(to_own[t], _horizontal_root(ahead[:, MOVED:]))
                end[:, 6:].add_(ahead[:, MOVED + 6 :])
                angle = torch.bmm(ahead[:, None], quarter[t + 1])[:, 0]
                end[:, :6:3].addcmul_(angle, heading[t])
            matrices = end.view(-1, 3, 3)
            axial = torch.linalg.cross(turns[t].view(-1, 3, 3), matrices, dim=1).sum(2, True)
            raw[:, MOVED : MOVED + SPIN].add_(torch.bmm(jacobian[t], axial).view(len(raw), -1))
            g = raw
            for layer in layers:
                g = layer.backward_step(g, t)
            start.addmm_(g, decoder.layers[0].mT)
            start[:, :MOVED].add_(raw[:, :MOVED])
            start[:, MOVED:].add_(torch.bmm(exponential[t], matrices).view(len(raw), -1))
        hidden = [torch.stack(layer.gradients[::-1]) for layer in reversed(layers)]
        return starts[0], torch.cat((*hidden, raws), -1), None


def _horizontal_vectors(
    gradient: Float[Tensor, "batch numbers"],
) -> Float[Tensor, "batch 2 vectors"]:
    return gradient[:, :LEVEL].view(-1, 2, LEVEL // 2)


def _horizontal_root(gradient: Float[Tensor, "batch 198"]) -> Float[Tensor, "batch 2 3"]:
    """The x and y rows (2, 3) of the gradient by the root's rotation matrix."""
    return gradient[:, :6].view(-1, 2, 3)


@dataclass(frozen=True)
class _LayerBackward:
    """Backward pass of one layer, for every step."""

    weight: Float[Tensor, "outputs units"]
    gates: Float[Tensor, "steps batch units"]
    """Derivative of the ReLU times the scale: 0 for units that are off, else their scale."""
    groups: Float[Tensor, "steps batch groups _"]
    means: Float[Tensor, "steps batch groups 1"]
    deviations: Float[Tensor, "steps batch groups 1"]
    """Inverse standard deviations, as torch returns them."""
    gradients: list[Float[Tensor, "batch units"]]
    """Gradients of the outputs of the layer before; the last step first."""

    @classmethod
    def of(
        cls, decoder: FrozenDecoder, layer: int, units: Float[Tensor, "steps batch units"]
    ) -> "_LayerBackward":
        groups = decoder.grouped(units)
        scale, shift = decoder.norms[layer]
        normal, mean, deviation = torch.native_layer_norm(
            groups, groups.shape[3:], None, None, decoder.epsilon
        )
        active = torch.addcmul(shift, normal.flatten(2), scale) > 0
        return cls(
            weight=decoder.layers[layer + 1].mT,
            gates=scale * active,
            groups=groups,
            means=mean,
            deviations=deviation,
            gradients=[],
        )

    def backward_step(
        self, gradient: Float[Tensor, "batch outputs"], step: int
    ) -> Float[Tensor, "batch units"]:
        groups = self.groups[step]
        gradient = torch.mm(gradient, self.weight).mul_(self.gates[step]).view_as(groups)
        of_input, *_ = torch.ops.aten.native_layer_norm_backward(
            gradient, groups, groups.shape[2:], self.means[step], self.deviations[step],
            None, None, [True, False, False],
        )  # fmt: skip
        self.gradients.append(of_input.flatten(1))
        return self.gradients[-1]


def _adjoints_of_rotation(
    half: Float[Tensor, "steps batch 22 3"],
) -> tuple[Float[Tensor, "steps joints 3 3"], Float[Tensor, "steps joints 3 3"]]:
    """Transposed derivatives of R' = Exp(2 h) R by R and h, where 2 h is a rotation vector.

    The first is of dR. The second is of dh: 2 Jᵀ = 2 (I - b hat(v) + d hat(v)²), J the left
    Jacobian of SO(3) at v = 2 h, with b = (1 - cos a)/a², d = (1 - sin(a)/a)/a², a = |v|.
    """
    vector = 2 * half.flatten(1, 2)
    angle = torch.linalg.vector_norm(vector, dim=-1)[..., None, None]
    b = torch.sinc(angle / (2 * pi)).square()
    d = 2 * (1 - torch.sinc(angle / pi)) / angle.square().clamp(min=_MIN_SQUARED_ANGLE)
    hat = so3.hat(vector)
    identity = torch.eye(3).to(half)
    return so3.exp(vector).mT, torch.addcmul(2 * identity - b * hat, d, hat @ hat)


_MIN_SQUARED_ANGLE = 1e-30
"""Least squared angle; a smaller one would be zero in a denominator."""


def _derivatives_by_heading(
    inputs: Float[Tensor, "steps batch 337"],
) -> Float[Tensor, "steps batch 337"]:
    """Derivatives of canonical states by the angle that rotates them into their frame."""
    turned = torch.zeros_like(inputs)
    for first, numbers in ((0, LEVEL // 2), (MOVED, 3)):
        x, y = slice(first, first + numbers), slice(first + numbers, first + 2 * numbers)
        turned[..., x], turned[..., y] = inputs[..., y], -inputs[..., x]
    return turned


def _heading_adjoints(
    turns: Float[Tensor, "steps batch 22 3 3"],
) -> Float[Tensor, "steps batch 2"]:
    """Derivatives of the heading angle by x and y of the root rotation's first column."""
    x, y = HeadingRotation.like(turns).right_side(turns).unbind(-1)
    return torch.stack((y, -x), -1) / (x.square() + y.square())[..., None]
