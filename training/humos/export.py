"""Export of a finished run of the HUMOS prior as a weights file."""

import logging
from pathlib import Path

import torch

from priors.humos.frames import LappedBasis
from priors.humos.networks import CodeDensity, HumosWeights, WindowNetworks, save_weights
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from training.humos.corpus import BodyCorpus, BodyVariation
from training.humos.run import HumosTraining, untrained
from training.humos.train import encoded
from training.run import CHECKPOINT, told_settings, trained_state

_LOG = logging.getLogger("training.humos.train")

_STRETCHES = 2048
"""Windows whose codes the density is taken from."""
_SPREAD = BodyVariation(shape=0.2)
"""Random variations of the windows whose codes the density is taken from."""


def export_weights(settings: HumosTraining, path: Path) -> Path:
    """Write the networks of a run, with the density of their codes on the training clips.

    Raises:
        FileNotFoundError: when the run has no checkpoint yet, or there is no corpus.
    """
    body, splits = BodyModel.load(), Splits.load(settings.splits)
    learned = BodyCorpus.load(settings.corpus, splits, "train", settings.data, body)
    return export_learned(settings, path, learned)


def export_learned(settings: HumosTraining, path: Path, learned: BodyCorpus) -> Path:
    """Write weights as `export_weights` does, from clips that are loaded already."""
    found = trained_state(settings.out / CHECKPOINT)
    basis = LappedBasis(**found["basis"])
    networks = untrained(settings, basis, learned.shape.shape[1])
    networks.load_state_dict(found["averaged"])
    networks.eval().requires_grad_(False)
    density = _density(settings, networks, learned)
    about = told_settings(settings) | {"shape": learned.shape.shape[1], "step": found["step"]}
    save_weights(path, HumosWeights(networks, density, settings.frames), about)
    _LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path


def _density(
    settings: HumosTraining, networks: WindowNetworks, learned: BodyCorpus
) -> CodeDensity:
    """The distribution of the training clips' codes, and of each given the one before."""
    random = torch.Generator().manual_seed(settings.seed)
    codes, variances, before, after = [], [], [], []
    for _ in range(_STRETCHES // 64):
        batch = learned.draw(64, settings.frames, _SPREAD, random)
        exists = batch.windows
        found = encoded(networks, batch.frames.pack(), batch.shape, exists, None)
        one = found.mean.shape[1] == 1
        known = torch.ones_like(exists[:, :1]) if one else exists
        codes.append(found.mean[known])
        variances.append(found.log_variance.exp()[known])
        both = known[:, 1:] & known[:, :-1]
        before.append(found.mean[:, :-1][both])
        after.append(found.mean[:, 1:][both])
    return CodeDensity.fit(
        torch.cat(codes), torch.cat(variances).mean(0), (torch.cat(before), torch.cat(after))
    )
