"""Damped Gauss-Newton steps for many blocks of variables that share a few common ones.

    [[A, G], [Gᵀ, C]] [x, y] = [r, s],   A block-diagonal

Frames that share the shape of a body have such normal equations: blocks are eliminated one by one,
all at once in memory, and what is left is a small system for the common variables.
"""

from dataclasses import dataclass, replace
from typing import Generic, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.struct import S

_FIRST_RAISE = 1e-3
"""Damping after the first step that raises the energy."""
_RAISE, _LOWER = 10.0, 0.1
_MAX_DAMPING = 1e6
"""Damping beyond which the state is taken to be as good as it gets."""


@dataclass(frozen=True)
class Arrow:
    """The blocks of a system and its right side."""

    blocks: Float[Tensor, "blocks n n"]
    """A_i."""
    border: Float[Tensor, "blocks n m"]
    """G_i."""
    corner: Float[Tensor, "m m"]
    """C."""
    right: Float[Tensor, "blocks n"]
    """r."""
    right_border: Float[Tensor, " m"]
    """s."""

    def damped(self, share: float) -> "Arrow":
        """The system with its diagonal raised by a share of itself."""
        blocks, corner = self.blocks.clone(), self.corner.clone()
        blocks.diagonal(dim1=1, dim2=2).mul_(1 + share)
        corner.diagonal().mul_(1 + share)
        return replace(self, blocks=blocks, corner=corner)


def solve_arrow(
    arrow: Arrow,
) -> tuple[Float[Tensor, "blocks n"], Float[Tensor, " m"]] | None:
    """The solution x, y; None when the matrix is not positive definite in its precision."""
    factors, failed = torch.linalg.cholesky_ex(arrow.blocks)
    if bool(failed.any()):
        return None
    beside = torch.cat((arrow.border, arrow.right[..., None]), -1)
    beside = torch.linalg.solve_triangular(factors, beside, upper=False)
    columns = beside.flatten(0, 1)
    taken = columns[:, :-1].mT @ columns
    factor, failed = torch.linalg.cholesky_ex(arrow.corner - taken[:, :-1])
    if int(failed) != 0:
        return None
    common = torch.cholesky_solve((arrow.right_border - taken[:, -1])[:, None], factor)
    left = beside[..., -1:] - beside[..., :-1] @ common
    return torch.linalg.solve_triangular(factors.mT, left, upper=True)[..., 0], common[:, 0]


@runtime_checkable
class SharedEnergies(Protocol[S]):
    """Energies of blocks that share common variables."""

    def value(self, state: S) -> Tensor:
        """The whole energy."""
        ...

    def equations(self, state: S) -> Arrow:
        """Gauss-Newton equations of a step, the gradient with its sign turned on the right."""
        ...

    def moved(self, state: S, steps: Float[Tensor, "blocks n"], common: Tensor) -> S:
        """The state after steps of the blocks and of the common variables."""
        ...


@dataclass(frozen=True)
class Settled(Generic[S]):
    """The result of a minimisation."""

    state: S
    value: float
    converged: bool
    iterations: int


def minimise_shared(
    energies: SharedEnergies[S],
    state: S,
    *,
    tolerance: float,
    max_iterations: int,
    damping: float = 0.0,
) -> Settled[S]:
    """Minimise by damped steps until one promises and brings less than a share of the energy.

    The energy never rises.

    Args:
        energies: what is minimised.
        state: where to begin.
        tolerance: relative decrease of the energy that counts as none.
        max_iterations: a safety net.
        damping: share of the diagonal that it is raised by at first.
    """
    value = float(energies.value(state))
    for iteration in range(1, max_iterations + 1):
        arrow = energies.equations(state)
        while True:
            found = solve_arrow(arrow.damped(damping))
            if found is not None:
                tried = energies.moved(state, *found)
                after = float(energies.value(tried))
                if after <= value:
                    break
            damping = max(_RAISE * damping, _FIRST_RAISE)
            if damping > _MAX_DAMPING:
                return Settled(state, value, True, iteration)
        steps, common = found
        promise = 0.5 * float((arrow.right * steps).sum() + (arrow.right_border * common).sum())
        gained, state, value = value - after, tried, after
        if max(promise, gained) <= tolerance * value:
            return Settled(state, value, True, iteration)
        damping *= _LOWER
    return Settled(state, value, False, max_iterations)
