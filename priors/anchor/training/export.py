"""Export of a training run of the anchor-frame VAE as a weights file."""

import logging
from pathlib import Path

import torch

from priors.anchor.basis import CycleBasis
from priors.anchor.networks import AnchorNetworks
from priors.anchor.training.corpus import CycleCorpus, CycleVariation
from priors.anchor.training.run import AnchorTraining
from priors.anchor.weights import AnchorWeights, CodeSpread, save_weights
from priors.training.dataset import Splits
from priors.training.run import trained_state
from priors.training.run_settings import told_settings
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
    """Write weights as `export_weights` does, from cycles that are loaded already."""
    found = trained_state(settings.out / networks)
    basis = CycleBasis(**found["basis"])
    shape = learned.shape.shape[1]
    model = AnchorNetworks(basis, settings.latent, shape, settings.width)
    model.load_state_dict(found["networks"])
    model.eval().requires_grad_(False)
    spread = spread_of(settings, model, learned)
    weights = AnchorWeights(model, spread, settings.alignment)
    save_weights(path, weights, told_settings(settings) | {"step": found["step"]})
    _LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path


def spread_of(settings: AnchorTraining, model: AnchorNetworks, learned: CycleCorpus) -> CodeSpread:
    """How codes of varied training cycles are spread, and which are typical."""
    random = torch.Generator().manual_seed(settings.seed)
    drawn = learned.draw(settings.basis_from // 2, _SPREAD, settings.alignment, random)
    mean, log_variance = model.posterior(drawn.anchors.pack())
    typical = min(TYPICAL, len(learned.shape))
    return CodeSpread.fit(mean, log_variance.exp(), typical, settings.seed)
