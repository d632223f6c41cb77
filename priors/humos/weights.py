"""The HUMOS prior on disk: networks, basis, and how codes follow each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.checkpoints import named_checkpoint, save_checkpoint
from priors.humos.basis import WINDOW, LappedBasis
from priors.humos.frames import NUMBERS
from priors.humos.networks import ClipNetworks, Networks, WindowNetworks
from recon.core.errors import WeightsError
from recon.core.struct import TensorStruct

_BASIS, _DENSITY = "basis.", "density."
_SIZES = ("latent", "basis", "shape", "width", "layers")
_MEMORY = 0.98
"""Most that any direction of a code keeps to the next."""
_KINDS = {"windows": WindowNetworks, "clip": ClipNetworks}


@dataclass(frozen=True)
class CodeDensity(TensorStruct):
    """The aggregate posterior of recorded motions: codes that follow each other.

    z = mean + root u; u_0 ~ N(0, I), u_k | u_(k-1) ~ N(follow u_(k-1), rest restᵀ). A clip with
    one code has the first part only.
    """

    mean: Float[Tensor, " latent"]
    root: Float[Tensor, "latent latent"]
    """Lower triangular."""
    follow: Float[Tensor, "latent latent"]
    rest: Float[Tensor, "latent latent"]
    """Lower triangular."""

    @classmethod
    def fit(
        cls, codes: Float[Tensor, "codes latent"], variance: Float[Tensor, " latent"],
        pairs: tuple[Float[Tensor, "pairs latent"], Float[Tensor, "pairs latent"]],
    ) -> "CodeDensity":  # fmt: skip
        """Moments of all posteriors, and covariances of neighbours.

        Stationary: rest restᵀ = I - follow followᵀ, so that u has unit variance at any time.

        Args:
            codes: means of posteriors.
            variance: their mean variances.
            pairs: neighbouring codes, earlier and later.
        """
        mean = codes.double().mean(0)
        away = codes.double() - mean
        noise = variance.double().diag()
        root = torch.linalg.cholesky(away.mT @ away / (len(codes) - 1) + noise)
        size = len(mean)
        follow, rest = torch.zeros(size, size), torch.eye(size)
        if len(pairs[0]) > size:
            before, after = (
                torch.linalg.solve_triangular(root, (p.double() - mean).mT, upper=False).mT
                for p in pairs
            )
            # u has unit variance, so the covariance of neighbours is the regression itself; held
            # below one, it forgets, and no clip grows however long it is
            left, lengths, right = torch.linalg.svd(after.mT @ before / len(before))
            follow = (left * lengths.clamp(max=_MEMORY)) @ right
            rest = torch.linalg.cholesky(torch.eye(size, dtype=torch.float64) - follow @ follow.mT)
        return cls(mean.float(), root.float(), follow.float(), rest.float())

    def white(
        self, codes: Float[Tensor, "*batch memory latent"]
    ) -> Float[Tensor, "*batch memory latent"]:
        """U of codes."""
        return torch.linalg.solve_triangular(self.root, (codes - self.mean).mT, upper=False).mT

    def codes(
        self, white: Float[Tensor, "*batch memory latent"]
    ) -> Float[Tensor, "*batch memory latent"]:
        """The inverse of `white`."""
        return self.mean + white @ self.root.mT

    def energy(
        self, white: Float[Tensor, "*batch memory latent"], exists: Tensor
    ) -> Float[Tensor, "*batch"]:
        """-log p of u up to a constant; codes that do not exist count nothing."""
        away = white[..., 1:, :] - white[..., :-1, :] @ self.follow.mT
        away = torch.linalg.solve_triangular(self.rest, away.mT, upper=False).mT
        every = torch.cat((white[..., :1, :], away), -2).square().sum(-1)
        return 0.5 * every.where(exists[..., : every.shape[-1]], 0.0).sum(-1)

    def drawn(
        self, clips: int, memory: int, random: torch.Generator
    ) -> Float[Tensor, "clips memory latent"]:
        """Codes z, one after the other."""
        noise = torch.randn(clips, memory, len(self.mean), generator=random).to(self.mean)
        rows = [noise[:, 0]]
        for k in range(1, memory):
            rows.append(rows[-1] @ self.follow.mT + noise[:, k] @ self.rest.mT)
        return self.codes(torch.stack(rows, 1))


@dataclass(frozen=True)
class HumosWeights:
    """The content of a weights file."""

    networks: Networks
    density: CodeDensity
    frames: int
    """Longest clip that was learned; only networks of one code per clip are bound to it."""

    @property
    def shape(self) -> int:
        """Coefficients of the bodies."""
        return self.networks.decoder.body.in_features

    @property
    def one_code(self) -> bool:
        """Whether there is one code per clip."""
        return isinstance(self.networks, ClipNetworks)


def save_weights(path: Path, weights: HumosWeights, settings: Mapping[str, Any]) -> None:
    """Write networks and directions in half precision, what scales them in single."""
    networks, basis = weights.networks, weights.networks.basis
    tensors = {name: tensor.half() for name, tensor in networks.state_dict().items()}
    for name, tensor in basis.tensors().items():
        tensors[_BASIS + name] = tensor.half() if name == "directions" else tensor.float()
    for name, tensor in weights.density.tensors().items():
        tensors[_DENSITY + name] = tensor.float()
    about = {**settings, "frames": weights.frames}
    save_checkpoint(path, "humos", tensors, about)


def load_weights(path: str | Path) -> HumosWeights:
    """Read a weights file.

    Args:
        path: a file; or `open` for the weights in the package, `nc` for those of a source
            checkout that may not be used commercially.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds something else.
    """
    found = named_checkpoint(path, "humos")
    sizes = [found.settings.get(name) for name in (*_SIZES, "frames")]
    kind = found.settings.get("codes")
    if kind not in _KINDS or not all(isinstance(size, int) and size > 0 for size in sizes):
        raise WeightsError(
            f"{found.path}: expected the settings {', '.join(_SIZES)}, frames (whole numbers) and "
            f"codes ({' or '.join(_KINDS)}), got {dict(found.settings)}"
        )
    latent, size, shape, width, layers, frames = (int(one) for one in sizes if one is not None)
    numbers = WINDOW * NUMBERS
    basis = LappedBasis(**found.under(_BASIS).require({
        "mean": (numbers,), "directions": (size, numbers), "deviation": (size,),
    }))  # fmt: skip
    networks = _KINDS[kind](basis, latent, shape, width, layers)
    found.besides(_BASIS, _DENSITY).into(networks)
    square = (latent, latent)
    density = CodeDensity(**found.under(_DENSITY).require({
        "mean": (latent,), "root": square, "follow": square, "rest": square,
    }))  # fmt: skip
    networks.eval().requires_grad_(False)
    return HumosWeights(networks, density, frames)
