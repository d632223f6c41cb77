"""The anchor-frame VAE on disk: networks, basis, and how codes of recorded cycles are spread."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.basis import CODES, CycleBasis
from priors.anchor.frames import Alignment
from priors.anchor.networks import AnchorNetworks
from priors.checkpoints import named_checkpoint, save_checkpoint
from recon.core.errors import WeightsError
from recon.core.struct import TensorStruct

_BASIS, _SPREAD = "basis.", "spread."
_SETTINGS = ("latent", "shape", "width", "basis")


@dataclass(frozen=True)
class CodeSpread(TensorStruct):
    """The aggregate posterior of recorded cycles: their codes are about N(mean, root rootᵀ)."""

    mean: Float[Tensor, " latent"]
    root: Float[Tensor, "latent latent"]
    """Lower triangular."""
    typical: Float[Tensor, "typical latent"]
    """Codes of different kinds of cycles, to begin a search with."""

    @classmethod
    def fit(
        cls, means: Float[Tensor, "cycles latent"], variances: Float[Tensor, "cycles latent"],
        typical: int, seed: int = 0,
    ) -> "CodeSpread":  # fmt: skip
        """Moments of the mixture of all posteriors, and the cycles nearest to cluster centres."""
        from sklearn.cluster import KMeans

        codes = means.double()
        mean = codes.mean(0)
        away = codes - mean
        covariance = away.mT @ away / max(len(codes) - 1, 1) + variances.double().mean(0).diag()
        rows = codes.numpy()
        found = KMeans(typical, random_state=seed).fit(rows)
        centres = torch.from_numpy(found.cluster_centers_)
        nearest = torch.cdist(centres, codes).argmin(-1)
        return cls(mean.float(), torch.linalg.cholesky(covariance).float(), means[nearest])


@dataclass(frozen=True)
class AnchorWeights:
    """The content of a weights file."""

    networks: AnchorNetworks
    spread: CodeSpread
    alignment: Alignment


def save_weights(path: Path, weights: AnchorWeights, settings: Mapping[str, Any]) -> None:
    """Write networks and directions in half precision, what scales them in single."""
    networks, basis = weights.networks, weights.networks.basis
    tensors = {name: tensor.half() for name, tensor in networks.state_dict().items()}
    for name, tensor in basis.tensors().items():
        tensors[_BASIS + name] = tensor.half() if name == "directions" else tensor.float()
    for name, tensor in weights.spread.tensors().items():
        tensors[_SPREAD + name] = tensor.float()
    sizes = {
        "latent": networks.latent,
        "shape": networks.shape,
        "width": networks.width,
        "basis": len(basis.deviation),
    }
    about = {**settings, **sizes, "alignment": weights.alignment.value}
    save_checkpoint(path, "anchor", tensors, about)


def load_weights(path: str | Path) -> AnchorWeights:
    """Read a weights file.

    Args:
        path: a file; or `open` for the weights in the package, `nc` for those of a source
            checkout that may not be used commercially.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds something else.
    """
    found = named_checkpoint(path, "anchor")
    sizes = [found.settings.get(name) for name in _SETTINGS]
    known = {alignment.value for alignment in Alignment}
    if found.settings.get("alignment") not in known or not all(
        isinstance(size, int) and size >= (0 if name == "width" else 1)
        for name, size in zip(_SETTINGS, sizes, strict=True)
    ):
        raise WeightsError(
            f"{found.path}: expected the settings {', '.join(_SETTINGS)} (whole numbers) and "
            f"alignment ({' or '.join(sorted(known))}), got {dict(found.settings)}"
        )
    latent, shape, width, size = (int(one) for one in sizes if one is not None)
    basis = CycleBasis(**found.under(_BASIS).require({
        "low": (4,), "high": (4,), "mean": (CODES,), "directions": (size, CODES),
        "deviation": (size,),
    }))  # fmt: skip
    networks = AnchorNetworks(basis, latent, shape, width)
    found.besides(_BASIS, _SPREAD).into(networks)
    count = len(found.tensors.get(_SPREAD + "typical", torch.zeros(0)))
    spread = CodeSpread(**found.under(_SPREAD).require({
        "mean": (latent,), "root": (latent, latent), "typical": (count, latent),
    }))  # fmt: skip
    networks.eval().requires_grad_(False)
    return AnchorWeights(networks, spread, Alignment(found.settings["alignment"]))
