"""Banded matrices with a border: their factors against dense ones."""

import pytest
import torch
from torch import Tensor

from recon.solver.banded import Banded, Factor, add_differences


def random_matrix(time: int, reach: int, n: int, m: int) -> Banded:
    """JᵀJ of random residuals, each of as many moments as may couple, and of the border."""
    random = torch.Generator().manual_seed(0)
    found = Banded.zero(time, reach, n, m, torch.zeros(0, dtype=torch.float64))
    for first in range(-reach, time):
        inside = [t for t in range(first, first + reach + 1) if 0 <= t < time]
        parts = [torch.randn(n, n, generator=random, dtype=torch.float64) for _ in inside]
        edge = torch.randn(n, m, generator=random, dtype=torch.float64)
        found.corner.add_(edge.mT @ edge)
        for a, t in enumerate(inside):
            found.border[t] += parts[a].mT @ edge
            for b in range(a, len(inside)):
                found.inner[t, inside[b] - t] += parts[a].mT @ parts[b]
    return found


def dense(matrix: Banded) -> Tensor:
    time, reach, n = matrix.inner.shape[0], matrix.reach, matrix.inner.shape[2]
    m = len(matrix.corner)
    whole = matrix.inner.new_zeros(time * n + m, time * n + m)
    for t in range(time):
        for k in range(min(reach, time - 1 - t) + 1):
            here, there = slice(t * n, t * n + n), slice((t + k) * n, (t + k) * n + n)
            whole[here, there] = matrix.inner[t, k]
            whole[there, here] = matrix.inner[t, k].mT
    whole[: time * n, time * n :] = matrix.border.flatten(0, 1)
    whole[time * n :, : time * n] = matrix.border.flatten(0, 1).mT
    whole[time * n :, time * n :] = matrix.corner
    return whole


@pytest.mark.parametrize("reach", [0, 1, 2, 3])
@pytest.mark.parametrize("time", [1, 4, 6, 7])
@pytest.mark.parametrize("m", [0, 2])
def test_solutions_and_marginals_are_those_of_the_dense_system(
    reach: int, time: int, m: int
) -> None:
    n = 3
    matrix = random_matrix(time, reach, n, m)
    matrix.corner.add_(0.1 * torch.eye(m))
    whole, factor = dense(matrix), Factor(matrix)
    assert factor.definite
    right = torch.randn(time * n + m, generator=torch.Generator().manual_seed(1)).double()
    torch.testing.assert_close(factor.solve(right), torch.linalg.solve(whole, right))
    expected, found = torch.linalg.inv(whole), factor.inverse()
    torch.testing.assert_close(found.border, expected[time * n :, time * n :])
    for t in range(time):
        own = slice(t * n, t * n + n)
        covariance = found.within[t] + found.onto[t] @ found.border @ found.onto[t].mT
        torch.testing.assert_close(covariance, expected[own, own])
        torch.testing.assert_close(-found.onto[t] @ found.border, expected[own, time * n :])


def test_a_matrix_that_is_all_corner_is_solved_as_it_is() -> None:
    matrix = torch.tensor([[2.0, 0.5], [0.5, 1.0]])
    factor = Factor(Banded.dense(matrix))
    expected = torch.tensor([1.0, -2.0])
    torch.testing.assert_close(factor.solve(matrix @ expected), expected)
    torch.testing.assert_close(factor.inverse().border, torch.linalg.inv(matrix))


def test_down_is_the_transpose_of_up() -> None:
    """A minimiser in the variables u needs the exact adjoint, or its slopes are wrong."""
    matrix = random_matrix(5, 2, 3, 2)
    factor = Factor(Banded(matrix.inner.float(), matrix.border.float(), matrix.corner.float()))
    up = torch.stack([factor.solve_upper(row) for row in torch.eye(17)])
    down = torch.stack([factor.solve_lower(row) for row in torch.eye(17)])
    torch.testing.assert_close(up, down.mT, rtol=1e-5, atol=1e-6)


def test_damping_raises_the_diagonal() -> None:
    matrix = random_matrix(4, 2, 3, 1)
    factor, whole = Factor(matrix, 0.5), dense(matrix)
    right = torch.ones(13, dtype=torch.float64)
    raised = whole + 0.5 * torch.diag(whole.diagonal())
    torch.testing.assert_close(raised @ factor.solve(right), right)


@pytest.mark.parametrize("reach", [0, 2])
def test_what_is_not_positive_definite_is_told(reach: int) -> None:
    indefinite, nan = random_matrix(4, reach, 3, 1), random_matrix(4, reach, 3, 1)
    indefinite.border.mul_(50)
    nan.inner[2, 0] = torch.nan
    assert not Factor(indefinite).definite
    assert not Factor(nan).definite


def test_products_of_differences_are_their_hessian() -> None:
    """½ Σ w (r_(t+2) - 2 r_(t+1) + r_t)² of residuals that are linear in moments and border."""
    random = torch.Generator().manual_seed(2)
    time, rows, n, m = 6, 4, 3, 2
    jacobian = torch.randn(time, rows, n, generator=random).double()
    shaped = torch.randn(time, rows, m, generator=random).double()
    weight = torch.rand(time - 2, rows, generator=random).double()
    stencil = (1.0, -2.0, 1.0)
    coefficients = torch.zeros(time, 3, rows).double()
    add_differences(coefficients, stencil, weight)
    found = Banded.zero(time, 2, n, m, jacobian)
    found.add_products(coefficients, jacobian, shaped)

    def energy(x: Tensor) -> Tensor:
        values = (jacobian @ x[: time * n].view(time, n, 1))[..., 0] + shaped @ x[time * n :]
        return 0.5 * (weight * values.diff(n=2, dim=0).square()).sum()

    expected = torch.autograd.functional.hessian(energy, torch.zeros(time * n + m).double())
    torch.testing.assert_close(dense(found), expected)
