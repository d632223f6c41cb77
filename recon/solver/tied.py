"""Solution of block-diagonal systems whose neighbouring blocks are tied by a diagonal matrix.

    A_i x_i - T (l_i x_(i+1) + l_(i-1) x_(i-1)) = r_i,   l_i 0 or 1, T diagonal

Frames of a recording have such Gauss-Newton equations where steps from frame to frame are held
small: each frame is a dense block, and springs run between equal variables of neighbours.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Ties:
    """The part of a system outside its blocks."""

    stiffness: Float[Tensor, " n"]
    """Diagonal of T."""
    linked: Bool[Tensor, " between"]
    """l_i: whether block i is tied to block i + 1; one fewer than there are blocks."""

    def drawn(self, x: Float[Tensor, "blocks n"]) -> Float[Tensor, "blocks n"]:
        """T (l_i x_(i+1) + l_(i-1) x_(i-1))."""
        out = torch.zeros_like(x)
        if len(x) > 1:
            linked = self.linked[:, None]
            out[:-1] += x[1:].where(linked, 0.0)
            out[1:] += x[:-1].where(linked, 0.0)
        return out * self.stiffness


def solve_tied(
    factors: Float[Tensor, "blocks n n"],
    ties: Ties,
    right: Float[Tensor, "blocks n"],
    *,
    tolerance: float,
    iterations: int,
) -> Float[Tensor, "blocks n"]:
    """Conjugate gradients, with the blocks alone as preconditioner.

    The product of a block with a direction follows from the recurrence of the directions, so that
    only the factors are needed.

    Args:
        factors: lower Cholesky factors of the blocks A_i.
        ties: between them; the whole matrix must be positive definite.
        right: r.
        tolerance: of the residual's norm in the inverse of the blocks, relative to the first one.
        iterations: at most so many; without any the ties are left out.
    """
    x = _solved(factors, right)
    if iterations == 0 or not bool(ties.linked.any() & (ties.stiffness > 0).any()):
        return x
    # begun at the solution without ties, whose residual is what the ties draw
    residual = ties.drawn(x)
    target = tolerance**2 * float((right * x).sum())
    direction, product = torch.zeros_like(x), torch.zeros_like(x)
    before = 1.0
    for _ in range(iterations):
        z = _solved(factors, residual)
        size = float((residual * z).sum())
        if not size > target:
            break
        share = size / before
        direction = z + share * direction
        product = residual + share * product
        bent = product - ties.drawn(direction)
        curvature = float((direction * bent).sum())
        if not curvature > 0:
            break
        length = size / curvature
        x = x + length * direction
        residual = residual - length * bent
        before = size
    return x


def _solved(
    factors: Float[Tensor, "blocks n n"], right: Float[Tensor, "blocks n"]
) -> Float[Tensor, "blocks n"]:
    # two triangular solves: several times faster than cholesky_solve for single columns
    half = torch.linalg.solve_triangular(factors, right[..., None], upper=False)
    return torch.linalg.solve_triangular(factors.mT, half, upper=True)[..., 0]
