"""The linear prior of cycles: principal components with their Gaussian, no network.

    python -m training.anchor.components CORPUS --out cycles.safetensors --components 256

What the anchor-frame VAE starts as: the same varied cycles of the same people, the same
directions, and the normal distribution of the coefficients. It is loaded like the VAE
(`AnchorFrames.load("cycles.safetensors")`), so that both are fitted by one method.
"""

import argparse
import logging
from dataclasses import replace
from pathlib import Path

import torch
from torch import nn

from priors.anchor.frames import CycleBasis
from priors.anchor.networks import AnchorNetworks, AnchorWeights, save_weights
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from training.anchor.corpus import CycleCorpus
from training.anchor.run import AnchorTraining, basis_of, spread_of
from training.run import told_settings

_SHARP = -10.0
"""Log-variance of a coefficient, which is known exactly."""


def components(settings: AnchorTraining, learned: CycleCorpus) -> AnchorWeights:
    """Principal components of training cycles, as many as a code has numbers in the settings.

    Args:
        settings: of which the size of the code, what is aligned, how cycles vary and the seed
            count.
        learned: the training cycles.
    """
    random = torch.Generator().manual_seed(settings.seed)
    basis = basis_of(settings, learned, random)
    networks = principal(basis, learned.shape.shape[1])
    spread = spread_of(settings, networks, learned)
    return AnchorWeights(networks, spread, settings.alignment)


def principal(basis: CycleBasis, shape: int) -> AnchorNetworks:
    """Codes that are the coefficients of a basis, of bodies with so many shape coefficients."""
    size = len(basis.deviation)
    networks = AnchorNetworks(basis, size, shape, 0)
    last = networks.encoder[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias[size:] = _SHARP
    networks.eval().requires_grad_(False)
    return networks


def _main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("corpus", type=Path, help="folder that `recon convert --all` wrote")
    parser.add_argument("--out", type=Path, required=True, help="weights to write (.safetensors)")
    parser.add_argument("--data", choices=("open", "nc"), default="open")
    parser.add_argument("--components", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    settings = AnchorTraining(corpus=given.corpus, out=given.out, data=given.data, seed=given.seed)
    size = {"latent": given.components, "basis": given.components, "width": 0}
    settings = replace(settings, steps=0, surface_steps=0, **size)
    body, splits = BodyModel.load(), Splits.load(settings.splits)
    learned = CycleCorpus.load(settings.corpus, splits, "train", settings.data, body)
    save_weights(given.out, components(settings, learned), told_settings(settings))


if __name__ == "__main__":
    _main()
