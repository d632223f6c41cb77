"""Networks of the HUMOS prior: transformers over windows of motion that see who moves.

A motion is a row of coefficients per window (`LappedBasis`). `WindowNetworks` give every window a
code; `ClipNetworks` one code to the whole clip, as published. Both start as the linear map of the
basis or from nothing, and learn the rest; both are told the body at both ends.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from priors.humos.basis import LappedBasis

LOG_VARIANCE = (-12.0, 4.0)
_SURE = -4.0
"""Log-variance of the codes before training."""
_REACH = 12
"""Windows to either side whose distance makes a difference."""
_HEADS = 4


class WindowNetworks(nn.Module):
    """A code for every window of 0.8 s, 0.4 s apart."""

    def __init__(
        self, basis: LappedBasis, latent: int, shape: int, width: int, layers: int,
        dropout: float = 0.0,
    ) -> None:  # fmt: skip
        """Untrained: codes are the first coefficients, and decode to them.

        Args:
            basis: of windows; not learned.
            latent: numbers of a code.
            shape: coefficients of the body.
            width: numbers per window inside the transformers.
            layers: of each transformer.
            dropout: share of the hidden numbers left out while training.
        """
        super().__init__()
        self.basis, self.latent = basis, latent
        size = len(basis.deviation)
        self.to_code = nn.Parameter(torch.eye(size)[:latent].clone())
        self.from_code = nn.Parameter(torch.eye(size)[:, :latent].clone())
        self.encoder = _Transformer(size, shape, 2 * latent, width, layers, dropout)
        self.decoder = _Transformer(latent, shape, size, width, layers, dropout)
        with torch.no_grad():
            self.encoder.last.bias[latent:] = _SURE

    def posterior(
        self,
        rows: Float[Tensor, "clips time numbers"],
        shape: Float[Tensor, "clips shape"],
        exists: Bool[Tensor, "clips windows"],
    ) -> tuple[Float[Tensor, "clips memory latent"], Float[Tensor, "clips memory latent"]]:
        """Mean and log-variance of the codes of a motion that a body performs."""
        coefficients = self.basis.analyse(rows)
        mean, log_variance = self.encoder(coefficients, shape, exists).chunk(2, -1)
        return mean + coefficients @ self.to_code.mT, log_variance.clamp(*LOG_VARIANCE)

    def decode(
        self,
        latent: Float[Tensor, "clips memory latent"],
        shape: Float[Tensor, "clips shape"],
        exists: Bool[Tensor, "clips windows"],
        frames: int,
    ) -> Float[Tensor, "clips time numbers"]:
        """The motion of these codes as another body performs it."""
        bent = self.decoder(latent, shape, exists)
        return self.basis.synthesise(latent @ self.from_code.mT + bent, frames)


class ClipNetworks(nn.Module):
    """One code for a whole clip, the single memory token of the published networks."""

    def __init__(
        self, basis: LappedBasis, latent: int, shape: int, width: int, layers: int,
        dropout: float = 0.0,
    ) -> None:  # fmt: skip
        """Untrained; arguments as those of `WindowNetworks`."""
        super().__init__()
        self.basis, self.latent = basis, latent
        size = len(basis.deviation)
        self.enter = nn.Linear(size, width)
        self.encoder = _Transformer(width, shape, width, width, layers, dropout)
        self.asking = nn.Parameter(torch.randn(2, width) * width**-0.5)
        self.to_code = nn.Linear(width, latent)
        self.to_variance = nn.Linear(width, latent)
        self.from_code = nn.Linear(latent, width)
        self.decoder = _Transformer(width, shape, size, width, layers, dropout)
        nn.init.constant_(self.to_variance.bias, _SURE)
        nn.init.normal_(self.encoder.last.weight, std=width**-0.5)

    def posterior(
        self,
        rows: Float[Tensor, "clips time numbers"],
        shape: Float[Tensor, "clips shape"],
        exists: Bool[Tensor, "clips windows"],
    ) -> tuple[Float[Tensor, "clips memory latent"], Float[Tensor, "clips memory latent"]]:
        """Mean and log-variance of the code of a motion that a body performs."""
        entered = self.enter(self.basis.analyse(rows))
        seen = self.encoder(entered + _clock(entered), shape, exists)
        asked = (self.asking @ seen.mT).masked_fill(~exists[:, None], -torch.inf).softmax(-1)
        mean, variance = (asked @ seen).unbind(-2)
        code = self.to_code(mean)[:, None]
        return code, self.to_variance(variance)[:, None].clamp(*LOG_VARIANCE)

    def decode(
        self,
        latent: Float[Tensor, "clips memory latent"],
        shape: Float[Tensor, "clips shape"],
        exists: Bool[Tensor, "clips windows"],
        frames: int,
    ) -> Float[Tensor, "clips time numbers"]:
        """The motion of this code as another body performs it."""
        memory = self.from_code(latent).expand(-1, exists.shape[-1], -1)
        bent = self.decoder(memory + _clock(memory), shape, exists)
        return self.basis.synthesise(bent, frames)


Networks = WindowNetworks | ClipNetworks
"""Networks with a code per window, or with one code per clip."""


class _Transformer(nn.Module):
    """Layers that see the body beside every window, and how far windows are apart."""

    def __init__(
        self, inputs: int, shape: int, outputs: int, width: int, layers: int, dropout: float
    ) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.body = nn.Linear(shape, width)
        self.layers = nn.ModuleList(_Layer(width, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.last = nn.Linear(width, outputs)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(
        self,
        x: Float[Tensor, "clips windows inputs"],
        shape: Float[Tensor, "clips shape"],
        exists: Bool[Tensor, "clips windows"],
    ) -> Float[Tensor, "clips windows outputs"]:
        y = self.first(x) + self.body(shape)[:, None]
        for layer in self.layers:
            y = layer(y, exists)
        return self.last(self.norm(y))


class _Layer(nn.Module):
    """x + attention(norm(x)), then x + B gelu(A norm(x))."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.near = nn.Parameter(torch.zeros(_HEADS, 2 * _REACH + 1))
        self.norm, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.ask, self.answer = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.inner, self.outer = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)
        self.drop = nn.Dropout(dropout)

    def forward(
        self, x: Float[Tensor, "clips windows width"], exists: Bool[Tensor, "clips windows"]
    ) -> Float[Tensor, "clips windows width"]:
        asked = self.ask(self.norm(x)).unflatten(-1, (3, _HEADS, -1)).movedim(-3, 0)
        query, key, value = asked.transpose(-3, -2)
        place = torch.arange(x.shape[-2], device=x.device)
        apart = (place[:, None] - place).clamp(-_REACH, _REACH) + _REACH
        bias = self.near[:, apart].masked_fill(~exists[:, None, None], -torch.inf)
        seen = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        x = x + self.drop(self.answer(seen.transpose(-3, -2).flatten(-2)))
        return x + self.outer(self.drop(functional.gelu(self.inner(self.norm2(x)))))


def _clock(like: Float[Tensor, "*batch windows width"]) -> Float[Tensor, "windows width"]:
    """Sines and cosines of the place of a window."""
    windows, width = like.shape[-2:]
    rate = 10_000 ** (-torch.arange(0, width, 2) / width)
    angle = torch.arange(windows)[:, None] * rate
    return torch.stack((angle.sin(), angle.cos()), -1).flatten(-2).to(like)
