"""Weights on disk: safetensors, with the settings of the network as JSON in the metadata.

Loading is strict. A missing, spare or misshapen tensor is an error that names file and layer.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from recon.core.errors import WeightsError
from recon.core.limits import BINARY, NETWORK_WEIGHT

ABOUT = "recon"
"""The one key of the metadata: safetensors writes several in no fixed order."""


@dataclass(frozen=True)
class Checkpoint:
    """The contents of one weights file."""

    path: Path
    tensors: Mapping[str, Tensor]
    settings: Mapping[str, Any]

    def require(self, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Tensor]:
        """Return the file's tensors after checking that they have exactly the given shapes.

        Raises:
            ValueError: naming the file and every layer that is missing, spare or misshapen.
        """
        wrong = [f"{name} is missing" for name in shapes if name not in self.tensors]
        wrong += [f"{name} is not expected" for name in self.tensors if name not in shapes]
        for name, shape in shapes.items():
            found = self.tensors.get(name)
            if found is not None and tuple(found.shape) != tuple(shape):
                wrong.append(f"{name} has shape {tuple(found.shape)}, expected {tuple(shape)}")
        if len(wrong) > 0:
            raise WeightsError(f"{self.path}: weights do not fit this network: {'; '.join(wrong)}")
        bad = [name for name in shapes if not bool(self.tensors[name].isfinite().all())]
        if len(bad) > 0:
            raise WeightsError(f"{self.path}: nan or infinity in {', '.join(bad)}; train again")
        return {name: self.tensors[name] for name in shapes}

    def with_prefix(self, prefix: str) -> "Checkpoint":
        """Return the tensors whose names begin with `prefix`, without it, in single precision."""
        own = {
            name.removeprefix(prefix): tensor.float() if tensor.is_floating_point() else tensor
            for name, tensor in self.tensors.items()
            if name.startswith(prefix)
        }
        return Checkpoint(self.path, own, self.settings)

    def without_prefixes(self, *prefixes: str) -> "Checkpoint":
        """Return the tensors whose names begin with none of the prefixes, in single precision."""
        others = {
            name: tensor.float()
            for name, tensor in self.tensors.items()
            if not name.startswith(prefixes)
        }
        return Checkpoint(self.path, others, self.settings)

    def integer_settings(self, *names: str, least: int = 1, **texts: str) -> list[int]:
        """Return the integer settings `names`; refuse a file whose settings differ from `texts`.

        Raises:
            ValueError: naming the file and what it says, when they are not.
        """
        found = [self.settings.get(name) for name in names]
        valid = [size for size in found if isinstance(size, int) and size >= least]
        found_texts = {name: self.settings.get(name) for name in texts}
        if len(valid) < len(found) or found_texts != texts:
            expected = [f"{name} ({least} or more)" for name in names]
            expected += [f"{name} = {word!r}" for name, word in texts.items()]
            raise WeightsError(
                f"{self.path}: expected the settings {', '.join(expected)}, got "
                f"{dict(self.settings)}; weights of other versions must be trained anew"
            )
        return valid

    def copy_into(self, network: nn.Module) -> None:
        """Copy the file's tensors into a network; raises as `require` if its layers differ."""
        layers = {name: tuple(value.shape) for name, value in network.state_dict().items()}
        network.load_state_dict(self.require(layers), strict=True)


def checksum(tensors: Mapping[str, Tensor], metadata: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a weights file's metadata and of all its tensors with their names."""
    hashed = {key: metadata.get(key) for key in ("kind", "settings")}
    digest = hashlib.sha256(json.dumps(hashed, sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = tensors[name].detach().cpu().contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)};".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def named_checkpoint(name: str | Path, kind: str) -> Checkpoint:
    """Load the packaged weights of `kind` if `name` is "open", else those of the file `name`.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or holds the weights of something else.
    """
    if name == "nc":
        raise WeightsError(
            "weights 'nc' came with versions up to 0.2.0 only; give 'open', with which fits are "
            "as accurate (docs/results.md), or the path of a file of weights"
        )
    return load_checkpoint(weights_path(name, kind), kind)


def load_checkpoint(path: str | Path, kind: str) -> Checkpoint:
    """Read a weights file and check that it holds weights of the network `kind`.

    A file without a checksum, as version 0.1.0 wrote them, is read when its numbers are those of
    a network.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, its checksum differs, or it holds the weights of something
            else.
    """
    from safetensors import SafetensorError, safe_open

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such weights file; expected {kind} weights there")
    BINARY.check(path.stat().st_size, path)
    try:
        with safe_open(path, framework="pt") as file:
            notes = file.metadata() or {}
            tensors: dict[str, Tensor] = {
                name: file.get_tensor(name) for name in list(file.keys())
            }
    except (SafetensorError, RuntimeError, ValueError, OSError, AttributeError) as error:
        raise WeightsError(f"{path}: expected a safetensors file, but {error}") from error
    try:
        about = json.loads(notes.get(ABOUT, "{}"))
    except (ValueError, RecursionError) as error:
        raise WeightsError(f"{path}: its metadata is not JSON: {error}") from error
    found = about.get("kind") if isinstance(about, dict) else None
    if found != kind:
        raise WeightsError(f"{path}: expected {kind} weights, but it holds {found!r}")
    settings = about.get("settings")
    if not isinstance(settings, dict):
        raise WeightsError(f"{path}: expected a dict of settings, got {type(settings).__name__}")
    stated = about.get("sha256")
    if stated is not None and stated != checksum(tensors, about):
        raise WeightsError(
            f"{path}: the weights do not have the checksum stated in the file, so the file was "
            "damaged or changed; fetch it again or train the weights again"
        )
    for name, tensor in tensors.items():
        if tensor.is_floating_point():
            NETWORK_WEIGHT.check(tensor.float().numpy(), path, name)
    return Checkpoint(path, tensors, settings)


FIRST = "pose"
"""Name of the prior that finds first motions: it does not ask where the ground is."""


def weights_path(name: str | Path, kind: str) -> Path:
    """Return the path of the packaged weights of `kind` if `name` is "open", else `name`."""
    if name != "open":
        return Path(name)
    found = find_spec("priors")
    assert found is not None  # `priors` is always there: it is installed with `recon`
    assert found.origin is not None
    return Path(found.origin).parent / "weights" / f"{kind}.safetensors"
