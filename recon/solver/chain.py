"""Solution of symmetric positive definite systems whose blocks form a chain, with a dense border.

    [[A, G], [Gᵀ, C]] [x, y] = [r, s],   A block-tridiagonal: A_i on its diagonal, U_i = A_(i, i+1)

Least squares over time series have such normal equations: neighbours in time couple, and a few
quantities belong to all moments. Time and memory are linear in the number of blocks.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Chain:
    """The blocks of a system and its right side."""

    diagonal: Float[Tensor, "blocks n n"]
    """A_i."""
    upper: Float[Tensor, "between n n"]
    """U_i couples block i with block i + 1; one fewer than there are blocks."""
    border: Float[Tensor, "blocks n m"]
    """G_i couples block i with the border, which may be empty."""
    corner: Float[Tensor, "m m"]
    """C."""
    right: Float[Tensor, "blocks n"]
    """r."""
    right_border: Float[Tensor, " m"]
    """s."""


@dataclass(frozen=True)
class ChainSolution:
    """The solution of a `Chain`."""

    inner: Float[Tensor, "blocks n"]
    """x."""
    border: Float[Tensor, " m"]
    """y."""


def solve_chain(chain: Chain) -> ChainSolution | None:
    """Block Cholesky from the first block to the last, and substitution back.

    None when the matrix is not positive definite in the precision of its numbers.
    """
    blocks, n = chain.right.shape
    diagonal, gathered = chain.diagonal[0], chain.border[0]
    right, corner, right_border = chain.right[0], chain.corner, chain.right_border
    factors: list[Tensor] = []
    reduced: list[Tensor] = []
    for i in range(blocks):
        factor, failed = torch.linalg.cholesky_ex(diagonal)
        if int(failed) != 0:
            return None
        beside = torch.cat((gathered, right[:, None]), -1)
        last = i == blocks - 1
        columns = beside if last else torch.cat((chain.upper[i], beside), -1)
        columns = torch.linalg.solve_triangular(factor, columns, upper=False)
        factors.append(factor)
        reduced.append(columns)
        beside = columns if last else columns[:, n:]
        taken = beside[:, :-1].mT @ beside
        corner, right_border = corner - taken[:, :-1], right_border - taken[:, -1]
        if not last:
            moved = columns[:, :n].mT @ columns
            diagonal = chain.diagonal[i + 1] - moved[:, :n]
            gathered = chain.border[i + 1] - moved[:, n:-1]
            right = chain.right[i + 1] - moved[:, -1]
    border = right_border
    if len(border) > 0:
        factor, failed = torch.linalg.cholesky_ex(corner)
        if int(failed) != 0:
            return None
        border = torch.cholesky_solve(right_border[:, None], factor)[:, 0]
    found: list[Tensor] = []
    for i in range(blocks - 1, -1, -1):
        columns = reduced[i]
        left = columns[:, -1] - columns[:, columns.shape[1] - 1 - len(border) : -1] @ border
        if found:
            left = left - columns[:, :n] @ found[-1]
        found.append(torch.linalg.solve_triangular(factors[i].mT, left[:, None], upper=True)[:, 0])
    return ChainSolution(torch.stack(found[::-1]), border)
