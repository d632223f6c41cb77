"""The derivative of HuMoR's roll-out, written out.

Recorded operation by operation, the derivative of so small steps is mostly bookkeeping. Here
everything that does not wait for a later step is computed for all steps at once from what the
roll-out has reached; what is left walks the steps backwards in about twenty operations each.
"""

from dataclasses import dataclass
from math import pi
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from priors.humor.decoder.loop import LEVEL, MOVED, SPIN, FrozenDecoder, Turn, Unrolled, unroll
from recon.core import rotations as so3


def unroll_given(
    decoder: FrozenDecoder,
    start: Float[Tensor, "batch 337"],
    added: Float[Tensor, "steps batch all_outputs"],
) -> Unrolled:
    """Steps from a canonical state, given what is added to all layers; differentiable once."""
    return Unrolled(*_Unroll.apply(start, added, decoder))


class _Unroll(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, start: Tensor, added: Tensor, decoder: FrozenDecoder
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        ready = list(zip(*(part.unbind(0) for part in decoder.split(added)), strict=True))
        made, units = unroll(decoder, start, len(ready), lambda step, _: ready[step])
        ctx.decoder = decoder
        ctx.save_for_backward(made.inputs, made.turns, made.rest, *units)
        return made.inputs, made.vectors, made.turns, made.rest

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *gradients: Tensor
    ) -> tuple[Tensor, Tensor, None]:
        inputs, turns, rest, *units = ctx.saved_tensors
        decoder: FrozenDecoder = ctx.decoder
        layers = [_Layer.of(decoder, k, values) for k, values in enumerate(units)][::-1]
        exponential, jacobian = _turned_adjoints(rest[..., :SPIN].unflatten(-1, (-1, 3)))
        to_own = Turn.like(turns)(turns).mT
        quarter = _quarter_turned(inputs)[..., None]
        heading = _heading_adjoints(turns)

        # Gradients of where a step starts, of the raw step and of the turns it reaches, to which
        # is added what comes back from the step ahead.
        starts = gradients[0].clone()
        raws = torch.cat((gradients[1], gradients[3]), -1)
        ends = gradients[2].flatten(2).contiguous().clone()
        for t in reversed(range(len(inputs))):
            start, raw, end = starts[t], raws[t], ends[t]
            if t + 1 < len(inputs):
                ahead = starts[t + 1]
                _level(raw).baddbmm_(to_own[t], _level(ahead))
                raw[:, LEVEL:MOVED].add_(ahead[:, LEVEL:MOVED])
                _root(end).baddbmm_(to_own[t], _root(ahead[:, MOVED:]))
                end[:, 6:].add_(ahead[:, MOVED + 6 :])
                angle = torch.bmm(ahead[:, None], quarter[t + 1])[:, 0]
                end[:, :6:3].addcmul_(angle, heading[t])
            matrices = end.view(-1, 3, 3)
            axial = torch.linalg.cross(turns[t].view(-1, 3, 3), matrices, dim=1).sum(2, True)
            raw[:, MOVED : MOVED + SPIN].add_(torch.bmm(jacobian[t], axial).view(len(raw), -1))
            g = raw
            for layer in layers:
                g = layer.back(g, t)
            start.addmm_(g, decoder.layers[0].mT)
            start[:, :MOVED].add_(raw[:, :MOVED])
            start[:, MOVED:].add_(torch.bmm(exponential[t], matrices).view(len(raw), -1))
        hidden = [torch.stack(layer.gradients[::-1]) for layer in reversed(layers)]
        return starts[0], torch.cat((*hidden, raws), -1), None


def _level(g: Float[Tensor, "batch numbers"]) -> Float[Tensor, "batch 2 vectors"]:
    return g[:, :LEVEL].view(-1, 2, LEVEL // 2)


def _root(g: Float[Tensor, "batch 198"]) -> Float[Tensor, "batch 2 3"]:
    """The horizontal parts of the root's columns."""
    return g[:, :6].view(-1, 2, 3)


@dataclass(frozen=True)
class _Layer:
    """Back from what a layer gives to what the layer before gave, for every step."""

    weight: Float[Tensor, "outputs units"]
    gates: Float[Tensor, "steps batch units"]
    """Scale of a unit where it is not zero."""
    groups: Float[Tensor, "steps batch groups _"]
    means: Float[Tensor, "steps batch groups 1"]
    deviations: Float[Tensor, "steps batch groups 1"]
    """One by the root of the variance."""
    gradients: list[Float[Tensor, "batch units"]]
    """Gradients of the outputs of the layer before; the last step first."""

    @classmethod
    def of(
        cls, decoder: FrozenDecoder, k: int, units: Float[Tensor, "steps batch units"]
    ) -> "_Layer":
        groups = decoder.grouped(units)
        scale, shift = decoder.norms[k]
        normal, mean, deviation = torch.native_layer_norm(
            groups, groups.shape[3:], None, None, decoder.epsilon
        )
        active = torch.addcmul(shift, normal.flatten(2), scale) > 0
        return cls(
            weight=decoder.layers[k + 1].mT,
            gates=scale * active,
            groups=groups,
            means=mean,
            deviations=deviation,
            gradients=[],
        )

    def back(self, g: Float[Tensor, "batch outputs"], t: int) -> Float[Tensor, "batch units"]:
        groups = self.groups[t]
        g = torch.mm(g, self.weight).mul_(self.gates[t]).view_as(groups)
        of_input, *_ = torch.ops.aten.native_layer_norm_backward(
            g, groups, groups.shape[2:], self.means[t], self.deviations[t], None, None,
            [True, False, False],
        )  # fmt: skip
        self.gradients.append(of_input.flatten(1))
        return self.gradients[-1]


def _turned_adjoints(
    half: Float[Tensor, "steps batch 22 3"],
) -> tuple[Float[Tensor, "steps joints 3 3"], Float[Tensor, "steps joints 3 3"]]:
    """What R' = Exp(2 h) R does to small changes, dR' = hat(2 J dh) R' + Exp(2 h) dR, transposed.

    The first is of dR. The second is of dh: 2 Jᵀ = 2 (I - b hat(v) + d hat(v)²), J the left
    Jacobian of SO(3) at v = 2 h, with b = (1 - cos a)/a², d = (1 - sin(a)/a)/a², a = |v|.
    """
    vector = 2 * half.flatten(1, 2)
    angle = torch.linalg.vector_norm(vector, dim=-1)[..., None, None]
    b = torch.sinc(angle / (2 * pi)).square()
    d = 2 * (1 - torch.sinc(angle / pi)) / angle.square().clamp(min=_SMALLEST)
    hat = so3.hat(vector)
    identity = torch.eye(3).to(half)
    return so3.exp(vector).mT, torch.addcmul(2 * identity - b * hat, d, hat @ hat)


_SMALLEST = 1e-30
"""Least squared angle; a smaller one would be zero in a denominator."""


def _quarter_turned(inputs: Float[Tensor, "steps batch 337"]) -> Float[Tensor, "steps batch 337"]:
    """Derivatives of canonical states by the angle of the turn to their heading."""
    turned = torch.zeros_like(inputs)
    for first, numbers in ((0, LEVEL // 2), (MOVED, 3)):
        x, y = slice(first, first + numbers), slice(first + numbers, first + 2 * numbers)
        turned[..., x], turned[..., y] = inputs[..., y], -inputs[..., x]
    return turned


def _heading_adjoints(
    turns: Float[Tensor, "steps batch 22 3 3"],
) -> Float[Tensor, "steps batch 2"]:
    """Derivatives of the angle of the heading by the first column of the root's rotation."""
    x, y = Turn.like(turns).side(turns).unbind(-1)
    return torch.stack((y, -x), -1) / (x.square() + y.square())[..., None]
