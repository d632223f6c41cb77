"""Writing trained weights in the format that `priors` reads."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from priors.anchor.networks import ALIGNMENT, AnchorWeights
from priors.checkpoints import ABOUT, checksum
from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.prior import INITIAL, WHITENING
from priors.humos.networks import CODES_OF, HumosWeights
from recon.core.errors import WeightsError
from recon.core.struct import TensorStruct
from recon.formats.replacing import replacing


def half_precision(networks: nn.Module, **parts: TensorStruct) -> dict[str, Tensor]:
    """Tensors of networks in half precision, together with named tensors that are not trained.

    All are in half precision but what scales others: of parts only `directions` are.
    """
    tensors = {name: tensor.half() for name, tensor in networks.state_dict().items()}
    for part, own in parts.items():
        for name, tensor in own.tensors().items():
            tensors[f"{part}.{name}"] = tensor.half() if name == "directions" else tensor.float()
    return tensors


def save_checkpoint(
    path: str | Path,
    kind: str,
    tensors: Mapping[str, Tensor],
    settings: Mapping[str, Any],
) -> None:
    """Write a weights file atomically.

    Args:
        path: ends in .safetensors by custom.
        kind: what the weights are of, for example "pose"; checked on loading.
        tensors: by layer.
        settings: whatever JSON can hold.

    Raises:
        ValueError: when a layer holds NaN or infinity; nothing is written then.
    """
    from safetensors.torch import save

    path = Path(path)
    rows = {name: t.detach().cpu().contiguous() for name, t in tensors.items()}
    bad = [f"{name} ({t.dtype})" for name, t in rows.items() if not bool(t.isfinite().all())]
    if len(bad) > 0:
        raise WeightsError(
            f"{path}: weights not written, {', '.join(bad)} hold NaN or infinity; expected "
            "finite numbers, in float16 of at most 65504: look into the training that gave them"
        )
    # converted by JSON first, so that the checksum is the same after reading the file again
    plain = json.loads(json.dumps({"kind": kind, "settings": dict(settings)}))
    about = json.dumps(plain | {"sha256": checksum(rows, plain)}, sort_keys=True)
    with replacing(path) as beside:
        beside.write_bytes(save(rows, metadata={ABOUT: about}))


def save_humor(
    path: str | Path,
    networks: HumorNetworks,
    initial: Mixture,
    whitening: Float[Tensor, "207 207"],
    settings: Mapping[str, Any],
) -> None:
    """Write networks in half precision, their first layers and the mixture in single.

    The first layers see states: small differences of large numbers.
    """
    tensors = {
        name: tensor.float() if name.endswith("net.0.weight") else tensor.half()
        for name, tensor in networks.state_dict().items()
    }
    for name, tensor in initial.tensors().items():
        tensors[INITIAL + name] = tensor.float() if tensor.is_floating_point() else tensor
    tensors[WHITENING] = whitening.float()
    save_checkpoint(path, "humor", tensors, {"width": networks.width, **settings})


def save_anchor(path: Path, weights: AnchorWeights, settings: Mapping[str, Any]) -> None:
    """Write networks and principal directions in half precision, scales in single precision."""
    networks, basis = weights.networks, weights.networks.basis
    sizes = {
        "latent": networks.latent,
        "shape": networks.shape,
        "width": networks.width,
        "basis": len(basis.deviation),
    }
    tensors = half_precision(networks, basis=basis, spread=weights.spread)
    save_checkpoint(path, "anchor", tensors, {**settings, **sizes, "alignment": ALIGNMENT})


def save_humos(path: Path, weights: HumosWeights, settings: Mapping[str, Any]) -> None:
    """Write networks and principal directions in half precision, scales in single precision."""
    networks = weights.networks
    tensors = half_precision(networks, basis=networks.basis, density=weights.density)
    about = {"codes": CODES_OF, **settings, "frames": weights.frames}
    save_checkpoint(path, "humos", tensors, about)
