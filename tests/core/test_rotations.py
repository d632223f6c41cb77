"""Laws of rotations: exact inverses, finite gradients at zero and pi, a heading without faults."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from recon.core import rotations as so3
from tests.conftest import GOLDEN

pytestmark = pytest.mark.numerics

vectors = arrays(np.float64, (4, 3), elements=st.floats(-1.8, 1.8)).map(torch.from_numpy)
fast = settings(derandomize=True, deadline=None, max_examples=60)


@given(vectors)
@fast
def test_exp_is_a_rotation(v):
    r = so3.exp(v)
    assert torch.allclose(r @ r.mT, torch.eye(3, dtype=v.dtype), atol=1e-12)
    assert torch.allclose(torch.linalg.det(r), torch.ones(4, dtype=v.dtype), atol=1e-12)


@given(vectors)
@fast
def test_log_inverts_exp(v):
    assert torch.allclose(so3.exp(so3.log(so3.exp(v))), so3.exp(v), atol=1e-9)
    short = v * 0.9 * math.pi / v.norm(dim=-1, keepdim=True).clamp(min=math.pi)
    assert torch.allclose(so3.log(so3.exp(short)), short, atol=1e-7)  # radians


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-4, 1e-3, 1.0, math.pi - 1e-7, math.pi])
def test_exp_gradient_is_exact_everywhere(size):
    v = (size * torch.tensor([[0.6, -0.64, 0.48]], dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(so3.exp, (v,), atol=1e-6)


def test_log_gradient_is_finite_at_identity_and_at_pi():
    for angle in (0.0, math.pi):
        r = so3.exp(torch.tensor([angle, 0.0, 0.0], dtype=torch.float64)).requires_grad_()
        so3.log(r).sum().backward()
        assert r.grad is not None
        assert r.grad.isfinite().all()


@given(vectors)
@fast
def test_six_numbers_round_trip(v):
    r = so3.exp(v)
    assert torch.allclose(so3.from_6d(so3.to_6d(r)), r, atol=1e-12)


def test_interpolation_meets_its_ends_and_halves_the_angle():
    a, b = so3.exp(torch.randn(2, 5, 3, dtype=torch.float64))
    one = torch.ones(5, dtype=torch.float64)
    assert torch.allclose(so3.interpolate(a, b, 0 * one), a, atol=1e-9)
    assert torch.allclose(so3.interpolate(a, b, one), b, atol=1e-9)
    half = so3.interpolate(a, b, 0.5 * one)
    assert torch.allclose(so3.geodesic_angle(a, half), so3.geodesic_angle(half, b), atol=1e-7)


def test_heading_equals_the_exact_golden_values():
    with np.load(GOLDEN / "canonical.npz", allow_pickle=False) as file:
        names = file.files
        root = torch.from_numpy(file["world_root_orient"].astype(np.float64)).reshape(-1, 3, 3)
        exact = torch.from_numpy(file["exact_A"].astype(np.float64))
    assert "exact_A" in names
    assert torch.allclose(so3.undo_heading(root), exact, atol=1e-6)


@given(st.floats(-math.pi, math.pi), vectors)
@fast
def test_heading_undoes_a_turn_about_the_vertical(angle, v):
    turn = so3.about_z(torch.tensor(angle, dtype=torch.float64))
    upright = so3.exp(v * 0.3) @ so3.exp(torch.tensor([math.pi / 2, 0, 0], dtype=torch.float64))
    there = so3.undo_heading(turn @ upright) @ turn
    assert torch.allclose(there @ upright, so3.undo_heading(upright) @ upright, atol=1e-9)


def test_heading_of_a_body_lying_on_its_side_is_the_identity():
    side = so3.exp(torch.tensor([0.0, math.pi / 2, 0.0], dtype=torch.float64)).requires_grad_()
    a = so3.undo_heading(side)
    a.sum().backward()
    assert torch.allclose(a, torch.eye(3, dtype=torch.float64))
    assert side.grad is not None
    assert side.grad.isfinite().all()


def test_the_nearest_rotation_of_a_reflection_is_a_rotation():
    mirror = torch.diag(torch.tensor([1.0, 0.9, -0.8], dtype=torch.float64))
    assert torch.allclose(so3.nearest_rotation(mirror), torch.eye(3, dtype=torch.float64))
    assert so3.nearest_rotation(torch.zeros(2, 3, 3)).isfinite().all()


def test_a_quaternion_turns_as_its_rotation_does():
    rotation = so3.exp(torch.randn(50, 3, dtype=torch.float64))
    q, v = so3.to_quaternion(rotation), torch.randn(50, 3, dtype=torch.float64)
    twice = 2 * torch.linalg.cross(q[:, :3], v)
    turned = v + q[:, 3:] * twice + torch.linalg.cross(q[:, :3], twice)
    assert torch.allclose(turned, (rotation @ v[..., None])[..., 0], atol=1e-12)


def test_the_smallest_rotation_between_directions_takes_one_to_the_other():
    random = torch.Generator().manual_seed(0)
    start, end = torch.randn(2, 50, 3, generator=random).double()
    turn = so3.rotation_between(start, 3.0 * end)
    unit = torch.nn.functional.normalize
    torch.testing.assert_close((turn @ unit(start, dim=-1)[..., None])[..., 0], unit(end, dim=-1))
    angle = torch.acos((unit(start, dim=-1) * unit(end, dim=-1)).sum(-1))
    torch.testing.assert_close(so3.log(turn).norm(dim=-1), angle)
    same = so3.rotation_between(torch.cat((start, start)), torch.cat((start, 0 * start)))
    torch.testing.assert_close(same, torch.eye(3).double().expand(100, 3, 3))
