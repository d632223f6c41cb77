"""Our rotations equal those of RoMa, which is loaded by tests alone."""

import math

import pytest
import roma
import torch
from torch import Tensor

from recon.core import rotations as so3

pytestmark = pytest.mark.numerics

SIZES = (0.0, 1e-9, 1e-4, 4e-3, 0.3, 1.0, math.pi - 1e-9, math.pi, 5.0)
"""Radians; some on either side of where a series takes over."""


@pytest.fixture(params=SIZES)
def rotations(request) -> Tensor:
    axes = torch.nn.functional.normalize(torch.randn(40, 3, dtype=torch.float64), dim=-1)
    return so3.exp(request.param * axes)


def _gradient(function, argument: Tensor, weights: Tensor) -> Tensor:
    leaf = argument.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((function(leaf) * weights).sum(), leaf)
    return gradient


def test_logarithms_and_their_gradients(rotations):
    assert torch.allclose(so3.log(rotations), roma.rotmat_to_rotvec(rotations), atol=1e-14)
    weights = torch.randn(40, 3, dtype=torch.float64)
    theirs = _gradient(roma.rotmat_to_rotvec, rotations, weights)
    assert torch.allclose(_gradient(so3.log, rotations, weights), theirs, rtol=1e-12, atol=1e-12)


def test_quaternions(rotations):
    assert torch.allclose(so3.to_quaternion(rotations), roma.rotmat_to_unitquat(rotations),
                          atol=1e-14)  # fmt: skip


def test_angles_between(rotations):
    others = rotations.roll(1, 0)
    theirs = roma.rotmat_geodesic_distance(rotations, others)
    assert torch.allclose(so3.geodesic_angle(rotations, others), theirs, atol=1e-12)


def test_the_nearest_rotation(rotations):
    for spoilt in (rotations, -rotations, rotations + torch.randn_like(rotations)):
        theirs = roma.special_procrustes(spoilt)
        # where two rotations are as near, which one is chosen means nothing
        distances = [
            (spoilt - one).norm(dim=(-2, -1)) for one in (so3.nearest_rotation(spoilt), theirs)
        ]
        assert torch.allclose(*distances, atol=1e-12)
    noisy = rotations + 0.05 * torch.randn_like(rotations)
    assert torch.allclose(so3.nearest_rotation(noisy), roma.special_procrustes(noisy), atol=1e-12)


def test_six_numbers_and_their_gradients(rotations):
    columns = so3.to_6d(rotations) + 0.1 * torch.randn(40, 6, dtype=torch.float64)

    def theirs(c: Tensor) -> Tensor:
        return roma.special_gramschmidt(c.unflatten(-1, (2, 3)).mT)

    assert torch.allclose(so3.from_6d(columns), theirs(columns), atol=1e-14)
    weights = torch.randn(40, 3, 3, dtype=torch.float64)
    expected = _gradient(theirs, columns, weights)
    assert torch.allclose(_gradient(so3.from_6d, columns, weights), expected, atol=1e-12)
