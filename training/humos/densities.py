"""What is learned of motions beside the networks: principal directions of windows, and codes."""

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humos.frames import LappedBasis, cut_windows
from priors.humos.networks import CodeDensity

_MEMORY = 0.98
"""Most that any direction of a code keeps to the next."""


def fitted_basis(rows: Float[Tensor, "clips time numbers"], basis: int) -> LappedBasis:
    """A basis fitted to stretches of motion, each of two hops or longer.

    Raises:
        ValueError: when there are fewer windows than directions asked for.
    """
    windows = cut_windows(rows)[:, 1:-1].flatten(0, 1)
    if len(windows) <= basis:
        raise ValueError(f"{basis} directions need more windows than {len(windows)}")
    mean = windows.mean(0)
    away = (windows - mean).double()
    values, vectors = torch.linalg.eigh(away.mT @ away / (len(windows) - 1))
    deviation = values.flip(0)[:basis].clamp(min=0).sqrt().float()
    return LappedBasis(mean, vectors.flip(1).mT[:basis].float().contiguous(), deviation)


def fitted_codes(
    codes: Float[Tensor, "codes latent"], variance: Float[Tensor, " latent"],
    pairs: tuple[Float[Tensor, "pairs latent"], Float[Tensor, "pairs latent"]],
) -> CodeDensity:  # fmt: skip
    """Moments of all posteriors, and covariances of neighbours.

    Stationary: rest restᵀ = I - follow followᵀ, so that u has unit variance at any time.

    Args:
        codes: means of posteriors.
        variance: their mean variances.
        pairs: neighbouring codes, earlier and later.
    """
    mean = codes.double().mean(0)
    away = codes.double() - mean
    noise = variance.double().diag()
    root = torch.linalg.cholesky(away.mT @ away / (len(codes) - 1) + noise)
    size = len(mean)
    follow, rest = torch.zeros(size, size), torch.eye(size)
    if len(pairs[0]) > size:
        before, after = (
            torch.linalg.solve_triangular(root, (p.double() - mean).mT, upper=False).mT
            for p in pairs
        )
        # u has unit variance, so the covariance of neighbours is the regression matrix; with
        # singular
        # values below one the process is stationary, whatever the length of the clip
        left, lengths, right = torch.linalg.svd(after.mT @ before / len(before))
        follow = (left * lengths.clamp(max=_MEMORY)) @ right
        rest = torch.linalg.cholesky(torch.eye(size, dtype=torch.float64) - follow @ follow.mT)
    return CodeDensity(mean.float(), root.float(), follow.float(), rest.float())
