"""The linear prior of cycles: principal components with their Gaussian, no network.

    python -m training.anchor.components CORPUS --out cycles.safetensors --components 512

What the anchor-frame VAE starts as: the same varied cycles of the same people, the same
directions, and the normal distribution of the coefficients. It is loaded like the VAE
(`AnchorFrames.load("cycles.safetensors")`), so that both are fitted by one method.
"""

import logging
from pathlib import Path

import torch
import tyro
from torch import nn

from priors.anchor.networks import AnchorNetworks, AnchorWeights, save_weights
from recon.benchmark.dataset import Licence
from recon.body.model import BodyModel
from training.anchor.corpus import CycleCorpus
from training.anchor.train import AnchorTraining, basis_of, spread_of
from training.settings import told_settings

_SHARP = -10.0
"""Log-variance of a coefficient, which is known exactly."""


def linear(settings: AnchorTraining, learned: CycleCorpus) -> AnchorWeights:
    """Principal components of training cycles, as many as the settings have principal directions.

    Args:
        settings: of which the number of directions, how cycles vary and the seed count.
        learned: the training cycles.
    """
    random = torch.Generator().manual_seed(settings.seed)
    basis, shape = basis_of(settings, learned, random), learned.shape.shape[1]
    networks = AnchorNetworks(basis, settings.basis, shape, 0)
    last = networks.encoder[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias[settings.basis :] = _SHARP
    networks.eval().requires_grad_(False)
    return AnchorWeights(networks, spread_of(settings, networks, learned))


def main(
    corpus: tyro.conf.Positional[Path],
    out: Path,
    data: Licence = "open",
    components: int = 256,
    seed: int = 0,
) -> None:
    """Principal components of gait cycles as weights of the anchor-frame prior.

    Args:
        corpus: folder that `recon convert --all` wrote.
        out: weights to write (.safetensors).
        data: `open` learns from clips whose weights may be shipped, `nc` also from those under a
            non-commercial licence.
        components: numbers of a code.
        seed: of everything random.
    """
    torch.set_num_threads(1)
    settings = AnchorTraining(
        corpus, out, data, seed=seed, latent=components, basis=components, width=0, steps=0,
        surface_steps=0,
    )  # fmt: skip
    learned = CycleCorpus.load(settings, "train", BodyModel.load())
    save_weights(out, linear(settings, learned), told_settings(settings))


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    tyro.cli(main)
