"""What is learned of cycles beside the networks: their principal directions, and their codes."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.frames import CODES, POSE_NUMBERS, CycleBasis
from priors.anchor.networks import CodeSpread

_LEAST_SPAN = 0.01
"""Metres or seconds that normalised numbers extend over, at least."""


def fitted_basis(rows: Float[Tensor, "cycles 100 124"], basis: int) -> CycleBasis:
    """A basis fitted to training cycles.

    Raises:
        ValueError: when there are fewer cycles than directions asked for.
    """
    if len(rows) <= basis:
        raise ValueError(f"{basis} directions need more cycles than {len(rows)}")
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
    """Moments of the mixture of all posteriors, and the cycles nearest to cluster centres."""
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
