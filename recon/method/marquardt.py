"""Second-order stages: damped Gauss-Newton steps, or L-BFGS in variables scaled by a Hessian."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.method.newton import NoHessian, StageProblem
from recon.method.stages import Stage
from recon.method.unknowns import Unknowns, objective
from recon.solver.banded import Banded, Factor
from recon.solver.gauss_newton import GaussNewton, minimise
from recon.solver.solution import Progress, Solution


def marquardt(
    stage: Stage[Any],
    body: BodyModel,
    unknowns: Unknowns[Any],
    on_progress: Callable[[Progress], bool | None] | None,
) -> tuple[Unknowns[Any], Solution] | None:
    """Minimise a stage by Gauss-Newton steps, each clip with its own Levenberg-Marquardt damping.

    This suits stages whose Hessian costs no more than a few evaluations, as without a network.
    The scene's Hessian is not known. If the scene is free, it is held in a first minimisation,
    and all variables move in a second one by `preconditioned`.
    """
    settings = stage.minimiser
    least_gain = max(settings.tolerance_decrease, _LEAST_DECREASE)
    options = GaussNewton(settings.max_iterations, least_gain, settings.scale)
    try:
        local, base = StageProblem.around(stage, body, unknowns)
        if local.size > local.hessian_size:
            alone = replace(stage, free=frozenset(n for n in stage.free if n in _OF_MOTION))
            held = marquardt(alone, body, unknowns, on_progress)
            rest = replace(stage, minimiser=replace(settings, tolerance_decrease=least_gain))
            return held and preconditioned(rest, body, held[0], on_progress)
        found, solution = minimise(local, base, options, len(unknowns.scene.offsets), on_progress)
    except NoHessian:
        return None
    return found, replace(solution, x=local.layout.flatten(found))


_OF_MOTION = frozenset({"translation", "root", "pose", "shape"})
_LEAST_DECREASE = 3e-4
"""Relative decrease below which no Hessian is worth it: what is left falls with its square."""
_DAMPINGS = (0.0, 1e-4, 1e-2)


def preconditioned(
    stage: Stage[Any],
    body: BodyModel,
    unknowns: Unknowns[Any],
    on_progress: Callable[[Progress], bool | None] | None,
) -> tuple[Unknowns[Any], Solution] | None:
    """Minimise a stage by L-BFGS in variables in which the initial Hessian is the identity."""
    try:
        local, base = StageProblem.around(stage, body, unknowns)
        factors = [factorised(one) for one in local.hessians(base)]
    except NoHessian:
        return None

    def moved(some: Unknowns[Any], u: Tensor, active: Tensor) -> Unknowns[Any]:
        # reading row numbers waits for a GPU to finish: skip this where all clips are active
        all_active = len(active) == len(factors)
        active_factors = factors if all_active else [factors[k] for k in active.tolist()]
        return local.after_steps(some, _Unwhitened.apply(u, active_factors, local.hessian_size))

    start = base.variables.shape.new_zeros(len(factors), local.size)
    minimiser = replace(stage.minimiser, scaled=True)
    solution = minimiser(objective(stage, body, base, moved), start, on_progress)
    with torch.no_grad():
        found = moved(base, solution.x, torch.arange(len(factors)))
    return found, replace(solution, x=local.layout.flatten(found))


def factorised(curvature: Banded) -> Factor:
    """Return the factor of a Hessian, damped until definite; failing that, of the identity."""
    for damping in _DAMPINGS:
        factor = Factor(curvature, damping)
        if factor.definite:
            return factor
    time, _, n, _ = curvature.inner.shape
    return Factor(Banded.zero(time, curvature.reach, n, len(curvature.corner), curvature.inner))


class _Unwhitened(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, factors: Sequence[Factor], hessian_size: int) -> Tensor:
        ctx.map = factors, hessian_size
        return _map_each_clip([one.solve_upper for one in factors], u, hessian_size)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        factors, hessian_size = ctx.map
        return (
            _map_each_clip([one.solve_lower for one in factors], gradients[0], hessian_size),
            None,
            None,
        )


def _map_each_clip(
    functions: Sequence[Callable[[Tensor], Tensor]],
    flat: Float[Tensor, "rows n"],
    hessian_size: int,
) -> Float[Tensor, "rows n"]:
    """Apply each clip's function to its first `hessian_size` unknowns; keep the others."""
    rows = [f(row[:hessian_size]) for f, row in zip(functions, flat, strict=True)]
    return torch.cat((torch.stack(rows), flat[:, hessian_size:]), 1)
