"""The Hessian of a stage's start as the scale of its L-BFGS."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch

from recon.body.model import BodyModel
from recon.method.newton.book import Book
from recon.method.newton.local import Local
from recon.method.stages import Stage
from recon.method.unknowns import Unknowns
from recon.solver.banded import Banded, Factor, NotPositiveDefinite
from recon.solver.solution import Progress, Solution, Termination

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
        try:
            return Factor(curvature, damping)
        except NotPositiveDefinite:
            continue
    time, _, n, _ = curvature.inner.shape
    return Factor(Banded.zero(time, curvature.reach, n, len(curvature.corner), curvature.inner))
