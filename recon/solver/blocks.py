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

    Elimination from the first block on, D_i = A_i - U_(i-1)ᵀ W_(i-1) with W_i = D_i⁻¹ U_i, and
    from the last one back (A⁻¹)_ii = D_i⁻¹ + W_i (A⁻¹)_(i+1, i+1) W_iᵀ (Takahashi, Fagan and Chin
    1973; for Gaussian chains Rauch, Tung and Striebel 1965).

    Raises:
        torch.linalg.LinAlgError: when H is not positive definite.
    """
    inverses: list[Tensor] = []
    ahead: list[Tensor] = []
    gathered: list[Tensor] = []
    for i, (own, border) in enumerate(zip(h.diagonal, h.border, strict=True)):
        if i > 0:
            own = own - h.upper[i - 1].mT @ ahead[-1]
            border = border - ahead[-1].mT @ gathered[-1]
        inverses.append(torch.cholesky_inverse(torch.linalg.cholesky(own)))
        gathered.append(border)
        if i < len(h.upper):
            ahead.append(inverses[-1] @ h.upper[i])
    within, onto = [inverses[-1]], [inverses[-1] @ gathered[-1]]
    for i in range(len(ahead) - 1, -1, -1):
        within.append(torch.addmm(inverses[i], ahead[i] @ within[-1], ahead[i].mT))
        onto.append(inverses[i] @ gathered[i] - ahead[i] @ onto[-1])
    x = torch.stack(onto[::-1])
    schur = h.corner - (h.border.mT @ x).sum(0)
    return Inverse(
        within=torch.stack(within[::-1]),
        onto=x,
        border=torch.cholesky_inverse(torch.linalg.cholesky(schur)),
    )
