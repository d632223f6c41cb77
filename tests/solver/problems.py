"""Standard problems of minimisation, solved by our L-BFGS and by SciPy's L-BFGS-B.

Both start at the same point in double precision, remember 20 pairs, and stop once no component of
the gradient exceeds 1e-6. `solved` counts the evaluations until the objective was within 1e-8
(relative to max(1, |minimum|)) of the lower of the two minima, `total` those until the method
stopped. Sources: Moré, Garbow & Hillstrom (1981), Testing unconstrained optimization software;
Jamil & Yang (2013), A literature survey of benchmark functions.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from recon.solver.lbfgs import LBFGS, Solution

TOLERANCE_GRADIENT = 1e-6
SOLVED = 1e-8
HISTORY = 20


@dataclass(frozen=True)
class Problem:
    """A function from (batch, n) to weighted terms (batch, terms), and where to start."""

    name: str
    terms: Callable[[Tensor], Tensor]
    start: tuple[float, ...]
    box: tuple[float, float] | None = None
    """Bounds of every variable that SciPy is told; we are not."""


def rosenbrock(x: Tensor) -> Tensor:
    curved = 100 * (x[:, 1:] - x[:, :-1].square()).square().sum(-1)
    return torch.stack((curved, (1 - x[:, :-1]).square().sum(-1)), -1)


def beale(x: Tensor) -> Tensor:
    a, b = x.unbind(-1)
    cases = (1, 1.5), (2, 2.25), (3, 2.625)
    return torch.stack([(c - a * (1 - b**k)).square() for k, c in cases], -1)


def himmelblau(x: Tensor) -> Tensor:
    a, b = x.unbind(-1)
    return torch.stack(((a * a + b - 11).square(), (a + b * b - 7).square()), -1)


def booth(x: Tensor) -> Tensor:
    a, b = x.unbind(-1)
    return torch.stack(((a + 2 * b - 7).square(), (2 * a + b - 5).square()), -1)


def wood(x: Tensor) -> Tensor:
    a, b, c, d = x.unbind(-1)
    return torch.stack(
        (
            100 * (b - a * a).square() + (1 - a).square(),
            90 * (d - c * c).square() + (1 - c).square(),
            10 * (b + d - 2).square() + 0.1 * (b - d).square(),
        ),
        -1,
    )


def powell_singular(x: Tensor) -> Tensor:
    a, b, c, d = x.unflatten(-1, (-1, 4)).unbind(-1)
    terms = (a + 10 * b) ** 2, 5 * (c - d) ** 2, (b - 2 * c) ** 4, 10 * (a - d) ** 4
    return torch.stack([term.sum(-1) for term in terms], -1)


def quadratic(x: Tensor) -> Tensor:
    """Condition 1e4, minimum at (1, 1, ...)."""
    curvature = torch.logspace(-2, 2, x.shape[1], dtype=x.dtype, device=x.device)
    return (0.5 * curvature * (x - 1).square()).sum(-1, keepdim=True)


def trigonometric(x: Tensor) -> Tensor:
    n = x.shape[1]
    index = torch.arange(1, n + 1, dtype=x.dtype, device=x.device)
    cosines = x.cos().sum(-1, keepdim=True)
    return (n - cosines + index * (1 - x.cos()) - x.sin()).square()


def brown(x: Tensor) -> Tensor:
    """Brown's badly scaled function: minimum 0 at (1e6, 2e-6)."""
    a, b = x.unbind(-1)
    return torch.stack(((a - 1e6).square(), (b - 2e-6).square(), (a * b - 2).square()), -1)


def barrier(x: Tensor) -> Tensor:
    """A linear cost within the box (0, 1); nan outside it."""
    cost = torch.linspace(-3, 10, x.shape[1], dtype=x.dtype, device=x.device)
    return torch.stack(((cost * x).sum(-1), -0.1 * (x.log() + (1 - x).log()).sum(-1)), -1)


def styblinski_tang(x: Tensor) -> Tensor:
    return (0.5 * (x**4 - 16 * x.square() + 5 * x)).sum(-1, keepdim=True)


def geman(x: Tensor) -> Tensor:
    """Points pulled by a robust, non-convex data term and held together by smoothness."""
    data = torch.sin(0.7 * torch.arange(x.shape[1], dtype=x.dtype, device=x.device)).mul(2).round()
    squared = (x - data).square()
    smooth = 5 * (x[:, 2:] - 2 * x[:, 1:-1] + x[:, :-2]).square().sum(-1)
    return torch.stack(((squared / (1 + squared)).sum(-1), smooth), -1)


PROBLEMS = (
    Problem("rosenbrock 2", rosenbrock, (-1.2, 1.0)),
    Problem("rosenbrock 10", rosenbrock, (-1.2, 1.0) * 5),
    Problem("rosenbrock 100", rosenbrock, (-1.2, 1.0) * 50),
    Problem("beale", beale, (1.0, 1.0)),
    Problem("himmelblau", himmelblau, (0.0, 0.0)),
    Problem("booth", booth, (0.0, 0.0)),
    Problem("wood", wood, (-3.0, -1.0, -3.0, -1.0)),
    Problem("powell singular 40", powell_singular, (3.0, -1.0, 0.0, 1.0) * 10),
    Problem("quadratic 50", quadratic, (0.0,) * 50),
    Problem("trigonometric 10", trigonometric, (0.1,) * 10),
    Problem("brown badly scaled", brown, (1.0, 1.0)),
    Problem("log barrier 20", barrier, (0.5,) * 20, box=(1e-12, 1 - 1e-12)),
    Problem("styblinski-tang 10", styblinski_tang, (-1.0,) * 10),
    Problem("geman 60", geman, (0.0,) * 60),
)


def with_ours(problem: Problem) -> tuple[Solution, list[float]]:
    """Our solution and the value of every evaluation."""
    values: list[float] = []

    def objective(x: Tensor, _: Tensor) -> Tensor:
        terms = problem.terms(x)
        values.append(terms.sum().item())
        return terms

    solver = LBFGS(
        max_iterations=2000,
        history=HISTORY,
        tolerance_decrease=0.0,
        tolerance_gradient=TOLERANCE_GRADIENT,
    )
    return solver(objective, torch.tensor([problem.start], dtype=torch.float64)), values


def with_scipy(problem: Problem) -> tuple[np.ndarray, float, list[float]]:
    """SciPy's minimiser, its minimum, and the value of every evaluation."""
    from scipy.optimize import minimize

    values: list[float] = []

    def objective(array: np.ndarray) -> tuple[float, np.ndarray]:
        x = torch.from_numpy(array)[None].clone().requires_grad_()
        value = problem.terms(x).sum()
        (gradient,) = torch.autograd.grad(value, x)
        values.append(value.item())
        return values[-1], gradient[0].numpy()

    found = minimize(
        objective,
        np.array(problem.start),
        jac=True,
        method="L-BFGS-B",
        bounds=None if problem.box is None else [problem.box] * len(problem.start),
        options={
            "maxcor": HISTORY,
            "maxiter": 2000,
            "maxfun": 10_000,
            "ftol": 0.0,
            "gtol": TOLERANCE_GRADIENT,
        },
    )
    return found.x, float(found.fun), values


def solved_at(values: list[float], minimum: float) -> int | None:
    """The first evaluation that was as good as the minimum."""
    near = np.array(values) <= minimum + SOLVED * max(1.0, abs(minimum))
    return int(near.argmax()) + 1 if near.any() else None


@dataclass(frozen=True)
class Row:
    """Evaluations on one problem."""

    problem: str
    value: float
    value_scipy: float
    solved: int | None
    solved_scipy: int | None
    total: int
    total_scipy: int
    ended_by: str


def compare(problem: Problem) -> Row:
    ours, our_values = with_ours(problem)
    _, scipy_minimum, scipy_values = with_scipy(problem)
    minimum = min(ours.value.item(), scipy_minimum)
    return Row(
        problem=problem.name,
        value=ours.value.item(),
        value_scipy=scipy_minimum,
        solved=solved_at(our_values, minimum),
        solved_scipy=solved_at(scipy_values, minimum),
        total=len(our_values),
        total_scipy=len(scipy_values),
        ended_by=ours.termination[0].name,
    )
