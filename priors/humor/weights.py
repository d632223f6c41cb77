"""HuMoR's weights on disk: ours, in safetensors with the mixture, and the authors' checkpoint."""

import pickle
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from priors.checkpoints import Checkpoint, named_checkpoint
from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks, width_of
from recon.core.errors import WeightsError

INITIAL = "initial."
"""Prefix of the names of the mixture's tensors."""

WHITENING = "error_whitening"
"""Name of the tensor that says how far the decoder's steps are off."""

_DAMAGED = (pickle.UnpicklingError, RuntimeError, EOFError, LookupError, TypeError, ValueError)
"""Errors of reading bytes that are no checkpoint."""


def read_weights(path: str | Path) -> Checkpoint:
    """Read weights of recon (.safetensors) or a PyTorch checkpoint (.pth, .pt).

    Args:
        path: a file; or `open` for the weights in the package, `nc` for those of a source
            checkout that may not be used commercially.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it holds something else.
    """
    if path in ("open", "nc") or Path(path).suffix == ".safetensors":
        return named_checkpoint(path, "humor")
    return _read_pytorch(Path(path))


def networks_from(weights: Checkpoint) -> HumorNetworks:
    """Networks of the width that the weights have."""
    own = weights.without_prefixes(INITIAL, WHITENING)
    networks = HumorNetworks(width_of(own.tensors))
    own.copy_into(networks)
    return networks


def mixture_from(weights: Checkpoint) -> Mixture | None:
    """The mixture of initial states in a weights file; None without one."""
    own = weights.with_prefix(INITIAL)
    if len(own.tensors) == 0:
        return None
    count, size = own.tensors["means"].shape if "means" in own.tensors else (12, 138)
    shapes = {
        "features": (size,),
        "log_weights": (count,),
        "means": (count, size),
        "whitening": (count, size, size),
    }
    return Mixture(**own.require(shapes))


def whitening_from(weights: Checkpoint) -> Float[Tensor, "207 207"] | None:
    """The matrix that whitens the decoder's errors, where the file has one."""
    own = weights.with_prefix(WHITENING)
    return own.require({"": (207, 207)})[""] if own.tensors else None


def _read_pytorch(path: Path) -> Checkpoint:
    """Read a PyTorch checkpoint without executing code from it."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such weights file; expected HuMoR weights there")
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except _DAMAGED as error:
        raise WeightsError(f"{path}: expected a PyTorch checkpoint, got {error}") from error
    for name in ("average", "model"):
        own = found.get(name) if isinstance(found, dict) else None
        if isinstance(own, dict) and all(isinstance(t, Tensor) for t in own.values()):
            return Checkpoint(path, own, {})
    raise WeightsError(f"{path}: expected a checkpoint with the networks' weights under 'model'")
