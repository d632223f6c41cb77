"""Symmetric positive definite matrices of time series: a band about the diagonal, and a border.

    H = [[A, B], [Bᵀ, C]],   A_(t, t + k) = 0 for k beyond the reach

Moments of a series couple with a few neighbours, and a few quantities belong to all moments.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

_MIN_DIAGONAL_RAISE = 1e-6
"""Share that every diagonal is raised by at least: what rounding to single precision needs."""


@dataclass(frozen=True)
class Banded:
    """The blocks of a matrix, to which parts are added in place."""

    inner: Float[Tensor, "time reach_and_one n n"]
    """[t, k]: the block A_(t, t + k)."""
    border: Float[Tensor, "time n m"]
    """B_t."""
    corner: Float[Tensor, "m m"]
    """C."""

    @classmethod
    def zero(cls, time: int, reach: int, n: int, m: int, like: Tensor) -> "Banded":
        """A matrix of zeros."""
        return cls(
            like.new_zeros(time, reach + 1, n, n), like.new_zeros(time, n, m), like.new_zeros(m, m)
        )

    @property
    def reach(self) -> int:
        """Moments up to so far apart couple."""
        return self.inner.shape[1] - 1

    def add_products(
        self,
        coefficients: Float[Tensor, "time some rows"],
        jacobian: Float[Tensor, "time rows n"],
        shaped: Float[Tensor, "time rows m"],
    ) -> None:
        """Add the curvature of ½ Σ c_(t, k) r_t r_(t + k) (twice for k > 0), row by row.

        Args:
            coefficients: c, for k from 0 on.
            jacobian: derivative of the residuals r_t by the variables of the moment t.
            shaped: by those of the border.
        """
        time = len(jacobian)
        for k in range(min(coefficients.shape[1], time)):
            here, ahead = slice(0, time - k), slice(k, time)
            weighted = coefficients[here, k, :, None] * jacobian[ahead]
            self.inner[here, k] += jacobian[here].mT @ weighted
            if shaped.shape[-1] == 0:
                continue
            self.border[ahead] += weighted.mT @ shaped[here]
            edge = coefficients[here, k, :, None] * shaped[ahead]
            corner = shaped[here].flatten(0, 1).mT @ edge.flatten(0, 1)
            self.corner.add_(corner)
            if k > 0:
                self.border[here] += jacobian[here].mT @ edge
                self.corner.add_(corner.mT)


def add_differences(
    coefficients: Float[Tensor, "time some rows"],
    stencil: tuple[float, ...],
    weight: Float[Tensor, "steps some_or_all_rows"],
) -> None:
    """Add ½ Σ_t weight_t (Σ_s stencil_s r_(t + s))² to coefficients of `add_products`."""
    steps = len(coefficients) - len(stencil) + 1
    if steps <= 0:
        return
    for a, left in enumerate(stencil):
        for b in range(a, len(stencil)):
            coefficients[a : a + steps, b - a] += left * stencil[b] * weight


class NotPositiveDefinite(ArithmeticError):
    """A matrix has no Cholesky factor in single precision, or numbers that are not finite."""


class Factor:
    """The Cholesky factor of a matrix, H = L Lᵀ.

    With x = L⁻ᵀ u the quadratic ½ xᵀ H x is ½ |u|²: in the variables u all directions are equally
    stiff. As many moments as the matrix reaches are a block, so that only neighbouring blocks
    couple. Variables are scaled so that the diagonal is one, for single precision to suffice.
    """

    def __init__(self, matrix: Banded, damping: float = 0.0) -> None:
        """Factorise.

        Args:
            matrix: the matrix.
            damping: share that its diagonal is raised by.

        Raises:
            NotPositiveDefinite: when it has no factor.
        """
        self._time, self._reach = matrix.inner.shape[0], max(matrix.reach, 1)
        self._scale = _inverse_roots(matrix.inner[:, 0])
        self._edge_scale = _inverse_roots(matrix.corner)
        own, beside = _blocks(matrix.inner, self._scale, self._reach)
        border = matrix.border * self._scale[..., None] * self._edge_scale
        missing = len(own) * self._reach - self._time
        border = pad(border, (0, 0, 0, 0, 0, missing)).reshape(*own.shape[:2], -1)
        corner = matrix.corner * self._edge_scale[:, None] * self._edge_scale
        own.diagonal(dim1=-2, dim2=-1).fill_(1.0 + damping + _MIN_DIAGONAL_RAISE)
        corner.diagonal().fill_(1.0 + damping + _MIN_DIAGONAL_RAISE)
        identity = torch.eye(own.shape[-1], dtype=own.dtype, device=own.device)
        self._within: list[Tensor] = []
        self._across: list[Tensor] = []
        gathered: list[Tensor] = []
        failures: list[Tensor] = []
        for i, block in enumerate(own):
            side = border[i]
            if i > 0:
                before = self._across[-1]
                block = torch.addmm(block, before.T, before, alpha=-1)
                side = torch.addmm(side, before.T, gathered[-1], alpha=-1)
            factor, failed = torch.linalg.cholesky_ex(block)
            failures.append(failed)
            # the inverse of a triangular block makes every later substitution one product
            within = torch.linalg.solve_triangular(factor, identity, upper=False)
            self._within.append(within)
            gathered.append(within @ side)
            if i < len(beside):
                self._across.append(within @ beside[i])
        self._border = torch.cat(gathered)
        rest, failed = torch.linalg.cholesky_ex(corner - self._border.T @ self._border)
        if bool(torch.stack((*failures, failed)).any() | ~self._border.isfinite().all()):
            raise NotPositiveDefinite("the matrix is not positive definite; raise its diagonal")
        small = torch.eye(len(corner), dtype=own.dtype, device=own.device)
        self._corner = torch.linalg.solve_triangular(rest, small, upper=False)

    def down(
        self, inner: Float[Tensor, "time n"], border: Float[Tensor, " m"]
    ) -> tuple[Float[Tensor, "time n"], Float[Tensor, " m"]]:
        """L⁻¹ g, which turns a gradient by x into one by u."""
        right = self._split(inner * self._scale)
        found = [self._within[0].mv(right[0])]
        for i, across in enumerate(self._across):
            found.append(self._within[i + 1].mv(right[i + 1].addmv(across.T, found[-1], alpha=-1)))
        whole = torch.cat(found)
        edge = self._corner.mv((border * self._edge_scale).addmv(self._border.T, whole, alpha=-1))
        return self._joined(whole, inner), edge

    def up(
        self, inner: Float[Tensor, "time n"], border: Float[Tensor, " m"]
    ) -> tuple[Float[Tensor, "time n"], Float[Tensor, " m"]]:
        """L⁻ᵀ u, which turns a step of u into one of x."""
        edge = self._corner.T.mv(border)
        blocks = self._split(inner)
        right = (blocks.flatten().addmv(self._border, edge, alpha=-1)).view_as(blocks)
        found = [self._within[-1].T.mv(right[-1])]
        for i in range(len(self._across) - 1, -1, -1):
            found.append(
                self._within[i].T.mv(right[i].addmv(self._across[i], found[-1], alpha=-1))
            )
        return self._joined(torch.cat(found[::-1]), inner) * self._scale, edge * self._edge_scale

    def _split(self, inner: Float[Tensor, "time n"]) -> Float[Tensor, "blocks size"]:
        missing = len(self._within) * self._reach - self._time
        return pad(inner, (0, 0, 0, missing)).reshape(len(self._within), -1)

    def _joined(self, whole: Float[Tensor, " numbers"], like: Tensor) -> Float[Tensor, "time n"]:
        return whole.view(-1, like.shape[-1])[: self._time]


def _inverse_roots(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n"]:
    """One over the roots of the diagonal; one where nothing holds a variable."""
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    return torch.where(diagonal > 0, diagonal, 1.0).rsqrt()


def _blocks(
    inner: Float[Tensor, "time reach_and_one n n"], scale: Float[Tensor, "time n"], reach: int
) -> tuple[Float[Tensor, "blocks size size"], Float[Tensor, "between size size"]]:
    """Scaled diagonal blocks of some moments, and those beside them."""
    time, _, n, _ = inner.shape
    count = -(-time // reach)
    own = inner.new_zeros(count, reach, n, reach, n)
    beside = inner.new_zeros(max(count - 1, 0), reach, n, reach, n)
    for k in range(min(inner.shape[1], time)):
        scaled = inner[: time - k, k] * scale[: time - k, :, None] * scale[k:, None, :]
        for a in range(reach):
            part = scaled[a::reach]
            if a + k < reach:
                own[: len(part), a, :, a + k] = part
                own[: len(part), a + k, :, a] = part.mT
            else:
                beside[: len(part), a, :, a + k - reach] = part
    size = reach * n
    return own.reshape(count, size, size), beside.reshape(-1, size, size)
