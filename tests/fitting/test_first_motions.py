"""What a first motion tells: how long errors last."""

import pytest
import torch

from recon.fitting.first_motions import correlated_frames


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
    ratio = (1 + correlation) / (1 - correlation) / 1.5**2  # to white noise of 1.5
    found = correlated_frames(errors + offsets, visible, 1.5)
    assert found == pytest.approx(max(1.0, 1 + 3 * (ratio - 1)), rel=0.25)
    fewer = correlated_frames(errors + offsets, visible, 1.5, rate=0.8)
    assert fewer == pytest.approx(max(1.0, 1 + 3 * (0.8 * ratio - 1)), rel=0.25)


def test_frames_that_a_motion_does_not_follow_do_not_count():
    """A first motion that is far from a cartwheel for half a second left the view a quarter."""
    errors, visible = lasting_errors(0.0), torch.ones(200, 30, dtype=torch.bool)
    errors[80:100] += 20 * lasting_errors(0.9, 20)
    assert correlated_frames(errors, visible, 1.0) == pytest.approx(1.0, abs=0.25)


def test_errors_below_the_noise_and_without_frames_change_nothing():
    visible = torch.ones(200, 30, dtype=torch.bool)
    assert correlated_frames(0.1 * lasting_errors(0.6), visible, 1.0) == 1.0
    assert correlated_frames(lasting_errors(0.6), ~visible, 1.0) == 1.0
    assert correlated_frames(torch.zeros(200, 30, 2), visible, 1.0) == 1.0
    assert correlated_frames(lasting_errors(0.95), visible, 1.0) == 4.0
