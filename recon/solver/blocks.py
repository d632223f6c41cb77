"""Symmetric block-tridiagonal systems with a dense border: solution and parts of the inverse.

    H = [[A, B], [Bᵀ, C]],   A with blocks A_i on its diagonal and U_i = A_(i, i+1) beside it.

Time series have such Hessians: neighbours in time couple, and a few quantities belong to all.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float64
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
