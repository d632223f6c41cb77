"""Bookkeeping of a batched solve: the active elements, and the state of all elements."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from recon.solver.curvature import Curvature
from recon.solver.line_search import LineSearches
from recon.solver.solution import Progress, Solution, Termination

REASONS = tuple(Termination)
GOES_ON = -1


@dataclass
class ActiveElements:
    """The elements of the batch that have not ended yet, one row each.

    `x` is where an element's line search began, `best` the lowest point it has found.
    """

    element: Int64[Tensor, " active"]
    x: Float[Tensor, "active n"]
    gradient: Float64[Tensor, "active n"]
    direction: Float64[Tensor, "active n"]
    best_x: Float[Tensor, "active n"]
    best_gradient: Float64[Tensor, "active n"]
    best_terms: Float64[Tensor, "active terms"]
    curvature: Curvature
    searches: LineSearches
    number: Int64[np.ndarray, " active"]
    """`element`, on the host."""
    largest: Float64[np.ndarray, " active"]
    """Largest component of `best_gradient`."""
    stalled: Int64[np.ndarray, " active"]
    """Iterations in a row with too little decrease."""
    steepest: Bool[np.ndarray, " active"]
    """The line search goes along the gradient: nothing is left to forget."""

    @classmethod
    def at_start(
        cls,
        start: Float[Tensor, "active n"],
        terms: Float64[Tensor, "active terms"],
        gradient: Float64[Tensor, "active n"],
        value: Float64[np.ndarray, " active"],
        largest: Float64[np.ndarray, " active"],
        history: int,
        scaled: bool,
    ) -> "ActiveElements":
        """Make the state of all elements at their starts, before a direction is chosen."""
        count = len(start)
        return cls(
            element=torch.arange(count, device=start.device),
            x=start,
            gradient=gradient,
            direction=torch.zeros_like(gradient),
            best_x=start,
            best_gradient=gradient,
            best_terms=terms,
            curvature=Curvature.empty(count, start.shape[1], history, start.device, scaled),
            searches=LineSearches.create(value),
            number=np.arange(count),
            largest=largest,
            stalled=np.zeros(count, dtype=np.int64),
            steepest=np.ones(count, dtype=bool),
        )

    def improve(
        self,
        rows: Bool[np.ndarray, " active"],
        x: Float[Tensor, "active n"],
        gradient: Float64[Tensor, "active n"],
        terms: Float64[Tensor, "active terms"],
        largest: Float64[np.ndarray, " active"],
    ) -> None:
        """Store the current trial as the best point of the elements in mask `rows`."""
        self.best_x = _rows_replaced(rows, x, self.best_x)
        self.best_gradient = _rows_replaced(rows, gradient, self.best_gradient)
        self.best_terms = _rows_replaced(rows, terms, self.best_terms)
        self.largest = np.where(rows, largest, self.largest)

    def keep(self, rows: Bool[np.ndarray, " active"]) -> None:
        """Remove the elements that are not in mask `rows` from all tensors."""
        if rows.all():
            return
        index = self.indices(rows)
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Tensor):
                setattr(self, field.name, value[index])
            elif isinstance(value, np.ndarray):
                setattr(self, field.name, value[rows])
        self.curvature.keep(index)
        self.searches.keep(rows)

    def count_stalls(
        self, moved: Bool[np.ndarray, " active"], tolerance: float, scale: float
    ) -> None:
        """Update each element's count of successive steps that decreased too little."""
        old, new = self.searches.origin, self.searches.low[1]
        size = np.maximum(np.maximum(np.abs(old), np.abs(new)), scale)
        small = old - new <= tolerance * size
        self.stalled = np.where(moved, np.where(small, self.stalled + 1, 0), self.stalled)

    def restart_searches(
        self, finished: Bool[np.ndarray, " active"], moved: Bool[np.ndarray, " active"]
    ) -> None:
        """Start new line searches for the elements whose search has finished.

        If the element moved, its step enters the history; if not, its history is cleared.
        """
        rows = self.indices(moved)
        self.curvature.live[self.indices(finished & ~moved)] = False
        if len(rows) > 0:
            step = self.best_x[rows].double() - self.x[rows].double()
            self.curvature.add(rows, step, self.best_gradient[rows] - self.gradient[rows])
        self.x = _rows_replaced(finished, self.best_x, self.x)
        self.gradient = _rows_replaced(finished, self.best_gradient, self.gradient)
        found = self.curvature.direction(self.gradient, rows)
        self.direction = _rows_replaced(finished, found, self.direction)
        self.steepest = np.where(finished, ~moved, self.steepest)
        self.searches.restart(finished, self.searches.low[1].copy())

    def indices(self, rows: Bool[np.ndarray, " active"]) -> Int64[Tensor, " rows"]:
        """Convert a mask on the host to indices on the device of the tensors."""
        return torch.from_numpy(rows.nonzero()[0]).to(self.element.device)


@dataclass
class BatchState:
    """The state of the whole batch, of active and of finished elements."""

    x: Float[Tensor, "batch n"]
    trace: Float64[Tensor, "batch room terms"]
    value: Float64[np.ndarray, " batch"]
    iterations: Int64[np.ndarray, " batch"]
    evaluations: Int64[np.ndarray, " batch"]
    termination: list[Termination]

    @classmethod
    def at_start(
        cls,
        start: Float[Tensor, "batch n"],
        terms: Float64[Tensor, "batch terms"],
    ) -> "BatchState":
        """Make the state of a batch at its start, after one evaluation."""
        batch = len(start)
        return cls(
            x=start.clone(),
            trace=terms[:, None].clone(),
            value=terms.sum(-1).cpu().numpy().copy(),
            iterations=np.zeros(batch, dtype=np.int64),
            evaluations=np.ones(batch, dtype=np.int64),
            termination=[Termination.ITERATION_LIMIT] * batch,
        )

    def record_steps(self, active: ActiveElements, moved: Bool[np.ndarray, " active"]) -> None:
        """Count an iteration and store the terms of the elements that moved."""
        if not moved.any():
            return
        number, rows = active.number[moved], active.indices(moved)
        self.iterations[number] += 1
        self.value[number] = active.searches.low[1, moved]
        room = self.trace.shape[1]
        if self.iterations[number].max() >= room:
            self.trace = torch.cat((self.trace, torch.zeros_like(self.trace)), 1)
        iteration = torch.from_numpy(self.iterations[number]).to(rows.device)
        self.trace[active.element[rows], iteration] = active.best_terms[rows]

    def record_ends(self, active: ActiveElements, reason: Int64[np.ndarray, " active"]) -> None:
        """Store the final variables and the reason of elements that have ended."""
        done = reason != GOES_ON
        if not done.any():
            return
        for number, why in zip(active.number[done], reason[done], strict=True):
            self.termination[number] = REASONS[why]
        rows = active.indices(done)
        self.x[active.element[rows]] = active.best_x[rows]

    def progress(self, active: ActiveElements, evaluations: int) -> Progress:
        """A copy of the batch's progress, which a callback may keep."""
        return Progress(
            evaluations, active.number.copy(), self.iterations.copy(), self.value.copy()
        )

    def solution(self) -> Solution:
        """Return the solution after all elements have ended; all but `x` is on the CPU."""
        iterations, trace = torch.from_numpy(self.iterations), self.trace.cpu()
        longest = int(self.iterations.max(initial=0)) + 1
        row = torch.arange(longest).minimum(iterations[:, None])
        return Solution(
            x=self.x,
            value=torch.from_numpy(self.value),
            iterations=iterations,
            evaluations=torch.from_numpy(self.evaluations),
            termination=tuple(self.termination),
            trace=trace.gather(1, row[..., None].expand(-1, -1, trace.shape[2])),
        )


def _rows_replaced(
    rows: Bool[np.ndarray, " active"],
    new: Float[Tensor, "active columns"],
    old: Float[Tensor, "active columns"],
) -> Float[Tensor, "active columns"]:
    """Return `new` where mask `rows` is true, else `old`; copies only if both are needed."""
    if rows.all():
        return new
    if not rows.any():
        return old
    return torch.where(torch.from_numpy(rows).to(new.device)[:, None], new, old)
