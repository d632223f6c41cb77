"""From a finished run of the HUMOS prior to a weights file."""

import logging
from pathlib import Path

import torch

from priors.humos.training.corpus import BodyCorpus, BodyVariation
from priors.humos.training.losses import encoded
from priors.humos.training.run import HumosRun, HumosTraining
from priors.humos.weights import CodeDensity, HumosWeights, save_weights
from priors.training.dataset import Splits
from priors.training.run_settings import plain
from recon.body.model import BodyModel

_LOG = logging.getLogger("priors.humos.training.train")

_STRETCHES = 2048
"""Windows whose codes the density is taken from."""
_SPREAD = BodyVariation(shape=0.2)
"""How they are varied."""


def export_weights(settings: HumosTraining, path: Path) -> Path:
    """Write the networks of a run, with the density of their codes on the training clips.

    Raises:
        FileNotFoundError: when the run has no checkpoint yet, or there is no corpus.
    """
    body, splits = BodyModel.load(), Splits.load(settings.splits)
    learned = BodyCorpus.load(settings.corpus, splits, "train", settings.data, body)
    return export_learned(settings, path, learned)


def export_learned(settings: HumosTraining, path: Path, learned: BodyCorpus) -> Path:
    """The same from clips that are loaded already."""
    if not (settings.out / "checkpoint.pt").is_file():
        raise FileNotFoundError(f"{settings.out}: no checkpoint there yet; train first")
    run = HumosRun.start(settings, learned)
    networks = run.averaged
    random = torch.Generator().manual_seed(settings.seed)
    codes, variances, before, after = [], [], [], []
    for _ in range(_STRETCHES // 64):
        batch = learned.draw(64, settings.frames, _SPREAD, random)
        exists = batch.windows
        with torch.no_grad():
            found = encoded(networks, batch.frames.pack(), batch.shape, exists, None)
        one = found.mean.shape[1] == 1
        known = torch.ones_like(exists[:, :1]) if one else exists
        codes.append(found.mean[known])
        variances.append(found.log_variance.exp()[known])
        both = known[:, 1:] & known[:, :-1]
        before.append(found.mean[:, :-1][both])
        after.append(found.mean[:, 1:][both])
    density = CodeDensity.fit(
        torch.cat(codes), torch.cat(variances).mean(0), (torch.cat(before), torch.cat(after))
    )
    about = {k: v for k, v in plain(settings).items() if k not in _LOCAL}
    about |= {"shape": learned.shape.shape[1], "step": run.step}
    save_weights(path, HumosWeights(networks, density, settings.frames), about)
    _LOG.info("wrote the networks of step %d as %s", run.step, path)
    return path


_LOCAL = ("corpus", "out", "splits", "warm")
