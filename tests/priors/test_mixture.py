"""The mixture of initial states against golden numbers, and its laws."""

from pathlib import Path

import numpy as np
import pytest
import torch

from priors.humor.mixture import Mixture
from tests.priors.test_humor_nets import golden
from training.humor.train import fitted_mixture


def golden_covariances() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    g = golden("losses")
    factor = g["gmm_cov_factor"]
    return g["gmm_weights"], g["gmm_means"], g["gmm_cov_diag"].diag_embed() + factor @ factor.mT


def test_log_probabilities_equal_the_reference() -> None:
    g = golden("losses")
    mixture = Mixture.create(*golden_covariances())
    torch.testing.assert_close(
        mixture.energy(g["gmm_test_x"]), -g["gmm_test_logprob"], rtol=0, atol=1e-9
    )  # nats
    torch.testing.assert_close(mixture.energy(g["gmm_x0"]), -g["gmm_logprob"], rtol=0, atol=1e-9)
    single = mixture.to(dtype=torch.float32).energy(g["gmm_test_x"].float())
    torch.testing.assert_close(single.double(), -g["gmm_test_logprob"], rtol=1e-4, atol=0)


def test_a_released_file_loads(tmp_path: Path) -> None:
    weights, means, covariances = golden_covariances()
    path = tmp_path / "prior_gmm.npz"
    np.savez(path, weights=weights, means=means, covariances=covariances)
    g = golden("losses")
    found = Mixture.load(path).energy(g["gmm_test_x"])
    torch.testing.assert_close(found, -g["gmm_test_logprob"], rtol=0, atol=1e-9)
    np.savez(path, weights=weights, means=means)
    with pytest.raises(ValueError, match=r"prior_gmm\.npz.*covariances"):
        Mixture.load(path)


def test_a_planted_mixture_is_found_and_sampled() -> None:
    random = torch.Generator().manual_seed(0)
    centres = torch.tensor([[0.0, 0.0, 0.0], [3.0, -2.0, 1.0]], dtype=torch.float64)
    which = (torch.rand(20_000, generator=random) < 0.3).long()
    samples = centres[which] + 0.2 * torch.randn(20_000, 3, generator=random).double()
    samples = torch.cat((samples, samples[:, :1]), 1)  # the last repeats the first
    features = torch.tensor([1, 2, 3])
    found = fitted_mixture(samples, features, components=2)
    order = found.log_weights.argsort(descending=True)
    torch.testing.assert_close(
        found.log_weights.exp()[order], torch.tensor([0.7, 0.3]).double(), rtol=0, atol=0.02
    )
    torch.testing.assert_close(found.means[order], centres[:, [1, 2, 0]], rtol=0, atol=0.02)
    drawn = found.sample(20_000, random)
    mean, covariance = drawn.mean(0), drawn.mT.cov()
    torch.testing.assert_close(mean, samples[:, features].mean(0), rtol=0, atol=0.05)
    torch.testing.assert_close(covariance, samples[:, features].mT.cov(), rtol=0, atol=0.1)
    nearest = (found.sample(500, random, 0.1)[:, None] - found.means).norm(dim=-1).amin(1)
    assert nearest.max() < 0.1  # a tenth of 0.2 in each of three directions, with margin


def test_the_energy_integrates_to_one() -> None:
    covariance = torch.tensor([[[0.5, 0.3], [0.3, 0.4]], [[0.1, 0.0], [0.0, 0.2]]])
    mixture = Mixture.create(
        torch.tensor([0.6, 0.4]), torch.tensor([[0.0, 0.0], [1.0, 1.0]]), covariance
    )
    axis = torch.linspace(-6, 6, 601, dtype=torch.float64)
    grid = torch.cartesian_prod(axis, axis)
    total = (-mixture.energy(grid)).exp().sum() * (axis[1] - axis[0]) ** 2
    assert abs(total.item() - 1) < 1e-6


def test_a_singular_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match=r"components \[0\]"):
        Mixture.create(torch.ones(1), torch.zeros(1, 2), torch.ones(1, 2, 2))


def test_rarity_is_measured_from_the_highest_mean() -> None:
    """Nats are negative where variances are small, and an energy with tails needs a zero."""
    weights = torch.tensor([0.9, 0.1], dtype=torch.float64)
    means = torch.tensor([[0.0, 0.0], [50.0, 0.0]], dtype=torch.float64)
    covariances = 1e-4 * torch.eye(2, dtype=torch.float64).expand(2, 2, 2)
    mixture = Mixture.create(weights, means, covariances)
    x = means + torch.tensor([0.0, 0.02], dtype=torch.float64)
    assert (mixture.energy(x) < 0).all()
    expected = torch.tensor([2.0, 2.0 + np.log(9.0)], dtype=torch.float64)
    torch.testing.assert_close(mixture.rarity(x), expected)
    torch.testing.assert_close(mixture.rarity(means)[0], torch.zeros_like(x[0, 0]))
