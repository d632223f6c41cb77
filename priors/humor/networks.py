"""HuMoR's three networks, layer by layer as in the released checkpoint (Rempe et al. 2021).

A conditional variational autoencoder of one transition of a canonical state x: the encoder sees
both ends, the prior only where the step starts, the decoder makes the step from there.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

STATE = 339
"""Numbers of a state (see `priors.humor.state`)."""

RAW = 216
"""Numbers the decoder gives: changes, rotation vectors and contact logits."""

LATENT = 48

PUBLISHED_WIDTH = 1024

_GROUPS = 16


class GroupNorm(nn.GroupNorm):
    """Group normalisation of rows (rows, units), twice as fast as torch's `nn.GroupNorm`."""

    def forward(self, input: Float[Tensor, "rows units"]) -> Float[Tensor, "rows units"]:
        """Normalise groups of units of a row to mean 0 and variance 1, then scale and shift."""
        groups = input.unflatten(1, (self.num_groups, -1))
        normal = functional.layer_norm(groups, groups.shape[2:], eps=self.eps).flatten(1)
        return torch.addcmul(self.bias, normal, self.weight)

    def norm_and_relu(self, x: Float[Tensor, "rows units"]) -> Float[Tensor, "rows units"]:
        """Normalise the input and apply a ReLU; faster when weights need no gradient."""
        if self.weight.requires_grad:
            return self(x).relu()
        return _NormalisationAndReLU.apply(x, self.weight, self.bias, self.num_groups, self.eps)


class _NormalisationAndReLU(torch.autograd.Function):
    """Group normalisation, scale, shift and ReLU in one operation with its own backward pass.

    The same numbers as operation by operation, in a quarter of the time for many rows: those
    write a new array for each.
    """

    @staticmethod
    def forward(
        ctx: Any, x: Tensor, weight: Tensor, bias: Tensor, groups: int, eps: float
    ) -> Tensor:
        parts = x.unflatten(1, (groups, -1))
        normal, mean, rstd = torch.native_layer_norm(parts, parts.shape[2:], None, None, eps)
        out = torch.addcmul(bias, normal.flatten(1), weight).relu_()
        ctx.save_for_backward(parts, mean, rstd, out, weight)
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        parts, mean, rstd, out, weight = ctx.saved_tensors
        inner = torch.ops.aten.threshold_backward(gradients[0], out, 0).mul_(weight)
        found, _, _ = torch.ops.aten.native_layer_norm_backward(
            inner.view_as(parts), parts, parts.shape[2:], mean, rstd, None, None,
            [True, False, False],
        )  # fmt: skip
        return found.flatten(1), None, None, None, None


class Perceptron(nn.Module):
    """Network of a linear layer, then several times GroupNorm, ReLU and another linear layer.

    With `skip`, so many numbers at the end of the input are given to every later layer again.
    """

    def __init__(self, sizes: Sequence[int], skip: int = 0) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Linear(sizes[0], sizes[1])]
        for size, following in pairwise(sizes[1:]):
            layers += [GroupNorm(_GROUPS, size), nn.ReLU(), nn.Linear(size + skip, following)]
        self.net = nn.ModuleList(layers)
        self.skip = skip

    def forward(self, x: Float[Tensor, "rows inputs"]) -> Float[Tensor, "rows outputs"]:
        """Apply all layers; the last one has neither normalisation nor nonlinearity after it."""
        skipped = x[:, x.shape[1] - self.skip :]
        for k, layer in enumerate(self.net):
            if isinstance(layer, GroupNorm):
                x = layer.norm_and_relu(x)
            elif isinstance(layer, nn.Linear):
                x = layer(torch.cat((x, skipped), 1) if k > 0 and self.skip > 0 else x)
        return x


class HumorNetworks(nn.Module):
    """Prior p(z | x), encoder q(z | x, x') and decoder of the step from x to x'.

    Args:
        width: units of the hidden layers; the decoder's last one has half. 1024 is published.
    """

    def __init__(self, width: int = PUBLISHED_WIDTH) -> None:
        super().__init__()
        if width < 64 or width % 32 != 0:
            raise ValueError(
                "width must be a multiple of 32 and at least 64, so that units form groups for "
                f"normalisation; got {width}"
            )
        hidden = [width] * 4
        self.encoder = Perceptron([2 * STATE, *hidden, 2 * LATENT])
        self.decoder = Perceptron([STATE + LATENT, width, width, width // 2, RAW], skip=LATENT)
        self.prior_net = Perceptron([STATE, *hidden, 2 * LATENT])

    @property
    def width(self) -> int:
        """Number of units of each hidden layer."""
        return width_of(self.state_dict())

    def prior(
        self, state: Float[Tensor, "*batch 339"]
    ) -> tuple[Float[Tensor, "*batch 48"], Float[Tensor, "*batch 48"]]:
        """Mean and log-variance of the latent of the step that starts at a state."""
        return _mean_and_log_variance(self.prior_net, state)

    def posterior(
        self, state: Float[Tensor, "*batch 339"], following: Float[Tensor, "*batch 339"]
    ) -> tuple[Float[Tensor, "*batch 48"], Float[Tensor, "*batch 48"]]:
        """Mean and log-variance of the latent that explains a step between two given states.

        Both are in the frame of the first.
        """
        return _mean_and_log_variance(self.encoder, torch.cat((state, following), -1))

    def decode(
        self, state: Float[Tensor, "*batch 339"], latent: Float[Tensor, "*batch 48"]
    ) -> Float[Tensor, "*batch 216"]:
        """The decoder's output, the raw step, which `state_after_step` applies to the state."""
        x = torch.cat((state, latent), -1)
        return self.decoder(x.flatten(0, -2)).unflatten(0, x.shape[:-1])


def width_of(tensors: Mapping[str, Tensor]) -> int:
    """Number of hidden units of the networks with these weights.

    Raises:
        ValueError: when the prior's first layer is not among them.
    """
    first = tensors.get("prior_net.net.0.weight")
    if first is None:
        raise ValueError(
            "expected HuMoR's weights with a layer prior_net.net.0.weight; there are "
            f"{', '.join(sorted(tensors)[:4])}, ..."
        )
    return len(first)


def _mean_and_log_variance(
    network: Perceptron, x: Float[Tensor, "*batch inputs"]
) -> tuple[Tensor, Tensor]:
    out = network(x.flatten(0, -2)).unflatten(0, x.shape[:-1])
    return out[..., :LATENT], out[..., LATENT:]
