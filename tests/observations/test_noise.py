"""The noise of points is told from the data alone."""

import pytest
import torch

from observations.noise import LIMITS, error_repetition, estimate_noise
from tests import laws


@pytest.mark.parametrize("noise", [0.02, 0.04, 0.08])
def test_planted_noise_is_found(noise, toy_body):
    joints = toy_body.pose(laws.a_motion(toy_body, frames=60)).joints
    generator = torch.Generator().manual_seed(0)
    noisy = joints + noise * torch.randn(joints.shape, generator=generator, dtype=joints.dtype)
    visible = torch.rand(joints.shape[:-1], generator=generator) < 0.9
    found = estimate_noise(noisy * visible[..., None], visible)
    assert found == pytest.approx(noise, rel=0.1)


def test_clean_and_sparse_data_meet_the_limits(toy_body):
    joints = toy_body.pose(laws.a_motion(toy_body, frames=60)).joints
    visible = torch.ones(joints.shape[:-1], dtype=torch.bool)
    assert estimate_noise(joints, visible) == LIMITS[0]
    assert estimate_noise(joints, torch.arange(22).expand_as(visible) < 0) == LIMITS[1]
    assert estimate_noise(joints[:, :2], visible[:, :2]) == LIMITS[1]


def lasting_errors(correlation: float, frames: int = 200) -> torch.Tensor:
    """Errors of thirty points of a standard deviation of one, each like the one before."""
    generator = torch.Generator().manual_seed(1)
    new = torch.randn(frames, 30, 2, generator=generator, dtype=torch.float64)
    errors = [new[0]]
    for one in new[1:]:
        errors.append(correlation * errors[-1] + (1 - correlation**2) ** 0.5 * one)
    return torch.stack(errors)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.6])
def test_frames_whose_errors_last_count_as_fewer(correlation):
    """The mean of an AR(1) process has (1 + ρ) / (1 - ρ) times the variance of white noise."""
    errors, visible = lasting_errors(correlation), torch.ones(200, 30, dtype=torch.bool)
    visible[50:60, :5] = False
    errors[50:60, :5] = 1e6
    offsets = torch.linspace(-20, 20, 30, dtype=torch.float64)[:, None]  # of points: left out
    excess = (1 + correlation) / (1 - correlation) - 1
    found = error_repetition(errors + offsets, visible, 1.0)
    assert found == pytest.approx(1 + 3 * excess, rel=0.25)
    half = error_repetition(errors + offsets, visible, 1.0, rate=0.5)
    assert half == pytest.approx(max(1.0, 1 + 3 * (excess - 1) / 2), rel=0.25)


def test_errors_below_the_noise_and_without_frames_change_nothing():
    visible = torch.ones(200, 30, dtype=torch.bool)
    assert error_repetition(0.1 * lasting_errors(0.6), visible, 1.0) == 1.0
    assert error_repetition(lasting_errors(0.6), ~visible, 1.0) == 1.0
    assert error_repetition(torch.zeros(200, 30, 2), visible, 1.0) == 1.0
    assert error_repetition(lasting_errors(0.95), visible, 1.0) == 16.0
