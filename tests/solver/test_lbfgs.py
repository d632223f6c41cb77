"""Laws of the batched L-BFGS: known minima, independent elements, honest endings."""

from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from recon.solver.lbfgs import LBFGS, Progress, Solution, Termination
from tests.solver import problems

pytestmark = pytest.mark.numerics


PROBLEMS = {problem.name: problem for problem in problems.PROBLEMS}
NINE = LBFGS(max_iterations=500, tolerance_decrease=0.0, tolerance_gradient=1e-9)


def rosenbrock(x: Tensor, _: Tensor | None = None) -> Tensor:
    return problems.rosenbrock(x)


def starts(batch: int, n: int = 6, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 1 + 0.8 * torch.randn(batch, n, dtype=torch.float64, generator=generator)


class Mixed:
    """A different problem for every element: three functions, each shifted by its element."""

    def __init__(self, batch: int) -> None:
        self.kinds = torch.arange(batch) % 3
        self.shifts = 0.1 * torch.arange(batch, dtype=torch.float64)[:, None]

    def __call__(self, x: Tensor, element: Tensor) -> Tensor:
        moved = x - self.shifts[element]
        kinds = self.kinds[element][:, None]
        bowl = torch.stack(((moved**2).sum(-1), (moved**4).sum(-1)), -1)
        rippled = torch.stack(((moved**2).sum(-1), 1 - (2 * moved).sin().prod(-1)), -1)
        return torch.where(kinds == 0, rosenbrock(moved), torch.where(kinds == 1, bowl, rippled))


# --- known minima --------------------------------------------------------------------------


@cache
def compared(name: str):
    return problems.compare(PROBLEMS[name])


@pytest.mark.parametrize("name", PROBLEMS)
def test_same_minimum_as_scipy(name: str) -> None:
    row = compared(name)
    assert row.value == pytest.approx(row.value_scipy, rel=1e-8, abs=1e-8)
    assert row.ended_by == Termination.GRADIENT.name


def test_no_more_than_half_again_the_evaluations_of_scipy() -> None:
    rows = [compared(name) for name in PROBLEMS]
    assert sum(r.total for r in rows) <= 1.5 * sum(r.total_scipy for r in rows)


@settings(derandomize=True, deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 8))
def test_quadratic_bowl_is_solved_exactly(seed: int, n: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(n, n, dtype=torch.float64, generator=generator)
    hessian = root @ root.T + 0.1 * torch.eye(n, dtype=torch.float64)
    target = torch.randn(n, dtype=torch.float64, generator=generator)

    def objective(x: Tensor, _: Tensor) -> Tensor:
        return (0.5 * ((x - target) @ hessian * (x - target)).sum(-1))[:, None]

    solution = NINE(objective, torch.zeros(1, n, dtype=torch.float64))
    # |x - x*| <= |g| / 0.1, and |g| <= 1e-9 n
    torch.testing.assert_close(solution.x[0], target, rtol=0, atol=1e-7)


def test_steep_and_flat_starts() -> None:
    """The first step is cautious and grows: gradients of 1e-4 and of 1e8 both work."""
    scales = torch.tensor([1e-4, 1.0, 1e8], dtype=torch.float64)

    def objective(x: Tensor, element: Tensor) -> Tensor:
        return scales[element, None] * (x - 3).square().sum(-1, keepdim=True)

    solver = LBFGS(tolerance_gradient=1e-9)
    solution = solver(objective, torch.zeros(3, 4, dtype=torch.float64))
    torch.testing.assert_close(solution.x, torch.full_like(solution.x, 3.0), rtol=0, atol=1e-4)
    assert solution.evaluations.max() <= 20


# --- independence --------------------------------------------------------------------------


def test_a_batch_equals_single_solves() -> None:
    batch = 12
    objective, x = Mixed(batch), starts(batch)
    together = NINE(objective, x)
    for i in range(batch):
        alone = NINE(lambda x, _, i=i: objective(x, torch.tensor([i])), x[i : i + 1])
        torch.testing.assert_close(together.x[i], alone.x[0], rtol=0, atol=1e-8)
        torch.testing.assert_close(together.value[i], alone.value[0], rtol=0, atol=1e-8)
        assert together.termination[i] == alone.termination[0]


@settings(derandomize=True, deadline=None, max_examples=10)
@given(order=st.permutations(range(6)), seed=st.integers(0, 1000))
def test_permuting_the_batch_permutes_the_result(order: list[int], seed: int) -> None:
    objective, x, index = Mixed(6), starts(6, n=4, seed=seed), torch.tensor(order)
    plain = NINE(objective, x)
    mixed = NINE(lambda x, element: objective(x, index[element]), x[index])
    torch.testing.assert_close(mixed.x, plain.x[index], rtol=0, atol=1e-8)
    torch.testing.assert_close(mixed.value, plain.value[index], rtol=0, atol=1e-8)
    assert mixed.termination == tuple(plain.termination[i] for i in order)


def test_an_element_that_turns_nan_fails_alone() -> None:
    """Element 1 is nan from the start, element 3 from the seventh evaluation on."""
    x = starts(5)
    clean = NINE(rosenbrock, x)
    seen: list[int] = []

    def objective(x: Tensor, element: Tensor) -> Tensor:
        seen.append(len(element))
        broken = (element == 1) | ((element == 3) & (len(seen) > 6))
        return rosenbrock(x) * torch.where(broken, torch.nan, 1.0)[:, None]

    solution = NINE(objective, x)
    for i in (0, 2, 4):
        torch.testing.assert_close(solution.x[i], clean.x[i], rtol=0, atol=1e-8)
        assert solution.termination[i] == clean.termination[i]
    assert solution.termination[1] == solution.termination[3] == Termination.NONFINITE
    torch.testing.assert_close(solution.x[1], x[1], rtol=0, atol=0)
    assert solution.iterations[1] == 0
    assert solution.iterations[3] > 0
    assert solution.value[3] < rosenbrock(x).sum(-1)[3]
    assert solution.value[3].item() == pytest.approx(rosenbrock(solution.x)[3].sum().item())


def test_the_objective_sees_only_active_rows() -> None:
    """Every element is evaluated until it ends and never afterwards."""
    batch = 6
    calls: list[list[int]] = []
    x = starts(batch)

    def objective(x: Tensor, element: Tensor) -> Tensor:
        assert len(x) == len(element)
        calls.append(element.tolist())
        return rosenbrock(x)

    x[2] = 1.0  # solved before it begins
    solution = NINE(objective, x)
    for i in range(batch):
        took_part = [i in call for call in calls]
        count = int(solution.evaluations[i])
        assert took_part == [True] * count + [False] * (len(calls) - count)
    assert solution.evaluations[2] == 1
    assert len(set(solution.evaluations.tolist())) > 1
    assert all(call == sorted(call) for call in calls)


# --- endings -------------------------------------------------------------------------------


def test_ends_on_a_small_gradient() -> None:
    solution = LBFGS(tolerance_gradient=1e-3, tolerance_decrease=0.0)(rosenbrock, starts(3))
    assert set(solution.termination) == {Termination.GRADIENT}
    x = solution.x.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(rosenbrock(x).sum(), x)
    assert gradient.abs().max() <= 1e-3


def test_ends_on_small_decrease() -> None:
    """One lucky small decrease is not enough: the last `patience` steps were all small."""
    solver = LBFGS(tolerance_decrease=1e-3, patience=4, tolerance_gradient=0.0)
    solution = solver(lambda x, _: 1 + rosenbrock(x), starts(3))
    assert set(solution.termination) == {Termination.CONVERGED}
    for i in range(3):
        value = solution.trace[i, : int(solution.iterations[i]) + 1].sum(-1)
        small = -value.diff() <= 1e-3 * value[:-1]
        assert small[-4:].all()
        assert not small.unfold(0, 4, 1).all(-1)[:-1].any()


def test_objectives_that_end_at_zero_end_by_tolerance_too() -> None:
    """Log-densities added to data may sum to nothing, which no decrease is small beside."""
    settings = {"tolerance_decrease": 1e-3, "tolerance_gradient": 0.0}

    def objective(x: torch.Tensor, _: torch.Tensor) -> torch.Tensor:
        return 100 * rosenbrock(x)

    alone = LBFGS(**settings)(objective, starts(3))
    scaled = LBFGS(**settings, scale=100.0)(objective, starts(3))
    assert set(scaled.termination) == {Termination.CONVERGED}
    assert (scaled.iterations <= alone.iterations).all()
    assert (scaled.iterations < alone.iterations).any()


@pytest.mark.parametrize("limit", [0, 1, 5])
def test_ends_at_the_iteration_limit(limit: int) -> None:
    solution = LBFGS(max_iterations=limit)(rosenbrock, starts(3))
    assert solution.termination == (Termination.ITERATION_LIMIT,) * 3
    assert solution.iterations.tolist() == [limit] * 3
    assert solution.trace.shape == (3, limit + 1, 2)


@pytest.mark.parametrize("limit", [1, 2, 7])
def test_ends_at_the_evaluation_limit(limit: int) -> None:
    solution = LBFGS(max_evaluations=limit)(rosenbrock, starts(3))
    assert solution.termination == (Termination.EVALUATION_LIMIT,) * 3
    assert solution.evaluations.tolist() == [limit] * 3
    assert (solution.value <= rosenbrock(starts(3)).sum(-1)).all()


def test_ends_where_the_gradient_is_wrong() -> None:
    """A gradient that points uphill leaves nothing to find along the search direction."""

    def objective(x: Tensor, _: Tensor) -> Tensor:
        honest = rosenbrock(x)
        return 2 * honest.detach() - honest

    solution = LBFGS()(objective, starts(2))
    assert solution.termination == (Termination.LINE_SEARCH,) * 2
    torch.testing.assert_close(solution.x, starts(2), rtol=0, atol=0)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
def test_a_trial_that_is_not_finite_was_too_long(bad: float) -> None:
    """100 x - log x with a wall at x <= 0, which full quasi-Newton steps run into."""
    walls: list[bool] = []

    def objective(x: Tensor, _: Tensor) -> Tensor:
        inside = torch.where(x > 0, x, 1.0)
        walls.append(bool((x <= 0).any()))
        value = (100 * inside - inside.log()).sum(-1, keepdim=True)
        return torch.where((x > 0).all(-1, keepdim=True), value, bad + 0 * x.sum(-1, keepdim=True))

    start = torch.full((1, 3), 0.5, dtype=torch.float64)
    solution = LBFGS(tolerance_decrease=0.0, tolerance_gradient=1e-4)(objective, start)
    assert any(walls)
    assert solution.termination == (Termination.GRADIENT,)
    torch.testing.assert_close(solution.x, torch.full_like(start, 0.01), rtol=0, atol=1e-7)


def test_a_gradient_that_is_not_finite_is_refused() -> None:
    """The square root is finite at 0 but its slope is not: never accept such a point."""

    def objective(x: Tensor, _: Tensor) -> Tensor:
        return (x.clamp(min=0).sqrt() + (x - 1).square()).sum(-1, keepdim=True)

    solution = LBFGS()(objective, torch.full((1, 1), 0.01, dtype=torch.float64))
    assert solution.x.isfinite().all()
    assert solution.value <= objective(torch.full((1, 1), 0.01), torch.tensor([0])).item()


def test_exceptions_propagate() -> None:
    class MyError(Exception):
        pass

    def objective(x: Tensor, element: Tensor) -> Tensor:
        raise MyError

    with pytest.raises(MyError):
        LBFGS()(objective, starts(1))


def test_mistakes_are_named() -> None:
    with pytest.raises(ValueError, match="one row per element"):
        LBFGS()(lambda x, _: rosenbrock(x).sum(-1), starts(2))
    with pytest.raises(ValueError, match="without detaching"):
        LBFGS()(lambda x, _: rosenbrock(x.detach()), starts(2))
    for c1, c2 in ((0.9, 0.1), (0.0, 0.9), (0.1, 1.0), (0.5, 0.5)):
        with pytest.raises(ValueError, match="c1 < c2"):
            LBFGS(c1=c1, c2=c2)
    with pytest.raises(ValueError, match="history must be at least 1"):
        LBFGS(history=0)


# --- the record ----------------------------------------------------------------------------


def check_record(solution: Solution, terms_at_start: Tensor) -> None:
    value = solution.trace.sum(-1)
    torch.testing.assert_close(solution.trace[:, 0], terms_at_start.double())
    torch.testing.assert_close(value[:, -1], solution.value)
    assert (value.diff(dim=1) <= 0).all()
    for i, end in enumerate(solution.iterations.tolist()):
        assert (solution.trace[i, end:] == solution.trace[i, end]).all()
    assert solution.trace.shape[1] == int(solution.iterations.max()) + 1


@settings(derandomize=True, deadline=None, max_examples=15)
@given(
    seed=st.integers(0, 1000),
    batch=st.integers(1, 5),
    history=st.integers(1, 6),
    max_line_search=st.integers(1, 4),
)
def test_iterates_never_climb(seed: int, batch: int, history: int, max_line_search: int) -> None:
    x = starts(batch, seed=seed)
    solver = LBFGS(max_iterations=40, history=history, max_line_search=max_line_search)
    solution = solver(Mixed(batch), x)
    check_record(solution, Mixed(batch)(x, torch.arange(batch)))
    assert (solution.evaluations > solution.iterations).all()


def test_the_start_is_untouched_and_deterministic() -> None:
    x = starts(4)
    first = NINE(rosenbrock, x)
    assert (x == starts(4)).all()
    assert not first.x.requires_grad
    again = NINE(rosenbrock, x.requires_grad_())
    assert (first.x == again.x).all()


def test_single_precision() -> None:
    """Minimum 3, not 0: the values end at float32's resolution and the solver says so."""
    x = starts(3, n=3).float()  # in three dimensions there is only one minimum
    solution = LBFGS(max_iterations=500)(lambda x, _: 1.5 + rosenbrock(x), x)
    assert solution.x.dtype == torch.float32
    assert solution.trace.dtype == solution.value.dtype == torch.float64
    assert set(solution.termination) <= {Termination.CONVERGED, Termination.GRADIENT}
    assert solution.value.numpy() == pytest.approx(3.0, rel=2e-6)


def test_no_elements_and_no_variables() -> None:
    empty = LBFGS()(rosenbrock, torch.zeros(0, 4))
    assert empty.x.shape == (0, 4)
    assert empty.termination == ()
    constant = LBFGS()(lambda x, _: torch.ones(len(x), 2), torch.zeros(3, 0))
    assert constant.termination == (Termination.GRADIENT,) * 3
    assert constant.value.tolist() == [2.0] * 3


def test_the_callback_sees_every_iterate() -> None:
    seen: list[Progress] = []
    solution = NINE(rosenbrock, starts(3), seen.append)
    for i in range(3):
        values: list[float] = []
        for progress in seen:
            if progress.iterations[i] > len(values):
                values.append(progress.value[i])
        end = int(solution.iterations[i])
        np.testing.assert_allclose(values, solution.trace[i, 1 : end + 1].sum(-1), rtol=1e-12)
    assert len(seen[-1].active) == 0
    assert seen[-1].evaluations == int(solution.evaluations.max())


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_callback_that_returns_true_ends_all_where_they_are(steps: int) -> None:
    """Elements in the middle of a line search keep the best of it, and their record says so."""
    x = starts(5)

    def enough(progress: Progress) -> bool:
        return int(progress.iterations.max()) >= steps

    solution = NINE(Mixed(5), x, enough)
    check_record(solution, Mixed(5)(x, torch.arange(5)))
    assert Termination.STOPPED in solution.termination
    assert int(solution.iterations.max()) <= steps + 1
    reached = Mixed(5)(solution.x, torch.arange(5)).sum(-1)
    torch.testing.assert_close(reached, solution.value)
    others = NINE(Mixed(5), x, lambda _: None)
    assert Termination.STOPPED not in others.termination
