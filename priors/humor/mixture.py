"""The density of initial states: a mixture of Gaussians over their independent features."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.core.errors import ReconError
from recon.core.struct import TensorStruct


@dataclass(frozen=True)
class Mixture(TensorStruct):
    """Mixture of Gaussians p(x) = Σ_k w_k N(x; m_k, C_k) over selected entries of x.

    Numbers that follow from others make covariances singular: an energy that punishes a
    mismatch of a millimetre by hundreds of nats, and stops a minimiser. They are left out by
    `features`. What is kept of C_k is the Cholesky factor of its inverse, found in double
    precision.
    """

    features: Int[Tensor, " features"]
    """Indices of the numbers of x that the mixture is over."""
    log_weights: Float[Tensor, " components"]
    means: Float[Tensor, "components features"]
    whitening: Float[Tensor, "components features features"]
    """U with C⁻¹ = U Uᵀ: y = (x - m) U has unit covariance."""

    @classmethod
    def create(
        cls,
        weights: Float[Tensor, " components"],
        means: Float[Tensor, "components features"],
        covariances: Float[Tensor, "components features features"],
        features: Int[Tensor, " features"] | None = None,
    ) -> "Mixture":
        """Make a mixture in double precision from weights, means and covariances.

        Raises:
            ValueError: when a covariance is not positive definite.
        """
        factor, failed = torch.linalg.cholesky_ex(covariances.double())
        if bool(failed.any()):
            bad = failed.nonzero()[:, 0].tolist()
            raise ReconError(
                f"expected positive definite covariances, but those of components {bad} are not; "
                "leave out features that follow from others, or regularise more"
            )
        identity = torch.eye(means.shape[1], dtype=torch.float64, device=means.device)
        whitening = torch.linalg.solve_triangular(factor, identity.expand_as(factor), upper=False)
        if features is None:
            features = torch.arange(means.shape[1], device=means.device)
        return cls(features, weights.double().log(), means.double(), whitening.mT.contiguous())

    @classmethod
    def load(cls, path: str | Path) -> "Mixture":
        """Load the authors' released file: weights, means and covariances of all 138 features.

        Raises:
            FileNotFoundError: when there is no such file.
            ValueError: when it holds something else.
        """
        from recon.formats.opening import load_arrays  # imported only for HuMoR's own files

        arrays = load_arrays(Path(path))
        names = ("weights", "means", "covariances")
        if missing := [name for name in names if name not in arrays]:
            raise ReconError(
                f"{path}: expected a mixture with {', '.join(names)}; missing {missing}, found "
                f"{sorted(arrays)}"
            )
        return cls.create(*(torch.from_numpy(arrays[name]).double() for name in names))

    def energy(self, x: Float[Tensor, "*batch numbers"]) -> Float[Tensor, "*batch"]:
        """-log p(x), nats."""
        away = x[..., None, self.features] - self.means
        white = torch.einsum("...kd,kde->...ke", away, self.whitening)
        return -(self._log_heights() - 0.5 * white.square().sum(-1)).logsumexp(-1)

    def rarity(self, x: Float[Tensor, "*batch numbers"]) -> Float[Tensor, "*batch"]:
        """-log p(x) above its value at the mean of the highest component, at least zero; nats.

        A draw of one component is about half as many above that component as it has numbers.
        """
        return (self.energy(x) + self._log_heights().max()).clamp(min=0)

    def _log_heights(self) -> Float[Tensor, " components"]:
        """log(w_k N(m_k; m_k, C_k)): log-density of every component at its own mean."""
        log_volume = self.whitening.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        return self.log_weights + log_volume - 0.5 * len(self.features) * math.log(2 * math.pi)

    def sample(
        self, count: int, random: torch.Generator, temperature: float = 1.0
    ) -> Float[Tensor, "count features"]:
        """Draw vectors x (only entries `features`); `temperature` scales standard deviations."""
        probability = self.log_weights.exp().cpu()
        component = torch.multinomial(probability, count, replacement=True, generator=random)
        white = torch.randn(count, len(self.features), generator=random).to(self.means)
        component = component.to(self.means.device)
        lower = self.whitening[component].mT  # solve white = Uᵀ (x - mean) for x - mean
        away = torch.linalg.solve_triangular(lower, white[..., None], upper=False)
        return self.means[component] + temperature * away[..., 0]
