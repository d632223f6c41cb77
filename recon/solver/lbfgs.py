"""L-BFGS over a batch of independent problems that share one function call.

Every element has its own line search, curvature history, convergence and failure; all that is
shared is the call of the objective, which sees the elements still being worked on. So the result
of one element does not depend on its neighbours, and one that fails keeps its last finite
iterate while the others go on.

The solver knows tensors only. Per evaluation it makes one transfer of four numbers per element
from the device to the host, where the scalar decisions are taken.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from recon.solver.line_search import TrialOutcome, WolfeConditions
from recon.solver.solution import Objective as Objective
from recon.solver.solution import Progress as Progress
from recon.solver.solution import Solution as Solution
from recon.solver.solution import Termination as Termination
from recon.solver.state import GOES_ON, REASONS, ActiveElements, BatchState


@dataclass(frozen=True)
class LBFGS:
    """Limited-memory BFGS (Nocedal 1980; Liu & Nocedal 1989) with a strong-Wolfe line search.

    Iterates are kept in the type of the start; directions, history and inner products in float64:
    16 `history` n bytes per element.
    """

    max_iterations: int = 100
    """Steps an element may take."""
    max_evaluations: int | None = None
    """Evaluations an element may take part in; None is no limit."""
    history: int = 20
    """Pairs (step, change of gradient) remembered."""
    tolerance_decrease: float = 1e-9
    """Converged once (f_old - f_new) / max(|f_old|, |f_new|) was at most this, `patience` times
    in a row."""
    scale: float = 0.0
    """Objective, in its own unit, below which decreases are taken relative to this instead. An
    objective of log-densities may be zero or less, where a relative decrease means nothing."""
    scaled: bool = False
    """Whether variables are such that the Hessian is about the identity: the first step is then
    the negative gradient rather than a short part of it."""
    patience: int = 3
    """Consecutive iterations of too little decrease that count as convergence."""
    tolerance_gradient: float = 1e-7
    """Finished once no component of the gradient exceeds this, in the objective's unit per unit
    of the variable."""
    c1: float = 1e-4
    """Sufficient decrease of the line search, as a fraction of the linear prediction."""
    c2: float = 0.9
    """Curvature condition of the line search: the slope left over, as a fraction of the first."""
    max_line_search: int = 20
    """Evaluations one line search may take."""

    def __post_init__(self) -> None:
        """Raise an error for settings under which no step could ever be taken."""
        if not 0 < self.c1 < self.c2 < 1:
            raise ValueError(f"expected 0 < c1 < c2 < 1, got c1={self.c1}, c2={self.c2}")
        for name, least in (
            ("max_iterations", 0),
            ("max_evaluations", 1),
            ("history", 1),
            ("patience", 1),
            ("max_line_search", 1),
            ("tolerance_decrease", 0.0),
            ("tolerance_gradient", 0.0),
            ("scale", 0.0),
        ):
            setting = getattr(self, name)
            if setting is not None and not setting >= least:
                raise ValueError(f"{name} must be at least {least}, got {setting}")

    def __call__(
        self,
        objective: Objective,
        start: Float[Tensor, "batch n"],
        callback: Callable[[Progress], bool | None] | None = None,
    ) -> Solution:
        """Minimise `objective` from `start`, each batch element for itself.

        The start is not changed. Exceptions of the objective and of the callback propagate. A
        callback that returns True ends the minimisation of all elements where they are.
        """
        with torch.no_grad():
            return _minimise(self, objective, start.detach(), callback)


def _minimise(
    settings: LBFGS,
    objective: Objective,
    start: Float[Tensor, "batch n"],
    callback: Callable[[Progress], bool | None] | None,
) -> Solution:
    if len(start) == 0:
        return BatchState.at_start(start, start.new_zeros(0, 0, dtype=torch.float64)).solution()
    every = torch.arange(len(start), device=start.device)
    values, gradient = _evaluate(objective, start, every)
    terms = values.double()
    value, largest = _to_host(terms.sum(-1), _largest_entry(gradient))
    resolution = max(torch.finfo(kind).eps for kind in (start.dtype, values.dtype))
    wolfe = WolfeConditions(settings.c1, settings.c2, settings.max_line_search, resolution)
    state = BatchState.at_start(start, terms)
    active = ActiveElements.at_start(
        start, terms, gradient, value, largest, settings.history, settings.scaled
    )
    reason = _reasons_to_end_at_start(settings, value, largest)
    state.record_ends(active, reason)
    active.keep(reason == GOES_ON)
    active.direction = active.curvature.direction(active.gradient, active.element[:0])

    evaluations = 1
    while len(active.number) > 0:
        evaluations += 1
        searches = active.searches
        step = torch.from_numpy(searches.step).to(start.device)
        x = (active.x + step[:, None] * active.direction).to(start.dtype)
        values, gradient = _evaluate(objective, x, active.element)
        terms = values.double()
        value, slope, origin_slope, largest = _to_host(
            terms.sum(-1),
            (gradient * active.direction).sum(-1),
            (active.gradient * active.direction).sum(-1),
            _largest_entry(gradient),
        )
        slope[~np.isfinite(largest)] = np.inf
        verdict = searches.advance(value, slope, origin_slope, wolfe)
        active.improve(verdict.improved, x, gradient, terms, largest)
        state.evaluations[active.number] = evaluations
        spent = state.evaluations[active.number] >= (settings.max_evaluations or np.inf)
        finished = verdict.finished | spent
        if not finished.any():
            continue
        moved = finished & (searches.low[0] > 0)
        state.record_steps(active, moved)
        active.count_stalls(moved, settings.tolerance_decrease, settings.scale)
        # Searches end where even the full quasi-Newton step would decrease the value too little.
        size = np.maximum(np.abs(searches.origin), settings.scale)
        least = max(settings.tolerance_decrease, resolution) * size
        flat = ~active.steepest & ~verdict.unreachable & (-origin_slope <= least)
        many = state.iterations[active.number] >= settings.max_iterations
        reason = _reasons_to_end(settings, active, verdict, moved, flat, many, spent)
        state.record_ends(active, reason)
        goes_on = reason == GOES_ON
        active.keep(goes_on)
        if (finished & goes_on).any():
            active.restart_searches(finished[goes_on], moved[goes_on])
        if (
            callback is not None
            and moved.any()
            # only `True` stops: callbacks may return anything else
            and callback(state.progress(active, evaluations)) is True
        ):
            state.record_steps(active, active.searches.low[0] > 0)  # steps to lower values only
            every_active = np.full(len(active.number), True)
            state.record_ends(active, _first_reason((every_active, Termination.STOPPED)))
            break
    return state.solution()


def _reasons_to_end_at_start(
    settings: LBFGS,
    value: Float64[np.ndarray, " batch"],
    largest: Float64[np.ndarray, " batch"],
) -> Int64[np.ndarray, " batch"]:
    """Return, per element, the reason to end before a first step as its index, or GOES_ON."""
    return _first_reason(
        (~np.isfinite(value) | ~np.isfinite(largest), Termination.NONFINITE),
        (largest <= settings.tolerance_gradient, Termination.GRADIENT),
        (np.full(len(value), settings.max_iterations == 0), Termination.ITERATION_LIMIT),
        (np.full(len(value), settings.max_evaluations == 1), Termination.EVALUATION_LIMIT),
    )


def _reasons_to_end(
    settings: LBFGS,
    active: ActiveElements,
    verdict: TrialOutcome,
    moved: Bool[np.ndarray, " active"],
    flat: Bool[np.ndarray, " active"],
    many: Bool[np.ndarray, " active"],
    spent: Bool[np.ndarray, " active"],
) -> Int64[np.ndarray, " active"]:
    """Return, per element, the reason to end after a trial as its index, or GOES_ON.

    Of the masks, `moved` are searches that ended with a step, `flat` where the full quasi-Newton
    step promises too little, `many` and `spent` where no iteration or evaluation is left.
    """
    return _first_reason(
        (moved & (active.largest <= settings.tolerance_gradient), Termination.GRADIENT),
        (moved & (active.stalled >= settings.patience), Termination.CONVERGED),
        (verdict.unmoved & flat, Termination.CONVERGED),
        (active.steepest & verdict.unreachable, Termination.NONFINITE),
        (active.steepest & verdict.unmoved, Termination.LINE_SEARCH),
        (many, Termination.ITERATION_LIMIT),
        (spent, Termination.EVALUATION_LIMIT),
    )


def _evaluate(
    objective: Objective, x: Float[Tensor, "active n"], element: Int64[Tensor, " active"]
) -> tuple[Float[Tensor, "active terms"], Float64[Tensor, "active n"]]:
    """Evaluate the objective's terms and the gradient of their sum."""
    x = x.detach().requires_grad_()
    with torch.enable_grad():
        terms = objective(x, element)
        if terms.ndim != 2 or len(terms) != len(x):
            raise ValueError(
                f"the objective must return (active, terms) = ({len(x)}, any), "
                f"got {tuple(terms.shape)}; return one row per element, one column per term"
            )
        if x.shape[1] == 0:
            return terms.detach(), x.detach().double()
        if not terms.requires_grad:
            raise ValueError(
                "the objective's terms do not depend on the variables through autograd; "
                "compute them from the tensor passed in, without detaching it"
            )
        (gradient,) = torch.autograd.grad(terms.sum(), x)
    return terms.detach(), gradient.double()


def _to_host(*rows: Float64[Tensor, " active"]) -> Float64[np.ndarray, "rows active"]:
    """Copy several tensors to the CPU in one transfer."""
    return torch.stack(rows).cpu().numpy()


def _largest_entry(gradient: Float64[Tensor, "active n"]) -> Float64[Tensor, " active"]:
    if gradient.shape[1] == 0:
        return gradient.new_zeros(len(gradient))
    return gradient.abs().amax(-1)


def _first_reason(
    *cases: tuple[Bool[np.ndarray, " active"], Termination],
) -> Int64[np.ndarray, " active"]:
    """The first reason that applies to each element, as its index in REASONS, or GOES_ON."""
    masks, reasons = zip(*cases, strict=True)
    places = [np.int64(REASONS.index(reason)) for reason in reasons]
    return np.select(masks, places, default=np.int64(GOES_ON))
