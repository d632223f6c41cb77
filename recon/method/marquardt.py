"""Damped Gauss-Newton steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.method.newton import Local
from recon.method.stages import Stage
from recon.method.unknowns import Layout, Unknowns
from recon.solver.banded import Banded, Factor
from recon.solver.solution import Progress, Solution, Termination


@dataclass
class Book:
    """Unknowns, numbers and ends of all clips; `active` ones are still being worked on."""

    unknowns: Unknowns[Any]
    active: Int[Tensor, " active"]
    iterations: Int[Tensor, " clips"]
    evaluations: Int[Tensor, " clips"]
    termination: list[Termination]
    traces: list[Float[Tensor, "_ terms"]]
    """Term values of every clip at its iterates."""

    @classmethod
    def open(cls, unknowns: Unknowns[Any]) -> "Book":
        """All clips, with nothing done yet."""
        count = len(next(iter(unknowns.tensors().values())))
        none = torch.zeros(count, dtype=torch.int64)
        limit = [Termination.ITERATION_LIMIT] * count
        every = torch.arange(count)
        return cls(unknowns.detach(), every, none, none.clone(), limit, [])

    def of(self, stage: Stage[Any]) -> Stage[Any]:
        """The stage with the data of the clips that are active."""
        return stage.rows(self.active)

    def begin(self, terms: Float[Tensor, "active terms"]) -> None:
        """Enter the terms at the start of all clips; later calls change nothing."""
        if not self.traces:
            self.traces = [row[None] for row in terms.double().cpu()]

    def enter(
        self,
        moved: Unknowns[Any],
        traces: Sequence[Float[Tensor, "_ terms"]],
        evaluations: Sequence[int],
        ends: Sequence[Termination | None],
    ) -> None:
        """Enter where the active clips have been led; those that have an end are active no more.

        Args:
            moved: unknowns of the active clips.
            traces: term values of each at its new iterates.
            evaluations: by which it got there.
            ends: why it ended; None where it goes on.
        """
        new = iter(moved.tensors().values())

        def put(old: Tensor) -> Tensor:
            whole = old.clone()
            whole[self.active] = next(new).detach().to(old)
            return whole

        self.unknowns = self.unknowns.map(put)
        for k, clip in enumerate(self.active.tolist()):
            self.iterations[clip] += len(traces[k])
            self.evaluations[clip] += evaluations[k]
            self.traces[clip] = torch.cat((self.traces[clip], traces[k].double().cpu()))
            self.termination[clip] = ends[k] or Termination.ITERATION_LIMIT
        self.active = self.active[_mask([end is None for end in ends])]

    def stop(self) -> None:
        """End all clips where they are, because the caller wants it."""
        for clip in self.active.tolist():
            self.termination[clip] = Termination.STOPPED
        self.active = self.active[:0]

    def progress(self) -> Progress:
        """What a callback is told."""
        value = torch.stack([trace[-1].sum() for trace in self.traces])
        return Progress(
            int(self.evaluations.max()),
            self.active.numpy().copy(),
            self.iterations.numpy().copy(),
            value.numpy(),
        )

    def solution(self, stage: Stage[Any]) -> Solution:
        """The result, once no clip is active."""
        longest = max(len(trace) for trace in self.traces)
        padded = [t[torch.arange(longest).clamp(max=len(t) - 1)] for t in self.traces]
        trace = torch.stack(padded)
        return Solution(
            x=Layout.of(self.unknowns, stage.free).flatten(self.unknowns),
            value=trace[:, -1].sum(-1),
            iterations=self.iterations,
            evaluations=self.evaluations,
            termination=tuple(self.termination),
            trace=trace,
        )


def _mask(rows: Sequence[bool]) -> Bool[Tensor, " active"]:
    return torch.tensor(rows, dtype=torch.bool)


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
                _newton(local.curvature[k], point.gradient[k], float(damping[k]))
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
    curvature: Banded, gradient: Float[Tensor, " n"], damping: float
) -> Float[Tensor, " n"]:
    """A damped step; none where the damped Hessian is not positive definite."""
    factor = Factor(curvature, damping)
    return -factor.solve(gradient) if factor.definite else torch.zeros_like(gradient)


def _as_they_are(steps: Tensor, active: Tensor) -> Tensor:
    del active
    return steps


_DAMPINGS = (0.0, 1e-4, 1e-2)


@dataclass(frozen=True)
class Preconditioned:
    """L-BFGS in variables in which the Hessian of the start is the identity."""

    every: int = 200
    """Iterations after which the Hessian is found anew. Finding it more often does not pay: what
    L-BFGS has learned of the objective is lost with it (every 25, validation windows took a
    quarter more iterations)."""

    def __call__(
        self,
        stage: Stage[Any],
        body: BodyModel,
        unknowns: Unknowns[Any],
        told: Callable[[Progress], bool | None] | None,
    ) -> tuple[Unknowns[Any], Solution] | None:
        """The minimum of a stage; None where no Hessian of it is known."""
        book, left = Book.open(unknowns), stage.minimiser.max_iterations
        while len(book.active) > 0 and left > 0:
            local = Local.about(book.of(stage), body, book.unknowns[book.active])
            if local is None:
                return None
            count = min(self.every, left)
            left -= count
            steps_of = local.scaled([factorised(one) for one in local.curvature])
            minimiser = replace(stage.minimiser, max_iterations=count, scaled=True)
            found = minimiser(local.objective(steps_of), local.zero(), told)
            with torch.no_grad():
                every = torch.arange(len(found.x))
                moved = local.moved(local.base, steps_of(found.x, every))
            taken = found.iterations.tolist()
            traces = [trace[: 1 + n] for trace, n in zip(found.trace, taken, strict=True)]
            book.begin(torch.stack([trace[0] for trace in traces]))
            ends = [
                None if end is Termination.ITERATION_LIMIT and left > 0 else end
                for end in found.termination
            ]
            book.enter(moved, [t[1:] for t in traces], found.evaluations.tolist(), ends)
        return book.unknowns, book.solution(stage)


def factorised(curvature: Banded) -> Factor:
    """The factor of a Hessian; where rounding or numbers that are not finite forbid it, of 1."""
    for damping in _DAMPINGS:
        factor = Factor(curvature, damping)
        if factor.definite:
            return factor
    time, _, n, _ = curvature.inner.shape
    return Factor(Banded.zero(time, curvature.reach, n, len(curvature.corner), curvature.inner))
