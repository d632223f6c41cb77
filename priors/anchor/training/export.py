"""From a run of the anchor-frame VAE to a weights file."""

import logging
from pathlib import Path
from typing import Any

import torch

from priors.anchor.basis import CycleBasis
from priors.anchor.networks import AnchorNetworks
from priors.anchor.training.corpus import CycleCorpus, CycleVariation
from priors.anchor.training.run import AnchorTraining
from priors.anchor.weights import AnchorWeights, CodeSpread, save_weights
from priors.training.dataset import Splits
from priors.training.run_settings import plain
from recon.body.model import BodyModel

_LOG = logging.getLogger("priors.anchor.training.train")

TYPICAL = 8
"""Codes kept to begin searches with, where there are as many cycles."""
_SPREAD = CycleVariation(exchange=0.0, mix=0.0)
"""Cycles whose codes tell how codes are spread."""


def export_weights(settings: AnchorTraining, path: Path, networks: str = "best.pt") -> Path:
    """Write the best networks of a run, with the spread of the codes of its corpus.

    Args:
        settings: of the run.
        path: weights to write (.safetensors).
        networks: file in the run's folder; `parameters.pt` are those after the first phase.

    Raises:
        FileNotFoundError: when the run has not validated yet, or there is no corpus.
    """
    body, splits = BodyModel.load(), Splits.load(settings.splits)
    learned = CycleCorpus.load(settings.corpus, splits, "train", settings.data, body)
    return export_learned(settings, path, learned, networks)


def export_learned(
    settings: AnchorTraining, path: Path, learned: CycleCorpus, networks: str = "best.pt"
) -> Path:
    """The same from cycles that are loaded already."""
    best = settings.out / networks
    if not best.is_file():
        raise FileNotFoundError(f"{best}: no networks there yet; train first")
    found: dict[str, Any] = torch.load(best, weights_only=True, map_location="cpu")
    basis = CycleBasis(**found["basis"])
    shape = learned.shape.shape[1]
    model = AnchorNetworks(basis, settings.latent, shape, settings.width)
    model.load_state_dict(found["networks"])
    model.eval().requires_grad_(False)
    random = torch.Generator().manual_seed(settings.seed)
    drawn = learned.draw(settings.basis_from // 2, _SPREAD, settings.alignment, random)
    mean, log_variance = model.posterior(drawn.anchors.pack())
    typical = min(TYPICAL, len(learned.shape))
    spread = CodeSpread.fit(mean, log_variance.exp(), typical, settings.seed)
    about = {k: v for k, v in plain(settings).items() if k not in ("corpus", "out", "splits")}
    weights = AnchorWeights(model, spread, settings.alignment)
    save_weights(path, weights, about | {"step": found["step"]})
    _LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path
