"""Blocks that share common variables: their system against a dense one, and a fit of products."""

from dataclasses import dataclass

import torch
from torch import Tensor

from recon.core.struct import TensorStruct
from recon.solver.arrow import Arrow, minimise_shared, solve_arrow


def test_the_solution_is_that_of_the_dense_system() -> None:
    generator = torch.Generator().manual_seed(0)
    blocks, n, m = 5, 3, 4
    jacobian = torch.randn(blocks, 9, n, generator=generator, dtype=torch.float64)
    common = torch.randn(blocks, 9, m, generator=generator, dtype=torch.float64)
    right = torch.randn(blocks, n, generator=generator, dtype=torch.float64)
    last = torch.randn(m, generator=generator, dtype=torch.float64)
    arrow = Arrow(
        jacobian.mT @ jacobian, jacobian.mT @ common, (common.mT @ common).sum(0), right, last
    )
    dense = torch.block_diag(*arrow.blocks, arrow.corner)
    dense[: blocks * n, blocks * n :] = arrow.border.flatten(0, 1)
    dense[blocks * n :, : blocks * n] = arrow.border.flatten(0, 1).mT
    expected = torch.linalg.solve(dense, torch.cat((right.flatten(), last)))
    found = solve_arrow(arrow)
    assert found is not None
    torch.testing.assert_close(torch.cat((found[0].flatten(), found[1])), expected)


def test_an_indefinite_system_has_no_solution() -> None:
    eye = torch.eye(2, dtype=torch.float64)
    zero = eye.new_zeros(1, 2)
    assert solve_arrow(Arrow(-eye[None], eye[None], eye, zero, zero[0])) is None
    assert solve_arrow(Arrow(eye[None], 2 * eye[None], eye, zero, zero[0])) is None


@dataclass(frozen=True)
class _Products(TensorStruct):
    """One number of every block, and common ones."""

    own: Tensor
    common: Tensor


@dataclass(frozen=True)
class _Fit:
    """½ Σ (exp(a_i) b_k - data_ik)² + ½ 1e-3 (|a|² + |b|²): curved, with a border."""

    data: Tensor

    def value(self, state: _Products) -> Tensor:
        away = state.own.exp() * state.common - self.data
        held = state.own.square().sum() + state.common.square().sum()
        return 0.5 * away.square().sum() + 5e-4 * held

    def equations(self, state: _Products) -> Arrow:
        scale = state.own.exp()
        away = scale * state.common - self.data
        by_own = (scale * state.common)[..., None]
        held = 1e-3 * torch.eye(len(state.common)).to(scale)
        return Arrow(
            by_own.mT @ by_own + 1e-3,
            (by_own * scale[..., None]).mT,
            scale.square().sum() * held / 1e-3 + held,
            -(by_own.mT @ away[..., None])[..., 0] - 1e-3 * state.own,
            -(scale * away).sum(0) - 1e-3 * state.common,
        )

    def moved(self, state: _Products, steps: Tensor, common: Tensor) -> _Products:
        return _Products(state.own + steps, state.common + common)


def test_the_minimum_is_reached_from_afar_and_never_by_rising() -> None:
    truth = torch.tensor([0.3, -0.5, 1.2, 0.0], dtype=torch.float64)
    pattern = torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64)
    fit = _Fit(truth.exp()[:, None] * pattern)
    start = _Products(truth.new_full((4, 1), -2.0), pattern.new_ones(3))
    values = [
        minimise_shared(fit, start, tolerance=1e-9, max_iterations=k).value for k in range(1, 12)
    ]
    assert values == sorted(values, reverse=True)
    found = minimise_shared(fit, start, tolerance=1e-9, max_iterations=100)
    assert found.converged
    variables = torch.cat((found.state.own[:, 0], found.state.common)).requires_grad_()
    state = _Products(variables[:4, None], variables[4:])
    (gradient,) = torch.autograd.grad(fit.value(state), variables)
    assert gradient.abs().max() < 1e-4
    product = found.state.own.exp() * found.state.common
    torch.testing.assert_close(product, fit.data, atol=5e-3, rtol=0)
