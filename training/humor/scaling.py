"""HuMoR's networks as they are trained: with normalised inputs and outputs.

A state mixes rotation entries that hardly move with velocities that move a lot, and a step is a
hundred times smaller than a state. Scaled, all of them are learned at the same pace; the scales
are linear, so in the end they are folded into the first and last layers, and nothing of them
remains in the weights.
"""

from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from priors.humor.networks import LATENT, RAW, STATE, HumorNetworks
from priors.humor.state import Frame, State, step_between
from recon.core.struct import TensorStruct

_LEAST = 0.01
"""Smallest scale of a number of a state; what never moves is not blown up."""

_LEAST_STEP = 1e-3


@dataclass(frozen=True)
class Scaling(TensorStruct):
    """Means and standard deviations of canonical states and of one step from them."""

    state_mean: Float[Tensor, " 339"]
    state: Float[Tensor, " 339"]
    change_mean: Float[Tensor, " 339"]
    change: Float[Tensor, " 339"]
    """Standard deviation of the packed state after a step less the one before, both in the frame
    of the first."""
    raw_mean: Float[Tensor, " 216"]
    raw: Float[Tensor, " 216"]
    """Standard deviation of the decoder's outputs; one for contact logits."""

    @classmethod
    def identity(cls) -> "Scaling":
        """Return the scaling that changes nothing: means of zero, deviations of one."""
        zero, one = torch.zeros(STATE), torch.ones(STATE)
        return cls(zero, one, zero, one, torch.zeros(RAW), torch.ones(RAW))

    @classmethod
    def of(cls, world: State, rest_pelvis: Float[Tensor, "windows 3"]) -> "Scaling":
        """Means and standard deviations over windows of consecutive states (windows, frames)."""
        past, future = world[:, :-1], world[:, 1:]
        frame = Frame.of(past)
        before = frame.to_frame(past, rest_pelvis[:, None])
        after = frame.to_frame(future, rest_pelvis[:, None])
        x, change = before.pack(), after.pack() - before.pack()
        raw = step_between(before, after)

        def mean_and_deviation(values: Tensor, least: float) -> tuple[Tensor, Tensor]:
            rows = values.flatten(0, 1)
            return rows.mean(0), rows.std(0).clamp(min=least)

        contacts = raw.new_zeros(RAW - raw.shape[-1])
        raw_mean, raw_spread = mean_and_deviation(raw, _LEAST_STEP)
        return cls(
            *mean_and_deviation(x, _LEAST),
            *mean_and_deviation(change, _LEAST_STEP),
            torch.cat((raw_mean, contacts)),
            torch.cat((raw_spread, contacts + 1)),
        )


class ScaledNetworks(nn.Module):
    """`HumorNetworks` with normalised inputs and outputs, called with unscaled numbers.

    While it learns, states are blurred by `noise` standard deviations: a small corpus is else
    learned by heart, and steps from states beside the recorded ones are not learned at all.
    """

    state_mean: Tensor
    state: Tensor
    change_mean: Tensor
    change: Tensor
    raw_mean: Tensor
    raw: Tensor

    def __init__(self, core: HumorNetworks, scaling: Scaling, noise: float = 0.0) -> None:
        super().__init__()
        self.core = core
        self.noise = noise
        for name, tensor in scaling.tensors().items():
            self.register_buffer(name, tensor.clone())

    @classmethod
    def wrapping(
        cls, plain: HumorNetworks, scaling: Scaling, noise: float = 0.0
    ) -> "ScaledNetworks":
        """Wrap plain networks so that they compute the same functions with normalised numbers."""
        core = HumorNetworks(plain.width)
        core.load_state_dict(plain.state_dict())
        made = cls(core, scaling, noise)
        made._fold_scales(outwards=False)
        return made

    @property
    def scaling(self) -> Scaling:
        """The means and standard deviations of the scaling."""
        return Scaling(
            self.state_mean, self.state, self.change_mean, self.change, self.raw_mean, self.raw
        )

    def unscaled_networks(self) -> HumorNetworks:
        """Plain `HumorNetworks` of the same functions, with the scales folded into layers."""
        made = ScaledNetworks(HumorNetworks(self.core.width), self.scaling.to(device="cpu"))
        made.load_state_dict(self.state_dict())
        made._fold_scales(outwards=True)
        return made.core

    def prior(self, state: Float[Tensor, "*batch 339"]) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the conditional prior; see `HumorNetworks.prior`."""
        return self.core.prior(self._normalised_state(state))

    def posterior(
        self, state: Float[Tensor, "*batch 339"], following: Float[Tensor, "*batch 339"]
    ) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the posterior; the next state is scaled as a difference."""
        change = (following - state - self.change_mean) / self.change
        return self.core.posterior(self._normalised_state(state), change)

    def decode(
        self, state: Float[Tensor, "*batch 339"], latent: Float[Tensor, "*batch 48"]
    ) -> Float[Tensor, "*batch 216"]:
        """Decode a latent to the change of a state in one step; see `HumorNetworks.decode`."""
        raw = self.core.decode(self._normalised_state(state), latent)
        return self.raw_mean + self.raw * raw.float()

    def _normalised_state(self, state: Float[Tensor, "*batch 339"]) -> Float[Tensor, "*batch 339"]:
        seen = (state - self.state_mean) / self.state
        return seen + self.noise * torch.randn_like(seen) if self.training else seen

    @torch.no_grad()
    def _fold_scales(self, outwards: bool) -> None:
        """Fold the scales into the core's first and last layers, or take them out again."""
        s = self.scaling.to(dtype=torch.float64)
        inputs = torch.diag(1 / s.state)
        both = torch.zeros(2 * STATE, 2 * STATE, dtype=torch.float64, device=s.state.device)
        both[:STATE, :STATE] = inputs
        both[STATE:, STATE:] = torch.diag(1 / s.change)
        both[STATE:, :STATE] = -both[STATE:, STATE:]
        again = torch.eye(LATENT, dtype=torch.float64, device=s.state.device)
        moves = (
            (self.core.prior_net, inputs, s.state_mean),
            (self.core.encoder, both, torch.cat((s.state_mean, s.state_mean + s.change_mean))),
            (
                self.core.decoder,
                torch.block_diag(inputs, again),
                torch.cat((s.state_mean, again.new_zeros(LATENT))),
            ),
        )
        for network, matrix, mean in moves:
            first = cast(nn.Linear, network.net[0])
            weight, bias = first.weight.double(), first.bias.double()
            if outwards:  # W y + b with y = M (x - m) becomes a layer of x
                weight = weight @ matrix
                bias = bias - weight @ mean
            else:
                bias = bias + weight @ mean
                weight = torch.linalg.solve(matrix.mT, weight.mT).mT
            first.weight.copy_(weight)
            first.bias.copy_(bias)
        last = cast(nn.Linear, self.core.decoder.net[-1])
        weight, bias = last.weight.double(), last.bias.double()
        if outwards:
            weight, bias = s.raw[:, None] * weight, s.raw * bias + s.raw_mean
        else:
            weight, bias = weight / s.raw[:, None], (bias - s.raw_mean) / s.raw
        last.weight.copy_(weight)
        last.bias.copy_(bias)
