"""Solvers times problems whose minima are known: where they end, why, and that nothing rises."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise
from recon.solver.lbfgs import LBFGS
from recon.solver.solution import Solution, Termination
from tests.solver import problems


@dataclass(frozen=True)
class Squares(Problem[Tensor]):
    """½ |r(x)|² of every row of x, with a dense Hessian or one of numbers in a row."""

    residuals: Callable[[Tensor, Tensor], Tensor]
    """r of rows of x, and their numbers."""
    reach: int | None = None
    """None where the Hessian is all corner."""
    border: int = 0

    def value(self, x: Tensor, rows: Tensor) -> Tensor:
        return 0.5 * self.residuals(x[rows], rows).square()

    def model(self, x: Tensor, rows: Tensor) -> Quadratic:
        slopes = torch.func.jacrev(lambda one, row: self.residuals(one[None], row[None])[0])
        jacobian = torch.func.vmap(slopes)(x[rows], rows)
        away = self.residuals(x[rows], rows)
        gradient = (away[:, None] @ jacobian)[:, 0]
        return Quadratic(self.value(x, rows), gradient, [self._banded(j.mT @ j) for j in jacobian])

    def moved(self, x: Tensor, rows: Tensor, steps: Tensor) -> Tensor:
        return x.index_add(0, rows, steps)

    def _banded(self, whole: Tensor) -> Banded:
        if self.reach is None:
            return Banded.dense(whole)
        time = len(whole) - self.border
        found = Banded.zero(time, self.reach, 1, self.border, whole)
        for k in range(self.reach + 1):
            found.inner[: time - k, k, 0, 0] = whole.diagonal(k)[: time - k]
        found.border[:, 0] = whole[:time, time:]
        found.corner.copy_(whole[time:, time:])
        return found


def rosenbrock(x: Tensor, rows: Tensor) -> Tensor:
    """Minimum 0 at ones."""
    del rows
    return 2**0.5 * torch.cat((10 * (x[:, 1:] - x[:, :-1] ** 2), 1 - x[:, :-1]), -1)


def exponentials(x: Tensor, rows: Tensor) -> Tensor:
    """exp(a_i) b_k - d_ik of 12 numbers a in a row, bent a little, and a border b of 3.

    The minimum is 0 where the border is (1, -2, ½) and all of a are zero.
    """
    del rows
    own, common = x[:, :12], x[:, 12:]
    pattern = torch.tensor([1.0, -2.0, 0.5], dtype=x.dtype)
    away = own.exp()[..., None] * common[:, None] - pattern
    return torch.cat((away.flatten(1), own.diff(n=2), 0.1 * own), -1)


PROBLEMS = {
    "rosenbrock": (Squares(rosenbrock), torch.tensor([[-1.2, 1.0] * 5]), torch.ones(10)),
    "bordered band": (
        Squares(exponentials, reach=2, border=3),
        torch.cat((torch.full((1, 12), -1.5), torch.ones(1, 3)), 1),
        torch.tensor([0.0] * 12 + [1.0, -2.0, 0.5]),
    ),
}
Solver = Callable[[Squares, Tensor], tuple[Tensor, Solution]]


def with_gauss_newton(problem: Squares, start: Tensor) -> tuple[Tensor, Solution]:
    return minimise(problem, start, GaussNewton(100, 1e-12, scale=1.0), len(start))


def with_lbfgs(problem: Squares, start: Tensor) -> tuple[Tensor, Solution]:
    def objective(x: Tensor, active: Tensor) -> Tensor:
        return 0.5 * problem.residuals(x, active).square()

    solution = LBFGS(1000, tolerance_decrease=1e-14)(objective, start)
    return solution.x, solution


@pytest.mark.parametrize("solver", [with_gauss_newton, with_lbfgs])
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_minimum_is_reached_and_never_by_rising(solver: Solver, name: str) -> None:
    problem, start, minimum = PROBLEMS[name]
    x, solution = solver(problem, start.double())
    torch.testing.assert_close(x[0], minimum.double(), rtol=0, atol=1e-4)
    assert solution.termination[0] in (Termination.CONVERGED, Termination.GRADIENT)
    trace = solution.trace[0].sum(-1)
    assert len(trace) == int(solution.iterations[0]) + 1
    assert (trace.diff() <= 0).all()
    assert float(solution.value[0]) == float(trace[-1])


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 999),
    time=st.integers(1, 8),
    reach=st.integers(0, 3),
    border=st.integers(0, 3),
)
def test_least_squares_in_a_bordered_band_take_one_undamped_step(
    seed: int, time: int, reach: int, border: int
) -> None:
    """The step is that of the dense system, whatever the shape of the matrix."""
    random = torch.Generator().manual_seed(seed)
    n = time + border
    jacobian = torch.randn(3 * n, n, generator=random, dtype=torch.float64)
    for row in range(3 * n):
        first = row % time
        jacobian[row, :first] = jacobian[row, first + reach + 1 : time] = 0.0
    jacobian = torch.cat((jacobian, 0.3 * torch.eye(n, dtype=torch.float64)))
    right = torch.randn(len(jacobian), generator=random, dtype=torch.float64)
    problem = Squares(lambda x, _: x @ jacobian.mT - right, min(reach, time), border)
    x, solution = minimise(problem, torch.zeros(1, n).double(), GaussNewton(1, damping=0.0))
    expected = torch.linalg.lstsq(jacobian, right[:, None]).solution[:, 0]
    torch.testing.assert_close(x[0], expected)
    assert solution.iterations.tolist() == [1]


def test_elements_of_a_batch_end_for_themselves() -> None:
    """One at its minimum, one on its way, one that is not finite, one without a way down."""

    def residuals(x: Tensor, rows: Tensor) -> Tensor:
        pulled = torch.tensor([0.0, 0.0, torch.nan, 0.0]).double()[rows, None]
        return rosenbrock(x, rows) + pulled

    problem = Misled(residuals)
    start = torch.tensor([[1.0, 1.0], [-1.2, 1.0], [0.0, 0.0], [0.5, 0.5]]).double()
    x, solution = minimise(problem, start, GaussNewton(100, 1e-12), 4)
    assert solution.termination == (
        Termination.CONVERGED,
        Termination.CONVERGED,
        Termination.NONFINITE,
        Termination.LINE_SEARCH,
    )
    torch.testing.assert_close(x[1], torch.ones(2).double(), rtol=0, atol=1e-5)
    torch.testing.assert_close(x[2:], start[2:], rtol=0, atol=0)
    alone, single = minimise(Squares(rosenbrock), start[1:2], GaussNewton(100, 1e-12))
    torch.testing.assert_close(x[1:2], alone, rtol=0, atol=0)
    assert int(solution.iterations[1]) == int(single.iterations[0])


class Misled(Squares):
    """The gradient of problem 3 has the wrong sign."""

    def model(self, x: Tensor, rows: Tensor) -> Quadratic:
        found = super().model(x, rows)
        sign = torch.where(rows == 3, -1.0, 1.0)[:, None]
        return Quadratic(found.value, found.gradient * sign, found.hessian)


@pytest.mark.parametrize("most", [0, 3])
def test_the_limit_of_iterations_is_said(most: int) -> None:
    start = torch.tensor([[-1.2, 1.0]]).double()
    x, solution = minimise(Squares(rosenbrock), start, GaussNewton(most))
    assert solution.termination == (Termination.ITERATION_LIMIT,)
    assert solution.iterations.tolist() == [most]
    expected = problems.rosenbrock(x).sum()
    torch.testing.assert_close(solution.value[0], expected)


def test_a_callback_stops_all_where_they_are() -> None:
    start = torch.tensor([[-1.2, 1.0]] * 2).double()
    told: list[list[int]] = []

    def watch(progress) -> bool:
        told.append(progress.iterations.tolist())
        return len(told) == 2

    _, solution = minimise(Squares(rosenbrock), start, GaussNewton(), 2, watch)
    assert told == [[1, 1], [2, 2]]
    assert solution.termination == (Termination.STOPPED,) * 2


class Reweighted(Problem[Tensor]):
    """The mean of numbers under Cauchy's weights: no objective, a model from step to step."""

    numbers = torch.tensor([0.0, 0.1, -0.1, 50.0]).double()

    def model(self, x: Tensor, rows: Tensor) -> Quadratic:
        away = x - self.numbers
        weight = 1 / (1 + away.square())
        hessian = Banded.dense(weight.sum()[None, None])
        return Quadratic(self.value(x, rows), (weight * away).sum()[None, None], [hessian])

    def moved(self, x: Tensor, rows: Tensor, steps: Tensor) -> Tensor:
        del rows
        return x + steps[0]


def test_without_an_objective_every_step_is_taken_until_little_is_promised() -> None:
    found, solution = minimise(Reweighted(), torch.ones(1).double(), GaussNewton(50, 1e-9, 1.0))
    assert abs(float(found)) < 0.02
    assert solution.termination == (Termination.CONVERGED,)
    _, fixed = minimise(Reweighted(), torch.ones(1).double(), GaussNewton(5))
    assert fixed.termination == (Termination.ITERATION_LIMIT,)
    assert fixed.iterations.tolist() == [5]


class Cautious(Squares):
    """A Hessian twice too large: steps go half the way, and gains shrink to a quarter."""

    def model(self, x: Tensor, rows: Tensor) -> Quadratic:
        found = super().model(x, rows)
        return Quadratic(found.value, found.gradient, [Banded.dense(2 * torch.eye(1).double())])


def test_no_step_is_taken_that_is_expected_to_bring_too_little() -> None:
    """Gains are 37.5, 9.4, 2.3, 0.59, 0.15 and then 0.04; the last one is foreseen."""
    options = GaussNewton(50, 0.1, scale=1.0, damping=0.0)
    _, solution = minimise(Cautious(lambda x, _: x), torch.full((1, 1), 10.0).double(), options)
    gains = -solution.trace[0, :, 0].diff()
    assert len(gains) == 5
    assert gains[-1] > 0.1 > gains[-1] / 4


def test_a_matrix_that_is_not_positive_definite_is_damped() -> None:
    """Damping scales the diagonal, so a matrix with too strong a border needs a lot of it."""

    class Indefinite(Squares):
        def model(self, x: Tensor, rows: Tensor) -> Quadratic:
            found = super().model(x, rows)
            whole = torch.tensor([[1.0, 3.0], [3.0, 1.0]]).double()
            return Quadratic(found.value, found.gradient, [Banded.dense(whole)] * len(rows))

    _, solution = minimise(
        Indefinite(lambda x, _: x), torch.ones(1, 2).double(), GaussNewton(100, 1e-12)
    )
    assert float(solution.value[0]) < 1e-5


def test_steps_that_are_taken_in_another_order_stay_with_their_problems() -> None:
    """The first problem needs more damping than the second, whose step is taken before it."""

    class Ordered(Squares):
        def moved(self, x: Tensor, rows: Tensor, steps: Tensor) -> Tensor:
            assert rows.tolist() == sorted(rows.tolist())
            return super().moved(x, rows, steps)

    start = torch.tensor([[-1.2, 1.0], [0.9, 0.85]]).double()
    x, _ = minimise(Ordered(rosenbrock), start, GaussNewton(100, 1e-12, damping=0.0), 2)
    torch.testing.assert_close(x, torch.ones(2, 2).double(), rtol=0, atol=1e-5)
