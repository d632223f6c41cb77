"""Networks of the HUMOS prior: transformers over windows of motion, conditioned on the shape.

A motion is a row of coefficients per window (`LappedBasis`), and every window has a code. The
networks start as the linear map of the basis and learn the rest; encoder and decoder are told the
body. Published networks give one code to a whole clip (Tripathi et al. 2024, section 3.2).
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

from priors.checkpoints import named_checkpoint
from priors.humos.frames import NUMBERS, WINDOW, LappedBasis
from recon.core.struct import TensorStruct

LOG_VARIANCE = (-12.0, 4.0)
_SURE = -4.0
"""Log-variance of the codes before training."""
_REACH = 12
"""Windows to either side whose distance makes a difference."""
_HEADS = 4


class WindowNetworks(nn.Module):
    """Encoder and decoder of motions: a latent code per window of 0.8 s, a window every 0.4 s."""

    def __init__(
        self, basis: LappedBasis, latent: int, shape: int, width: int, layers: int,
        dropout: float = 0.0,
    ) -> None:  # fmt: skip
        """Build untrained networks.

        Codes are the first coefficients of the basis, which decode exactly to these.

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
        """Mean and log-variance of codes of motions (feature rows) by bodies of given shape."""
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
        """Decode latent codes to `frames` feature rows of a motion of a body of given shape."""
        nonlinear = self.decoder(latent, shape, exists)
        return self.basis.synthesise(latent @ self.from_code.mT + nonlinear, frames)


class _Transformer(nn.Module):
    """Transformer layers with the body's shape as input, attention biased by window distance."""

    def __init__(
        self, inputs: int, shape: int, outputs: int, width: int, layers: int, dropout: float
    ) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.body = nn.Linear(shape, width)
        self.layers = nn.ModuleList(_AttentionLayer(width, dropout) for _ in range(layers))
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


class _AttentionLayer(nn.Module):
    """Transformer layer: x + attention(norm(x)), then x + B gelu(A norm(x))."""

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


_BASIS, _DENSITY = "basis.", "density."
_SIZES = ("latent", "basis", "shape", "width", "layers", "frames")
CODES_OF = "windows"
"""What has a code of its own; in files of versions up to 0.2.0 also a whole clip."""


@dataclass(frozen=True)
class CodeDensity(TensorStruct):
    """The aggregate posterior of recorded motions: a first-order Gaussian process of latent codes.

    z = mean + root u; u_0 ~ N(0, I), u_k | u_(k-1) ~ N(follow u_(k-1), rest restᵀ).
    """

    mean: Float[Tensor, " latent"]
    root: Float[Tensor, "latent latent"]
    """Lower triangular; a code is z = mean + root u."""
    follow: Float[Tensor, "latent latent"]
    rest: Float[Tensor, "latent latent"]
    """Lower triangular factor of the covariance of u_k given u_(k-1)."""

    def whitened(
        self, codes: Float[Tensor, "*batch memory latent"]
    ) -> Float[Tensor, "*batch memory latent"]:
        """Return the whitened codes u = root⁻¹ (z - mean) of codes z."""
        return torch.linalg.solve_triangular(self.root, (codes - self.mean).mT, upper=False).mT

    def codes(
        self, white: Float[Tensor, "*batch memory latent"]
    ) -> Float[Tensor, "*batch memory latent"]:
        """Return the codes z whose whitened codes u are given (inverse of `whitened`)."""
        return self.mean + white @ self.root.mT

    def energy(
        self, white: Float[Tensor, "*batch memory latent"], exists: Tensor
    ) -> Float[Tensor, "*batch"]:
        """-log p of whitened codes u, up to a constant; windows without frames are ignored."""
        away = white[..., 1:, :] - white[..., :-1, :] @ self.follow.mT
        away = torch.linalg.solve_triangular(self.rest, away.mT, upper=False).mT
        every = torch.cat((white[..., :1, :], away), -2).square().sum(-1)
        return 0.5 * every.where(exists[..., : every.shape[-1]], 0.0).sum(-1)

    def drawn_codes(
        self, clips: int, memory: int, random: torch.Generator
    ) -> Float[Tensor, "clips memory latent"]:
        """Draw sequences of random codes z, each conditioned on the previous one."""
        noise = torch.randn(clips, memory, len(self.mean), generator=random).to(self.mean)
        rows = [noise[:, 0]]
        for k in range(1, memory):
            rows.append(rows[-1] @ self.follow.mT + noise[:, k] @ self.rest.mT)
        return self.codes(torch.stack(rows, 1))


@dataclass(frozen=True)
class HumosWeights:
    """Networks and code density of the HUMOS prior, as a weights file holds them."""

    networks: WindowNetworks
    density: CodeDensity
    frames: int
    """Frames of the clips that were learned."""

    @property
    def shape(self) -> int:
        """Number of shape coefficients of the bodies that the networks know."""
        return self.networks.decoder.body.in_features


def load_weights(path: str | Path) -> HumosWeights:
    """Read a weights file.

    Args:
        path: a file; or `open` for the weights in the package.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds something else.
    """
    found = named_checkpoint(path, "humos")
    latent, size, shape, width, layers, frames = found.integer_settings(*_SIZES, codes=CODES_OF)
    numbers = WINDOW * NUMBERS
    basis = LappedBasis(**found.with_prefix(_BASIS).require({
        "mean": (numbers,), "directions": (size, numbers), "deviation": (size,),
    }))  # fmt: skip
    networks = WindowNetworks(basis, latent, shape, width, layers)
    found.without_prefixes(_BASIS, _DENSITY).copy_into(networks)
    square = (latent, latent)
    density = CodeDensity(**found.with_prefix(_DENSITY).require({
        "mean": (latent,), "root": square, "follow": square, "rest": square,
    }))  # fmt: skip
    networks.eval().requires_grad_(False)
    return HumosWeights(networks, density, frames)
