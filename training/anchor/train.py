"""Learns gait cycles: principal components, and the normal distribution of their coefficients.

The fit has a closed form, so there is nothing to resume: a run takes half a minute. A network in
its place, the VAE of Marsot et al. (2022), completed cycles less well (docs/tried.md).
"""

import math
from dataclasses import dataclass, field
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn

from priors.anchor.frames import CODES, POSE_NUMBERS, CycleBasis
from priors.anchor.networks import AnchorNetworks, AnchorWeights, CodeSpread
from recon.body.model import BodyModel
from training.anchor.corpus import CycleCorpus, CycleVariation
from training.settings import CorpusSettings, settings_to_store
from training.weights import save_anchor

_DRAWN_AT_ONCE = 256
"""Cycles."""
_TYPICAL = 8
"""Codes kept to begin searches with, where there are as many cycles."""
_SPREAD = CycleVariation(exchange=0.0, mix=0.0)
"""Variation of the cycles from which the distribution of codes is taken."""
_EXACT = -10.0
"""Log-variance of a coefficient, which is known exactly."""


@dataclass(frozen=True)
class AnchorTraining(CorpusSettings):
    """Settings of a run that learns cycles of gait."""

    latent: int = 512
    """Principal components, which are the numbers of a code."""
    basis_from: int = 8192
    """Varied cycles from which the components are taken."""
    seed: int = 0
    variation: CycleVariation = field(default_factory=CycleVariation)
    """Random variations of the cycles."""


def export_weights(settings: AnchorTraining, path: Path) -> None:
    """Learn the components of the training cycles and write them.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when there is no cycle to learn from.
    """
    torch.set_num_threads(1)
    learned = CycleCorpus.load(settings, "train", BodyModel.load())
    save_anchor(path, principal_components(settings, learned), settings_to_store(settings))


def principal_components(settings: AnchorTraining, learned: CycleCorpus) -> AnchorWeights:
    """Fit principal components to augmented cycles, and the distribution of their coefficients."""
    random = torch.Generator().manual_seed(settings.seed)
    rows = [
        learned.draw(_DRAWN_AT_ONCE, settings.variation, random).anchors.pack()
        for _ in range(-(-settings.basis_from // _DRAWN_AT_ONCE))
    ]
    basis = fitted_basis(torch.cat(rows), settings.latent)
    networks = AnchorNetworks(basis, settings.latent, learned.shape.shape[1], width=0)
    last = networks.encoder[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias[settings.latent :] = _EXACT
    networks.eval().requires_grad_(False)
    random = torch.Generator().manual_seed(settings.seed)
    drawn = learned.draw(settings.basis_from // 2, _SPREAD, random)
    mean, log_variance = networks.posterior(drawn.anchors.pack())
    typical = min(_TYPICAL, len(learned.shape))
    spread = fitted_spread(mean, log_variance.exp(), typical, settings.seed)
    return AnchorWeights(networks, spread)


_LEAST_SPAN = 0.01
"""Metres or seconds that normalised numbers extend over, at least."""


def fitted_basis(rows: Float[Tensor, "cycles 100 124"], basis: int) -> CycleBasis:
    """Fit the linear basis of cycles to training cycles (principal components).

    Raises:
        ValueError: when there are fewer cycles than directions asked for.
    """
    if len(rows) <= basis:
        raise ValueError(
            f"expected more cycles than the {basis} principal directions, got {len(rows)}"
        )
    low, high = rows[..., POSE_NUMBERS:].amin((0, 1)), rows[..., POSE_NUMBERS:].amax((0, 1))
    low = torch.cat((low[:3], low.new_zeros(1)))
    high = high.maximum(low + _LEAST_SPAN)
    plain = CycleBasis(low, high, rows.new_zeros(CODES), torch.eye(CODES)[:0], rows.new_zeros(0))
    codes = plain.codes(plain.normalised(rows))
    mean = codes.mean(0)
    _, lengths, directions = torch.linalg.svd(codes - mean, full_matrices=False)
    deviation = lengths[:basis] / math.sqrt(len(rows) - 1)
    return CycleBasis(low, high, mean, directions[:basis].contiguous(), deviation)


def fitted_spread(
    means: Float[Tensor, "cycles latent"], variances: Float[Tensor, "cycles latent"],
    typical: int, seed: int = 0,
) -> CodeSpread:  # fmt: skip
    """Mean and covariance of all cycles' codes, and a few typical codes by clustering."""
    from sklearn.cluster import KMeans

    codes = means.double()
    mean = codes.mean(0)
    away = codes - mean
    covariance = away.mT @ away / max(len(codes) - 1, 1) + variances.double().mean(0).diag()
    rows = codes.numpy()
    found = KMeans(typical, random_state=seed).fit(rows)
    centres = torch.from_numpy(found.cluster_centers_)
    nearest = torch.cdist(centres, codes).argmin(-1)
    return CodeSpread(mean.float(), torch.linalg.cholesky(covariance).float(), means[nearest])
