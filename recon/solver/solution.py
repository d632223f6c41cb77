"""Records of a solver: its objective and callback, and its solution."""

import enum
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64, Int, Int64
from torch import Tensor

Objective = Callable[
    [Float[Tensor, "active n"], Int[Tensor, " active"]], Float[Tensor, "active terms"]
]
"""Weighted terms of the batch elements named in the second argument, at the first.

Their sum over terms is minimised. Differentiable in the first argument; rows are independent.
"""


class Termination(enum.Enum):
    """Reasons why the minimisation of an element ended, each with the sentence for the user."""

    CONVERGED = "the objective's relative decrease fell below its tolerance"
    GRADIENT = "the gradient fell below its tolerance"
    ITERATION_LIMIT = "the iteration limit was reached"
    EVALUATION_LIMIT = "the evaluation limit was reached"
    LINE_SEARCH = "no further decrease could be found along the search direction"
    NONFINITE = "the objective became nan or inf; the last finite estimate was kept"
    STOPPED = "the caller stopped it; the last estimate was kept"


@dataclass(frozen=True)
class Progress:
    """The state of a solve that a callback is given after every completed iteration."""

    evaluations: int
    """Calls of the objective so far."""
    active: Int64[np.ndarray, " active"]
    """The batch elements still being worked on."""
    iterations: Int64[np.ndarray, " batch"]
    """Completed iterations of every element."""
    value: Float64[np.ndarray, " batch"]
    """The objective at every element's current iterate."""


@dataclass(frozen=True)
class Solution:
    """The solution of every element of a batch, why it ended, and its energies on the way."""

    x: Float[Tensor, "batch n"]
    """The last iterate. Iterates are finite and never increase the objective."""
    value: Float64[Tensor, " batch"]
    """The objective at `x`; not finite only if it was not finite at the start."""
    iterations: Int[Tensor, " batch"]
    """Steps taken."""
    evaluations: Int[Tensor, " batch"]
    """Calls of the objective this element took part in."""
    termination: tuple[Termination, ...]
    """The reason why each element ended."""
    trace: Float64[Tensor, "batch iterations terms"]
    """Term values at every iterate. Row 0 is the start; rows past an element's end repeat its
    last."""

    def rows(self, index: Int[Tensor, " rows"]) -> "Solution":
        """Return the solution of the batch elements with the given indices."""
        return replace(
            self,
            x=self.x[index],
            value=self.value[index],
            iterations=self.iterations[index],
            evaluations=self.evaluations[index],
            termination=tuple(self.termination[k] for k in index.tolist()),
            trace=self.trace[index],
        )


def joined_in_turn(solutions: Sequence[Solution]) -> Solution:
    """Join solutions of successive minimisations to one: sums of counts, joined traces."""
    last = solutions[-1]
    return replace(
        last,
        iterations=torch.stack([s.iterations for s in solutions]).sum(0),
        evaluations=torch.stack([s.evaluations for s in solutions]).sum(0),
        trace=torch.cat([s.trace for s in solutions], 1),
    )


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread, then restore the number of threads.

    Batches of small matrices gain nothing from several: threads that wait for each other spin, and
    where other processes want the processors too, that costs many times the work.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
