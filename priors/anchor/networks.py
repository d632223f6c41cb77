"""Networks of the anchor-frame VAE: a linear map of cycles plus nonlinear residual layers."""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from priors.anchor.frames import CODES, CycleBasis
from priors.checkpoints import named_checkpoint
from recon.core.struct import TensorStruct

_LOG_VARIANCE = (-10.0, 4.0)
_SURE = -3.0
"""Log-variance of the codes before training."""


class AnchorNetworks(nn.Module):
    """Encoder q(z | cycle), which does not see the body, and decoder D(z, shape).

    The published layers are unknown. Ours start as principal component analysis: codes are the
    first coefficients of a `CycleBasis`, and residual networks learn the rest. From a thousand
    cycles, networks without the linear part learned to reconstruct the training people only.
    Untrained and without hidden units they are the principal components themselves.
    """

    def __init__(self, basis: CycleBasis, latent: int, shape: int, width: int) -> None:
        """Build untrained networks.

        Args:
            basis: linear map between cycles and coefficients; not learned.
            latent: size of z.
            shape: coefficients of the body that the decoder sees.
            width: units of the hidden layers; 0 has no hidden layers, what is learned is linear.
        """
        super().__init__()
        self.basis, self.latent, self.shape, self.width = basis, latent, shape, width
        size = len(basis.deviation)
        ratio = basis.whitening[:latent]
        self.to_code = nn.Parameter(torch.eye(size)[:latent] * ratio[:, None])
        self.from_code = nn.Parameter(torch.eye(size)[:, :latent] / ratio)
        self.encoder = _residual_layers(size, width, 2 * latent)
        self.decoder = _residual_layers(latent + shape, width, size)
        with torch.no_grad():
            last = self.encoder[-1]
            assert isinstance(last, nn.Linear)
            last.bias[latent:] = _SURE

    def posterior(
        self, rows: Float[Tensor, "*batch 100 124"]
    ) -> tuple[Float[Tensor, "*batch latent"], Float[Tensor, "*batch latent"]]:
        """Mean and log-variance of the latent codes of aligned cycles (rows of `Anchors.pack`)."""
        coefficients = self.basis.analyse(rows)
        mean, log_variance = self.encoder(coefficients).chunk(2, -1)
        return mean + coefficients @ self.to_code.mT, log_variance.clamp(*_LOG_VARIANCE)

    def normalised(
        self, latent: Float[Tensor, "*batch latent"], shape: Float[Tensor, "*batch shape"]
    ) -> Float[Tensor, "*batch 100 124"]:
        """Decode latent codes to aligned cycles, in the units of the training losses."""
        nonlinear = self.decoder(torch.cat((latent, shape), -1))
        return self.basis.synthesise(latent @ self.from_code.mT + nonlinear)

    def decode(
        self, latent: Float[Tensor, "*batch latent"], shape: Float[Tensor, "*batch shape"]
    ) -> Float[Tensor, "*batch 100 124"]:
        """Decode latent codes to aligned cycles: rows of `Anchors.pack` in metres and seconds."""
        return self.basis.denormalised(self.normalised(latent, shape))


class _ResidualBlock(nn.Module):
    """Residual block of two linear layers A and B: x + B silu(A norm(x))."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.inner = nn.Linear(width, width)
        self.outer = nn.Linear(width, width)

    def forward(self, x: Float[Tensor, "*batch width"]) -> Float[Tensor, "*batch width"]:
        return x + self.outer(functional.silu(self.inner(self.norm(x))))


def _residual_layers(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """Build a residual network whose output is zero until it is trained."""
    last = nn.Linear(width or inputs, outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    if width == 0:
        return nn.Sequential(last)
    blocks = [_ResidualBlock(width), _ResidualBlock(width)]
    return nn.Sequential(nn.Linear(inputs, width), *blocks, last)


_BASIS, _SPREAD = "basis.", "spread."
ALIGNMENT = "yaw"
"""What is taken away from cycles: heading and place on the ground."""


@dataclass(frozen=True)
class CodeSpread(TensorStruct):
    """The aggregate posterior: latent codes of recorded cycles are about N(mean, root rootᵀ)."""

    mean: Float[Tensor, " latent"]
    root: Float[Tensor, "latent latent"]
    """Lower triangular factor of the codes' covariance."""
    typical: Float[Tensor, "typical latent"]
    """Codes of different kinds of cycles, to begin a search with."""


@dataclass(frozen=True)
class AnchorWeights:
    """Networks and code distribution of the anchor prior, as a weights file holds them."""

    networks: AnchorNetworks
    spread: CodeSpread


def load_weights(path: str | Path) -> AnchorWeights:
    """Read a weights file.

    Args:
        path: a file; or `open` for the weights in the package.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds something else.
    """
    found = named_checkpoint(path, "anchor")
    latent, shape, size = found.integer_settings("latent", "shape", "basis", alignment=ALIGNMENT)
    (width,) = found.integer_settings("width", least=0)
    basis = CycleBasis(**found.with_prefix(_BASIS).require({
        "low": (4,), "high": (4,), "mean": (CODES,), "directions": (size, CODES),
        "deviation": (size,),
    }))  # fmt: skip
    networks = AnchorNetworks(basis, latent, shape, width)
    found.without_prefixes(_BASIS, _SPREAD).copy_into(networks)
    count = len(found.tensors.get(_SPREAD + "typical", torch.zeros(0)))
    spread = CodeSpread(**found.with_prefix(_SPREAD).require({
        "mean": (latent,), "root": (latent, latent), "typical": (count, latent),
    }))  # fmt: skip
    networks.eval().requires_grad_(False)
    return AnchorWeights(networks, spread)
