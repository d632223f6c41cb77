"""Symmetric positive definite matrices of time series: a band about the diagonal, and a border.

    H = [[A, B], [Bᵀ, C]],   A_(t, t + k) = 0 for k beyond the reach

Frames of a series couple with a few neighbours, and a few variables, such as the shape of a body,
belong to all frames. A vector beside H has the variables of the first frame, of the second, and so
on, and those of the border last: time · n + m numbers.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

_ROUNDING = 8.0
"""Share, in units of the last place, that every diagonal is raised by at least."""


@dataclass(frozen=True)
class Banded:
    """A symmetric block-banded matrix with a border, as its blocks; `add_*` works in place."""

    inner: Float[Tensor, "time reach_and_one n n"]
    """[t, k]: the block A_(t, t + k)."""
    border: Float[Tensor, "time n m"]
    """B_t: the block of frame t by the border."""
    corner: Float[Tensor, "m m"]
    """C: the block of the border alone."""

    @classmethod
    def zero(cls, time: int, reach: int, n: int, m: int, like: Tensor) -> "Banded":
        """Make a zero matrix with n variables in each of `time` frames and m in the border."""
        return cls(
            like.new_zeros(time, reach + 1, n, n), like.new_zeros(time, n, m), like.new_zeros(m, m)
        )

    @classmethod
    def dense(cls, matrix: Float[Tensor, "m m"]) -> "Banded":
        """Wrap a dense matrix as the border's block C, without any frames."""
        empty = matrix.new_zeros(0, 1, 0, 0)
        return cls(empty, matrix.new_zeros(0, 0, len(matrix)), matrix)

    @property
    def reach(self) -> int:
        """Largest number of frames between two frames that are coupled."""
        return self.inner.shape[1] - 1

    def add_frames(
        self, frame: Int[Tensor, " some"], curvature: Float[Tensor, "some n_and_m n_and_m"]
    ) -> None:
        """Add, for given frames, Hessians by the variables of that frame and of the border."""
        n = self.inner.shape[-1]
        self.inner[:, 0].index_add_(0, frame, curvature[:, :n, :n])
        self.border.index_add_(0, frame, curvature[:, :n, n:])
        self.corner.add_(curvature[:, n:, n:].sum(0))

    def add_products(
        self,
        coefficients: Float[Tensor, "time some rows"],
        jacobian: Float[Tensor, "time rows n"],
        shaped: Float[Tensor, "time rows m"],
    ) -> None:
        """Add the curvature of ½ Σ c_(t, k) r_t r_(t + k), where products with k > 0 count twice.

        Args:
            coefficients: c, for k from 0 on.
            jacobian: derivative of the residuals r_t by the variables of frame t.
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
    """Add ½ Σ_t weight_t (Σ_s stencil_s r_(t + s))² to the coefficients c of `add_products`."""
    steps = len(coefficients) - len(stencil) + 1
    if steps <= 0:
        return
    for a, left in enumerate(stencil):
        for b in range(a, len(stencil)):
            coefficients[a : a + steps, b - a] += left * stencil[b] * weight


@dataclass(frozen=True)
class Inverse:
    """Blocks of H⁻¹ that give the marginal covariances of every frame and of the border.

    With S = C - Bᵀ A⁻¹ B, the covariance of the border is S⁻¹ and that of frame t is
    (A⁻¹)_tt + X_t S⁻¹ X_tᵀ, where X = A⁻¹ B; both covary by -X_t S⁻¹.
    """

    within: Float[Tensor, "time n n"]
    """(A⁻¹)_tt: the block of frame t if the border is fixed."""
    onto: Float[Tensor, "time n m"]
    """X_t = (A⁻¹ B)_t: how frame t follows the border."""
    border: Float[Tensor, "m m"]
    """S⁻¹ = (C - Bᵀ A⁻¹ B)⁻¹: the covariance of the border."""


class Factor:
    """The Cholesky factor L of a banded matrix with a border, H = L Lᵀ; solves and inverts.

    With x = L⁻ᵀ u the quadratic ½ xᵀ H x is ½ |u|²: in the variables u all directions are equally
    stiff. As many frames as the matrix reaches are a block, so that only neighbouring blocks
    couple; frames that do not couple are factorised all at once. Variables are scaled so that the
    diagonal is one, for single precision to suffice.
    """

    definite: bool
    """Whether H is positive definite in its precision, all of it finite; if not, no other result
    means anything."""

    def __init__(self, matrix: Banded, damping: float = 0.0) -> None:
        """Factorise.

        Args:
            matrix: the matrix.
            damping: share that its diagonal is raised by.
        """
        self._frames = matrix.inner.shape[0], matrix.inner.shape[-1]
        self._reach = max(matrix.reach, 1)
        self._scale = _inverse_roots(matrix.inner[:, 0])
        self._edge_scale = _inverse_roots(matrix.corner)
        raised = 1.0 + damping + _ROUNDING * torch.finfo(matrix.corner.dtype).eps
        own, beside = _scaled_blocks(matrix, self._scale)
        self._shape = own.shape[:-1]
        border = self._in_blocks(matrix.border * self._scale[..., None] * self._edge_scale)
        corner = matrix.corner * self._edge_scale[:, None] * self._edge_scale
        own.diagonal(dim1=-2, dim2=-1).fill_(raised)
        corner.diagonal().fill_(raised)
        self._within: list[Tensor] = []
        """Lower triangles L_ii."""
        self._across: list[Tensor] = []
        """L_ii⁻¹ U_i, with U_i the block beside the diagonal."""
        self._gathered: list[Tensor] = []
        """Rows of L_AA⁻¹ B."""
        failures: list[Tensor] = []
        for i, block in enumerate(own):
            side = border[i]
            if i > 0:
                before = self._across[-1]
                block = torch.addmm(block, before.T, before, alpha=-1)
                side = torch.addmm(side, before.T, self._gathered[-1], alpha=-1)
            factor, failed = torch.linalg.cholesky_ex(block)
            failures.append(failed.flatten())
            self._within.append(factor)
            if i < len(beside):
                both = _lower_solution(factor, torch.cat((beside[i], side), -1))
                self._across.append(both[:, : len(factor)])
                self._gathered.append(both[:, len(factor) :])
            else:
                self._gathered.append(_lower_solution(factor, side))
        self._border = torch.cat(self._gathered).flatten(0, -2)
        rest, failed = torch.linalg.cholesky_ex(corner - self._border.T @ self._border)
        bad = torch.cat((*failures, failed[None])).any() | ~self._border.isfinite().all()
        self.definite = not bool(bad)
        self._corner = _lower_solution(
            rest, torch.eye(len(corner), dtype=own.dtype, device=own.device)
        )

    def solve(self, right: Float[Tensor, " numbers"]) -> Float[Tensor, " numbers"]:
        """H⁻¹ r."""
        return self.solve_upper(self.solve_lower(right))

    def solve_lower(self, gradient: Float[Tensor, " numbers"]) -> Float[Tensor, " numbers"]:
        """L⁻¹ g: the gradient by x becomes the gradient by the whitened variables u = Lᵀ x."""
        frames, edge = self._frames_and_border(gradient)
        right = self._in_blocks(frames[..., None] * self._scale[..., None])
        found: list[Tensor] = []
        for i, within in enumerate(self._within):
            here = right[i]
            if i > 0:
                here = torch.addmm(here, self._across[i - 1].T, found[-1], alpha=-1)
            found.append(_lower_solution(within, here))
        whole = torch.cat(found).flatten()
        edge = self._corner.mv((edge * self._edge_scale).addmv(self._border.T, whole, alpha=-1))
        return torch.cat((whole[: frames.numel()], edge))

    def solve_upper(self, u: Float[Tensor, " numbers"]) -> Float[Tensor, " numbers"]:
        """L⁻ᵀ u: a step of the whitened variables u = Lᵀ x becomes a step of x."""
        frames, edge = self._frames_and_border(u)
        edge = self._corner.T.mv(edge)
        right = self._in_blocks(frames[..., None])
        right = right - (self._border.mv(edge)).view_as(right)
        found = self._back_substituted(list(right))
        scaled = found.flatten()[: frames.numel()].view_as(frames) * self._scale
        return torch.cat((scaled.flatten(), edge * self._edge_scale))

    def inverse(self) -> Inverse:
        """Diagonal blocks of the inverse, in time and memory linear in the number of frames.

        From the last block i back, with D_i⁻¹ the inverse that elimination leaves and
        W_i = D_i⁻¹ U_i, (A⁻¹)_ii = D_i⁻¹ + W_i (A⁻¹)_(i+1, i+1) W_iᵀ (Takahashi, Fagan and Chin
        1973; for Gaussian chains Rauch, Tung and Striebel 1965).
        """
        time, n = self._frames
        inverses = [torch.cholesky_inverse(self._within[-1])]
        for within, across in zip(self._within[-2::-1], self._across[::-1], strict=True):
            ahead, own = _upper_solution(within, across), torch.cholesky_inverse(within)
            inverses.append(torch.addmm(own, ahead @ inverses[-1], ahead.mT))
        blocks = torch.stack(inverses[::-1]).flatten(0, -3)
        blocks = blocks.unflatten(-1, (self._reach, n)).unflatten(-3, (self._reach, n))
        own = blocks.diagonal(dim1=1, dim2=3).movedim(-1, 1).flatten(0, 1)[:time]
        onto = self._back_substituted(self._gathered).flatten(0, -2)[: time * n]
        onto = onto.view(time, n, len(self._corner))
        scale = self._scale[..., None]
        return Inverse(
            within=own * scale * scale.mT,
            onto=onto * scale / self._edge_scale,
            border=self._corner.mT @ self._corner * self._edge_scale[:, None] * self._edge_scale,
        )

    def _back_substituted(self, right: list[Tensor]) -> Float[Tensor, "blocks *some columns"]:
        """Solve L_AAᵀ x = r for the frames' (scaled) variables by back-substitution."""
        found = [_upper_solution(self._within[-1], right[-1])]
        for i in range(len(self._across) - 1, -1, -1):
            here = torch.addmm(right[i], self._across[i], found[-1], alpha=-1)
            found.append(_upper_solution(self._within[i], here))
        return torch.stack(found[::-1])

    def _frames_and_border(
        self, numbers: Float[Tensor, " numbers"]
    ) -> tuple[Float[Tensor, "time n"], Float[Tensor, " m"]]:
        """Split a vector into the variables of the frames and those of the border."""
        time, n = self._frames
        return numbers[: time * n].view(time, n), numbers[time * n :]

    def _in_blocks(
        self, frames: Float[Tensor, "time n k"]
    ) -> Float[Tensor, "blocks *some size k"]:
        """Group the rows of frames into blocks of several frames, padded with zeros at the end."""
        time, n = self._frames
        missing = math.prod(self._shape) - time * n
        return pad(frames.flatten(0, 1), (0, 0, 0, missing)).view(*self._shape, frames.shape[-1])


def _lower_solution(
    lower: Float[Tensor, "*some size size"], right: Float[Tensor, "*some size columns"]
) -> Float[Tensor, "*some size columns"]:
    # solving from the right takes half the time for many columns in single precision
    return torch.linalg.solve_triangular(lower.mT, right.mT, upper=True, left=False).mT


def _upper_solution(
    lower: Float[Tensor, "*some size size"], right: Float[Tensor, "*some size columns"]
) -> Float[Tensor, "*some size columns"]:
    return torch.linalg.solve_triangular(lower.mT, right, upper=True)


def _inverse_roots(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n"]:
    """Return 1 / sqrt of the diagonals, with 1 where a diagonal element is not positive."""
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    return torch.where(diagonal > 0, diagonal, 1.0).rsqrt()


def _scaled_blocks(
    matrix: Banded, scale: Float[Tensor, "time n"]
) -> tuple[Float[Tensor, "blocks *some size size"], Float[Tensor, "between size size"]]:
    """Return the scaled matrix as diagonal blocks of `reach` frames, and their couplings."""
    inner, reach = matrix.inner, matrix.reach
    time, _, n, _ = inner.shape
    if reach == 0:
        return (inner[:, 0] * scale[..., None] * scale[:, None])[None], inner[:0, 0]
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
