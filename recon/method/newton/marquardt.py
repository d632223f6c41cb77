"""Damped Gauss-Newton steps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.method.newton.book import Book
from recon.method.newton.local import Local, mapped
from recon.method.stages import Stage
from recon.method.unknowns import Unknowns
from recon.solver.banded import Banded, Factor, NotPositiveDefinite
from recon.solver.solution import Progress, Solution, Termination


@dataclass(frozen=True)
class Marquardt:
    """Steps -(H + d diag H)⁻¹ g (Levenberg 1944, Marquardt 1963), each clip with its damping d.

    Right where the Hessian costs no more than a few evaluations, as without a network.
    """

    first: float = 1e-3
    down: float = 0.1
    """Factor of the damping after a step that was taken."""
    up: float = 10.0
    """Factor after one that was not."""
    least: float = 1e-6
    most: float = 1e6
    """Damping at which no lower point is sought any more."""

    def __call__(
        self,
        stage: Stage[Any],
        body: BodyModel,
        unknowns: Unknowns[Any],
        told: Callable[[Progress], bool | None] | None,
    ) -> tuple[Unknowns[Any], Solution] | None:
        """The minimum of a stage; None where no Hessian of it is known."""
        book, settings = Book.open(unknowns), stage.minimiser
        damping = np.full(len(book.active), self.first)
        for _ in range(max(settings.max_iterations, 1)):
            local = Local.about(book.of(stage), body, book.unknowns[book.active])
            if local is None or local.size > local.bordered:
                return None
            point = _Point.of(local)
            book.begin(point.terms)
            if settings.max_iterations == 0:
                break
            clips = book.active.numpy()
            steps, tries, damping[clips] = self._steps(local, point, damping[clips])
            with torch.no_grad():
                moved = local.moved(local.base, steps)
                terms = local.objective(_as_they_are)(steps, torch.arange(len(steps)))
            ends = point.ends(terms, steps, settings.tolerance_decrease, settings.scale)
            traces = [row[None] for row in terms]
            # the point itself was evaluated with its gradient, and every trial without
            book.enter(moved, traces, [1 + k for k in tries], ends)
            if len(book.active) == 0:
                break
            if told is not None and told(book.progress()) is True:
                book.stop()
                break
        return book.unknowns, book.solution(stage)

    def _steps(
        self, local: Local, point: "_Point", damping: Float[np.ndarray, " active"]
    ) -> tuple[Float[Tensor, "active n"], list[int], Float[np.ndarray, " active"]]:
        """A step that descends for every clip, or none; trials; the damping to go on with."""
        damping, steps = damping.copy(), torch.zeros_like(point.gradient)
        tries = [0] * len(steps)
        waiting = [k for k, value in enumerate(point.value.tolist()) if np.isfinite(value)]
        while waiting:
            rows = torch.tensor(waiting)
            tried = torch.stack([
                _newton(local, local.curvature[k], point.gradient[k], float(damping[k]))
                for k in waiting
            ])  # fmt: skip
            with torch.no_grad():
                after = local.objective(_as_they_are)(tried, rows).double().sum(-1)
            lower = (after < point.value[rows]).tolist()
            for k, step, better in zip(waiting, tried, lower, strict=True):
                tries[k] += 1
                if better:
                    steps[k] = step
                    damping[k] = max(damping[k] * self.down, self.least)
                else:
                    damping[k] *= self.up
            waiting = [
                k
                for k, better in zip(waiting, lower, strict=True)
                if not better and damping[k] <= self.most
            ]
        return steps, tries, damping


@dataclass(frozen=True)
class _Point:
    """The objective and its gradient where an iteration begins."""

    terms: Float[Tensor, "active terms"]
    value: Float[Tensor, " active"]
    gradient: Float[Tensor, "active n"]

    @classmethod
    def of(cls, local: Local) -> "_Point":
        steps = local.zero().requires_grad_()
        with torch.enable_grad():
            terms = local.objective(_as_they_are)(steps, torch.arange(len(steps)))
            (gradient,) = torch.autograd.grad(terms.sum(), steps)
        terms = terms.detach()
        return cls(terms, terms.double().sum(-1), gradient)

    def ends(
        self, terms: Tensor, steps: Tensor, tolerance: float, scale: float
    ) -> list[Termination | None]:
        """The reason for which each clip ends after a step: too little decrease, or no step."""
        fell = self.value - terms.double().sum(-1)
        size = self.value.abs().clamp(min=scale)
        small = (fell <= tolerance * size).tolist()
        found: list[Termination | None] = []
        for k, enough in enumerate(small):
            if not bool(self.value[k].isfinite()):
                found.append(Termination.NONFINITE)
            elif enough or not bool(steps[k].any()):
                found.append(Termination.CONVERGED)
            else:
                found.append(None)
        return found


def _newton(
    local: Local, curvature: Banded, gradient: Float[Tensor, " n"], damping: float
) -> Float[Tensor, " n"]:
    """A damped step; none where the damped Hessian is not positive definite."""
    try:
        factor = Factor(curvature, damping)
    except NotPositiveDefinite:
        return torch.zeros_like(gradient)
    solve = [lambda inner, border: factor.up(*factor.down(inner, border))]
    return -mapped(solve, gradient[None], local.frames, local.bordered)[0]


def _as_they_are(steps: Tensor, active: Tensor) -> Tensor:
    del active
    return steps
