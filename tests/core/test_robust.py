"""Robust kernels: what they equal near zero, far out, and in the reference."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import norm
from torch import Tensor

from recon.core import residuals

GOLDEN = Path(__file__).parents[1] / "golden" / "losses.npz"


def numbers(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.fixture(scope="module")
def golden() -> dict[str, Tensor]:
    with np.load(GOLDEN, allow_pickle=False) as file:
        names = ("points3d_residual", "points3d_weight", "points3d_scale", "value_points3d")
        return {name: torch.from_numpy(np.asarray(file[name])) for name in names}


def test_kernels_agree_with_squares_near_zero() -> None:
    small = numbers(0.0, 1e-12, 1e-10)
    torch.testing.assert_close(residuals.squared(small), small, rtol=0, atol=0)
    torch.testing.assert_close(residuals.geman_mcclure(small, 1.0), small, rtol=1e-9, atol=0)


def test_geman_mcclure_saturates_at_sigma_squared() -> None:
    assert residuals.geman_mcclure(numbers(1e12), 100.0).item() == pytest.approx(1e4, rel=1e-7)
    assert residuals.geman_mcclure(numbers(1e4), 100.0).item() == pytest.approx(5e3)


@pytest.mark.parametrize(
    "kernel",
    [
        residuals.squared,
        lambda squared: residuals.geman_mcclure(squared, 1.0),
    ],
)
def test_gradients_are_right_and_finite_at_zero(kernel: object) -> None:
    residual = numbers(0.0, 0.3, -0.7, 2.5).requires_grad_()

    def energy(e: Tensor) -> Tensor:
        return kernel(e.square()).sum()  # type: ignore[operator]

    assert torch.autograd.gradcheck(energy, (residual,))


def test_median_takes_the_lower_middle_of_those_present() -> None:
    values = numbers(5.0, 1.0, 4.0, 2.0)
    everything = torch.ones(4, dtype=torch.bool)
    assert residuals.lower_median(values, everything).item() == 2.0
    assert residuals.lower_median(values, values > 1.5).item() == 4.0
    assert residuals.lower_median(values, ~everything).item() == 0.0


def test_the_median_of_one_sample_is_that_sample_and_of_none_zero() -> None:
    values = numbers(3.0, 5.0, 7.0).expand(3, 3)
    present = torch.tensor([[False, True, False], [False, False, False], [True, True, False]])
    assert residuals.lower_median(values, present).tolist() == [5.0, 0.0, 3.0]
    none = torch.zeros(2, 0)
    assert residuals.lower_median(none, none > 0).tolist() == [0.0, 0.0]


def test_half_of_normal_values_deviate_less_than_their_median_deviation() -> None:
    assert pytest.approx(norm.ppf(0.75), rel=1e-5) == residuals.NORMAL_MAD
