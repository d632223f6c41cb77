"""The noise of points is told from the data alone."""

import pytest
import torch

from observations.noise import LIMITS, estimate_noise
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
