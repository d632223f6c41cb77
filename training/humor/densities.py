"""What is learned beside the networks: the density of first states and the decoder's errors."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.state import State
from priors.humor.steps import explain

_SHRINKAGE = 0.05
"""Share by which variances of errors are raised, so that directions of almost no variance do not
count without end."""


def fitted_mixture(
    samples: Float[Tensor, "samples numbers"],
    features: Int[Tensor, " features"],
    components: int = 12,
    regularisation: float = 1e-4,
    seed: int = 0,
) -> Mixture:
    """A mixture fitted by expectation maximisation from k-means (HuMoR, section 4).

    Args:
        samples: rows of all numbers.
        features: those to model.
        components: Gaussians.
        regularisation: added to every variance; 1e-4 is a centimetre, or 1 cm/s, squared.
        seed: of the k-means start.
    """
    from sklearn.mixture import GaussianMixture

    mixture = GaussianMixture(
        components, reg_covar=regularisation, max_iter=200, random_state=seed
    )
    mixture.fit(samples[:, features].double().cpu().numpy())
    return Mixture.create(
        torch.from_numpy(mixture.weights_),
        torch.from_numpy(mixture.means_),
        torch.from_numpy(mixture.covariances_),
        features,
    )


def error_whitening(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> Float[Tensor, "207 207"]:
    """U with C⁻¹ = U Uᵀ for the covariance C (about zero) of the decoder's errors on motions."""
    with torch.no_grad():
        errors = explain(networks, states, pelvis).error.flatten(0, 1).double()
    covariance = errors.mT @ errors / len(errors)
    covariance = covariance + _SHRINKAGE * torch.diag(covariance.diagonal() + 1e-9)
    factor = torch.linalg.cholesky(covariance)
    identity = torch.eye(len(factor), dtype=factor.dtype)
    return torch.linalg.solve_triangular(factor, identity, upper=False).mT.contiguous()
