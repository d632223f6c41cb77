"""Symmetric block-tridiagonal systems with a dense border: solution and parts of the inverse.

    H = [[A, B], [Bᵀ, C]],   A with blocks A_i on its diagonal and U_i = A_(i, i+1) beside it.

Time series have such Hessians: neighbours in time couple, and a few quantities belong to all.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float64
from torch import Tensor


@dataclass(frozen=True)
class Bordered:
    """The blocks of H."""

    diagonal: Float64[Tensor, "blocks n n"]
    upper: Float64[Tensor, "between n n"]
    """U_i couples block i with block i + 1; one fewer than there are blocks."""
    border: Float64[Tensor, "blocks n m"]
    corner: Float64[Tensor, "m m"]


@dataclass(frozen=True)
class Inverse:
    """The parts of H⁻¹ that marginal covariances need.

    With S = C - Bᵀ A⁻¹ B, the covariance of the border is S⁻¹ and that of block i is
    (A⁻¹)_ii + X_i S⁻¹ X_iᵀ, where X = A⁻¹ B; both covary by -X_i S⁻¹.
    """

    within: Float64[Tensor, "blocks n n"]
    """(A⁻¹)_ii."""
    onto: Float64[Tensor, "blocks n m"]
    """X_i."""
    border: Float64[Tensor, "m m"]
    """S⁻¹."""


def inverse(h: Bordered) -> Inverse:
    """Diagonal blocks of the inverse in time and memory linear in the number of blocks.

    Elimination from the first block on, D_i = A_i - U_(i-1)ᵀ D_(i-1)⁻¹ U_(i-1), and from the last
    one back, E_i = A_i - U_i E_(i+1)⁻¹ U_iᵀ, meet in (A⁻¹)_ii = (D_i + E_i - A_i)⁻¹ (Rauch, Tung
    and Striebel 1965, for Gaussian chains).

    Raises:
        torch.linalg.LinAlgError: when H is not positive definite.
    """
    a, u = h.diagonal, h.upper
    count = u.shape[-1]
    ahead, gathered = [a[0]], [h.border[0]]
    factors = [torch.linalg.cholesky(ahead[0])]
    for i in range(1, len(a)):
        beside = torch.cat((u[i - 1], gathered[-1]), -1)
        carried = torch.cholesky_solve(beside, factors[-1])
        ahead.append(a[i] - u[i - 1].mT @ carried[:, :count])
        gathered.append(h.border[i] - u[i - 1].mT @ carried[:, count:])
        factors.append(torch.linalg.cholesky(ahead[-1]))
    behind, onto = [a[-1]], [torch.cholesky_solve(gathered[-1], factors[-1])]
    for i in range(len(a) - 2, -1, -1):
        factor = torch.linalg.cholesky(behind[-1])
        behind.append(a[i] - u[i] @ torch.cholesky_solve(u[i].mT, factor))
        onto.append(torch.cholesky_solve(gathered[i] - u[i] @ onto[-1], factors[i]))
    x = torch.stack(onto[::-1])
    both = torch.stack(ahead) + torch.stack(behind[::-1]) - a
    schur = h.corner - (h.border.mT @ x).sum(0)
    return Inverse(
        within=torch.cholesky_inverse(torch.linalg.cholesky(both)),
        onto=x,
        border=torch.cholesky_inverse(torch.linalg.cholesky(schur)),
    )
