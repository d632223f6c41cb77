"""Damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963) for a batch of problems.

About a state x, an objective is E + gᵀ s + ½ sᵀ H s, with s the step, g the gradient and H ≈ JᵀJ
the Gauss-Newton Hessian, J the Jacobian of the residuals. Every iteration takes

    s = -(H + d diag H)⁻¹ g

with the damping d, which is raised until the objective falls and lowered after that. States are
the problem's own: it says what they are after a step, so that rotations may be among them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.solver.banded import Banded, Factor
from recon.solver.solution import Progress, Solution, Termination

X = TypeVar("X")
"""The state of all problems of a batch."""

_RAISE, _LOWER = 10.0, 0.1
_FASTEST = 0.1  # least assumed ratio of a step's gain to the gain of the step before
_MIN_DAMPING = 1e-6
"""Damping is not lowered beyond this, so that it is raised quickly when a step is refused."""


@dataclass(frozen=True)
class Quadratic:
    """Second-order models of several objectives at a state: value, gradient, Hessian."""

    value: Float[Tensor, "rows terms"]
    """Weighted terms, whose sum is the objective; no columns where there is none."""
    gradient: Float[Tensor, "rows n"]
    """Gradient g, its variables ordered as in a vector beside a `Banded` matrix."""
    hessian: Sequence[Banded]
    """Hessian H of every problem, n rows and columns; the solver does not change it."""


class Problem(ABC, Generic[X]):
    """A batch of independent problems; the arguments `rows` are indices of some of them."""

    @abstractmethod
    def model(self, x: X, rows: Int[Tensor, " rows"]) -> Quadratic:
        """Return quadratic models of the objectives of the problems `rows` at state x."""

    @abstractmethod
    def moved(self, x: X, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]) -> X:
        """Return the state after the problems `rows` take `steps`, shortened to be valid."""

    def value(self, x: X, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows terms"]:
        """Return the objective's terms of the problems `rows` at state x.

        The default, no columns, says that there is no objective, as where kernels shrink or
        correspondences are found anew from step to step. Every step is then taken, and counts for
        as much as the model promises.
        """
        del x
        return torch.zeros(len(rows), 0)


@dataclass(frozen=True)
class GaussNewton:
    """Limits and tolerances of `minimise`."""

    max_iterations: int = 50
    tolerance: float = 1e-4
    """A problem has converged when the next step is expected to lower its objective by no more
    than this share. Its gain is extrapolated from the last two, to a tenth of the last or more."""
    scale: float = 0.0
    """Value of the objective below which its decreases are taken relative to this value."""
    damping: float = 1e-3
    """Share of the Hessian's diagonal that it is raised by at first."""
    max_damping: float = 1e6
    """Damping beyond which no lower point is sought any more."""


def minimise(
    problem: Problem[X],
    x: X,
    options: GaussNewton,
    count: int = 1,
    callback: Callable[[Progress], bool | None] | None = None,
) -> tuple[X, Solution]:
    """Minimise every problem of a batch; no objective ever rises.

    Args:
        problem: what is minimised.
        x: where to begin.
        options: limits and tolerances, the same for all.
        count: how many problems there are.
        callback: told of progress after every iteration; True ends all problems where they are.

    Returns:
        The state, and how each problem ended, a solution whose `x` has no columns.
    """
    runs = [_ProblemRun(options.damping) for _ in range(count)]
    active = torch.arange(count)
    for _ in range(options.max_iterations):
        model = problem.model(x, active)
        here = [runs[row] for row in active.tolist()]
        for run, terms in zip(here, model.value.double().cpu(), strict=True):
            run.begin_iteration(terms)
        x = _step_all(problem, x, active, model, here, options)
        active = active[[run.end is None for run in here]]
        if len(active) == 0:
            break
        if callback is not None and callback(_progress_of_runs(runs, active)) is True:
            for row in active.tolist():
                runs[row].end = Termination.STOPPED
            break
    if options.max_iterations == 0:
        for run, terms in zip(runs, problem.value(x, active).double().cpu(), strict=True):
            run.begin_iteration(terms)
    return x, _solution_of_runs(runs)


def _step_all(
    problem: Problem[X],
    x: X,
    active: Int[Tensor, " active"],
    model: Quadratic,
    runs: Sequence["_ProblemRun"],
    options: GaussNewton,
) -> X:
    """Take one step of every active problem, raising the damping until it is accepted."""
    steps, taken = torch.zeros_like(model.gradient), list[int]()
    waiting = [k for k, run in enumerate(runs) if run.end is None]
    while waiting:
        trial = torch.stack([
            runs[k].step(model.hessian[k], model.gradient[k], options) for k in waiting
        ])  # fmt: skip
        tried = problem.moved(x, active[waiting], trial)
        terms = problem.value(tried, active[waiting]).double().cpu()
        promise = (-0.5 * (model.gradient[waiting] * trial).sum(-1)).tolist()
        good = [k for j, k in enumerate(waiting) if runs[k].accepts(terms[j], promise[j], options)]
        if good == waiting and not taken:
            return tried
        steps[waiting] = trial
        taken += good
        waiting = [k for k in waiting if k not in good and runs[k].end is None]
    taken.sort()
    return problem.moved(x, active[taken], steps[taken]) if taken else x


@dataclass
class _ProblemRun:
    """Progress of one problem in a batch: damping, terms per iteration, reason to end."""

    damping: float
    trace: list[Float[Tensor, " terms"]] = field(default_factory=list)
    """Terms at every iterate."""
    evaluations: int = 0
    gain: float = 0.0  # by how much the last step lowered the objective
    end: Termination | None = None

    def begin_iteration(self, terms: Float[Tensor, " terms"]) -> None:
        """Record the terms at the start of an iteration."""
        self.evaluations += 1
        self.trace = self.trace or [terms]
        if not bool(terms.isfinite().all()):
            self.end = Termination.NONFINITE

    def step(
        self, hessian: Banded, gradient: Float[Tensor, " n"], options: GaussNewton
    ) -> Float[Tensor, " n"]:
        """Return the damped step; raises the damping until the matrix is positive definite."""
        while self.end is None:
            factor = Factor(hessian, self.damping)
            if factor.definite:
                return -factor.solve(gradient)
            self._raise_damping(options)
        return torch.zeros_like(gradient)

    def accepts(
        self, terms: Float[Tensor, " terms"], promise: float, options: GaussNewton
    ) -> bool:
        """Accept a step if the objective does not rise; adapt damping, check convergence."""
        if self.end is not None:
            return False
        self.evaluations += 1
        before = float(self.trace[-1].sum())
        gain = before - float(terms.sum()) if len(terms) > 0 else promise
        few = options.tolerance * max(abs(before), options.scale)
        if gain >= 0:  # false where gain is NaN
            self.trace.append(terms)
            self.damping = max(_LOWER * self.damping, _MIN_DAMPING)
            less = max(gain / self.gain, _FASTEST) if self.gain > gain and len(terms) > 0 else 1.0
            self.end = Termination.CONVERGED if gain * less <= few else None
            self.gain = gain
            return True
        if promise <= few:
            self.end = Termination.CONVERGED
        else:
            self._raise_damping(options)
        return False

    def _raise_damping(self, options: GaussNewton) -> None:
        self.damping = max(_RAISE * self.damping, _MIN_DAMPING)
        if self.damping > options.max_damping:
            self.end = Termination.LINE_SEARCH


def _progress_of_runs(runs: Sequence[_ProblemRun], active: Int[Tensor, " active"]) -> Progress:
    return Progress(
        max(run.evaluations for run in runs),
        active.numpy().copy(),
        np.array([len(run.trace) - 1 for run in runs]),
        np.array([float(run.trace[-1].sum()) for run in runs]),
    )


def _solution_of_runs(runs: Sequence[_ProblemRun]) -> Solution:
    longest = max(len(run.trace) for run in runs)
    padded = [run.trace + run.trace[-1:] * (longest - len(run.trace)) for run in runs]
    trace = torch.stack([torch.stack(rows) for rows in padded])
    return Solution(
        x=trace.new_zeros(len(runs), 0),
        value=trace[:, -1].sum(-1),
        iterations=torch.tensor([len(run.trace) - 1 for run in runs]),
        evaluations=torch.tensor([run.evaluations for run in runs]),
        termination=tuple(run.end or Termination.ITERATION_LIMIT for run in runs),
        trace=trace,
    )
