"""Levenberg-Marquardt for sequences of frames that are weakly tied to their neighbours.

Every frame has variables and an energy of its own; ties between neighbours are quadratic. All
frames step at once, by the solution of one banded system, but each frame has its own damping,
makes no step that would raise its energy, and ends when it has converged. A frame's Hessian is
kept as long as steps with it shrink fast. `recon.solver.gauss_newton`, in contrast, damps a whole
sequence and computes all Hessians in every iteration.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.struct import S

_FIRST_RAISE = 1e-3
"""Damping of a frame after its undamped step was rejected."""
_RAISE, _LOWER = 10.0, 0.1
_MAX_DAMPING = 1e6
"""Damping at which a frame ends, since no step lowers its energy."""
_SHRINKS = 0.1
"""Largest ratio of a predicted decrease to the one before at which a Hessian is kept."""
_ROUNDING = 8.0
"""Relative rise of an energy, in units of the last place, that counts as rounding."""
_MAX_EXCESS_SHARE = 0.9
"""Largest excess of an energy over its prediction, over a step's size, to accept the step."""
_CHUNK_FRAMES = 128
"""Number of frames whose Hessians are computed together, so that their data fit in the cache."""


class TiedFrames(ABC, Generic[S]):
    """The energies of a sequence of frames, and of ties between neighbouring frames."""

    linked: Bool[Tensor, " between"]
    """Whether a frame is tied to the next one."""

    @property
    @abstractmethod
    def tie_stiffness(self) -> Float[Tensor, " n"]:
        """Second derivatives (diagonal) of a tie by the variables of one of its two frames."""

    @abstractmethod
    def energies_and_gradients(
        self, state: S, rows: Int[Tensor, " rows"]
    ) -> tuple[Float[Tensor, " rows"], Float[Tensor, "rows n"]]:
        """Return the energies of some frames, without ties, and gradients by their variables."""

    @abstractmethod
    def curvature(self, state: S, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows n n"]:
        """Return the Gauss-Newton Hessians of some frames, without ties; positive semidefinite."""

    @abstractmethod
    def can_share_hessian(
        self, some: Int[Tensor, " rows"], others: Int[Tensor, " rows"]
    ) -> Bool[Tensor, " rows"]:
        """Return which pairs of frames have the same kind of data, so can share a Hessian."""

    @abstractmethod
    def tie_energies(
        self, state: S
    ) -> tuple[Float[Tensor, " between"], Float[Tensor, "frames n"]]:
        """Return the energies of the ties between neighbouring frames, and their gradients."""

    @abstractmethod
    def moved(self, state: S, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]) -> S:
        """Return the state of all frames after steps in some of them."""


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Settings of `minimise_frames`: limits, tolerances and damping."""

    max_iterations: int = 50
    """Largest number of iterations; frames usually end by tolerance."""
    tolerance: float = 1e-4
    """A frame has converged when the predicted and the actual decrease of its energy in a step are
    below this share of it."""
    floor: float = 0.0
    """Least energy to which a frame's decrease is related."""
    damping: float = 0.0
    """Share of the Hessian's diagonal that is added to it at first."""
    stride: int = 1
    """Number of neighbouring frames that share one Hessian at first."""
    inner_tolerance: float = 0.1
    """Relative residual at which the linear solver of a step ends."""
    inner_iterations: int = 8


@dataclass(frozen=True)
class MinimisedFrames(Generic[S]):
    """The state of all frames after a minimisation, with their energies."""

    state: S
    value: Float[Tensor, " frames"]
    """Energies of the frames without ties."""
    between: Float[Tensor, " between"]
    """Energies of the ties between neighbouring frames."""
    converged: Bool[Tensor, " frames"]
    """Whether each frame ended by tolerance."""
    iterations: int
    curvatures: int
    """Number of Hessians computed, over all frames and iterations."""

    @property
    def total(self) -> float:
        """Sum of the energies of all frames and ties."""
        return float(self.value.double().sum() + self.between.double().sum())


def minimise_frames(
    energies: TiedFrames[S],
    state: S,
    settings: LevenbergMarquardt,
    rows: Int[Tensor, " rows"] | None = None,
) -> MinimisedFrames[S]:
    """Minimise the energies of frames and of ties between them; their sum never rises.

    Args:
        energies: energies of the frames and ties.
        state: first guess.
        settings: settings of the minimisation.
        rows: frames that move, ascending; others stay as they are. None moves all.
    """
    count = len(energies.linked) + 1
    every = torch.arange(count)
    rows = every if rows is None else rows
    value, gradient = energies.energies_and_gradients(state, every)
    between, pull = energies.tie_energies(state)
    curvatures = _HessianFactors.empty(gradient)
    damping = torch.full_like(value, settings.damping)
    promised = torch.full_like(value, torch.inf)
    rounding = _ROUNDING * torch.finfo(value.dtype).eps
    moves = torch.zeros(count, dtype=torch.bool)
    moves[rows] = True
    converged = ~moves
    curvatures.recompute(energies, state, rows, damping, settings.stride)
    iterations = 0
    while len(rows) > 0 and iterations < settings.max_iterations:
        iterations += 1
        down = -(gradient[rows] + pull[rows])
        ties = Ties(energies.tie_stiffness, (rows.diff() == 1) & energies.linked[rows[:-1]])
        steps = solve_tied(
            curvatures.of_frames(rows),
            ties,
            down,
            tolerance=settings.inner_tolerance,
            iterations=settings.inner_iterations,
        )
        promise = 0.5 * (down * steps).sum(-1)
        scale = (value[rows] + _half_of_adjacent_ties(between)[rows]).clamp(min=settings.floor)
        tried = energies.moved(state, rows, steps)
        values, slopes = energies.energies_and_gradients(tried, rows)
        ends, pulls = energies.tie_energies(tried)
        # a frame's step is judged as if its neighbours, to which it is tied, did not move
        times_vector = pull[rows] + energies.tie_stiffness * steps - 0.5 * ties.times_vector(steps)
        change = values - value[rows] + (times_vector * steps).sum(-1)
        good = change <= rounding * scale  # false where `change` is NaN
        rising = (change > rounding * scale).nonzero()[:, 0]
        size = curvatures.half_squared_length(rows[rising], steps[rising])
        good[rising] = change[rising] + promise[rising] <= _MAX_EXCESS_SHARE * size
        if not bool(good.all()):
            # move accepted frames only: ties to rejected ones, which stay, have other energies
            tried = energies.moved(state, rows[good], steps[good])
            ends, pulls = energies.tie_energies(tried)
            rise = (values - value[rows])[good].sum() + (ends - between).sum()
            if not float(rise) <= rounding * float(scale.sum()):
                good = torch.zeros_like(good)
        if bool(good.any()):
            state, between, pull = tried, ends, pulls
            value[rows[good]], gradient[rows[good]] = values[good], slopes[good]
        few = settings.tolerance * scale
        converged[rows] = good & (promise.abs() <= few) & (change.abs() <= few)
        promise = promise.abs()
        worn = ~good | (promise > _SHRINKS * promised[rows])
        promised[rows] = promise.where(good, torch.inf)
        bad, eased = rows[~good], rows[good & worn]
        damping[bad] = (_RAISE * damping[bad]).clamp(min=_FIRST_RAISE, max=_MAX_DAMPING)
        damping[eased] = _LOWER * damping[eased]
        worn = rows[worn]
        rows = moves & _with_tied_neighbours(
            ~converged & (damping < _MAX_DAMPING), energies.linked
        )
        rows = rows.nonzero()[:, 0]
        curvatures.recompute(energies, state, worn[torch.isin(worn, rows)], damping, 1)
    return MinimisedFrames(state, value, between, converged, iterations, curvatures.count)


@dataclass
class _HessianFactors:
    """Cholesky factors of the frames' damped Hessians, with the ties' diagonal blocks."""

    factors: Float[Tensor, "frames n n"]
    owner: Int[Tensor, " frames"]
    """Number of the frame whose factor each frame uses."""
    count: int
    """Number of Hessians computed so far."""

    @classmethod
    def empty(cls, gradient: Float[Tensor, "frames n"]) -> "_HessianFactors":
        """Return a store for the factors of all frames, none of which is computed yet."""
        frames, size = gradient.shape
        return cls(gradient.new_zeros(frames, size, size), torch.arange(frames), 0)

    def of_frames(self, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows n n"]:
        """Return the Cholesky factors of the damped Hessians of some frames."""
        return self.factors[self.owner[rows]]

    def half_squared_length(
        self, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> Float[Tensor, " rows"]:
        """Return half of each step's squared length in the metric of its frame's Hessian."""
        return 0.5 * (self.of_frames(rows).mT @ steps[..., None]).square().sum((1, 2))

    def recompute(
        self,
        energies: TiedFrames[S],
        state: S,
        rows: Int[Tensor, " rows"],
        damping: Float[Tensor, " frames"],
        stride: int,
    ) -> None:
        """Compute the factors of some frames anew; up to `stride` similar frames share one."""
        middle = (rows // stride * stride + stride // 2).clamp(max=len(self.owner) - 1)
        self.owner[rows] = middle.where(energies.can_share_hessian(rows, middle), rows)
        for some in self.owner[rows].unique().split(_CHUNK_FRAMES):
            curvature = energies.curvature(state, some)
            diagonal = curvature.diagonal(dim1=1, dim2=2)
            diagonal += 2 * energies.tie_stiffness
            diagonal *= 1 + damping[some, None]
            self.factors[some] = torch.linalg.cholesky_ex(curvature).L
            self.count += len(some)


def _with_tied_neighbours(
    flags: Bool[Tensor, " frames"], linked: Bool[Tensor, " between"]
) -> Bool[Tensor, " frames"]:
    """Return flags that are true also for the frames that are tied to a flagged one."""
    found = flags.clone()
    found[1:] |= flags[:-1] & linked
    found[:-1] |= flags[1:] & linked
    return found


def _half_of_adjacent_ties(between: Float[Tensor, " between"]) -> Float[Tensor, " frames"]:
    """Return half of the energies of the ties on both sides of every frame."""
    ends = torch.nn.functional.pad(0.5 * between, (1, 1))
    return ends[1:] + ends[:-1]


@dataclass(frozen=True)
class Ties:
    """Off-diagonal blocks -l_i T of the Hessian, from ties between neighbouring frames."""

    stiffness: Float[Tensor, " n"]
    """Diagonal of T."""
    linked: Bool[Tensor, " between"]
    """l_i: whether block i is tied to block i + 1; one fewer than blocks."""

    def times_vector(self, x: Float[Tensor, "blocks n"]) -> Float[Tensor, "blocks n"]:
        """Return the product of minus these blocks with x: T (l_i x_(i+1) + l_(i-1) x_(i-1))."""
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
    """Solve the linear system of blocks and ties by block-preconditioned conjugate gradients.

    The product of a block with a direction follows from the recurrence of the directions, so that
    only the factors are needed.

    Args:
        factors: lower Cholesky factors of the diagonal blocks.
        ties: off-diagonal blocks; the whole matrix must be positive definite.
        right: right side.
        tolerance: of the residual's norm in the inverse of the blocks, relative to the first one.
        iterations: largest number of iterations; at 0 the ties are left out.
    """
    x = _solved_blocks(factors, right)
    if iterations == 0 or not bool(ties.linked.any() & (ties.stiffness > 0).any()):
        return x
    # x solves A x = b without the ties T: the residual of the whole system, b - (A - T) x, is T x
    residual = ties.times_vector(x)
    target = tolerance**2 * float((right * x).sum())
    direction, product = torch.zeros_like(x), torch.zeros_like(x)
    before = 1.0
    for _ in range(iterations):
        z = _solved_blocks(factors, residual)
        size = float((residual * z).sum())
        if not size > target:
            break
        share = size / before
        direction = z + share * direction
        product = residual + share * product
        bent = product - ties.times_vector(direction)
        curvature = float((direction * bent).sum())
        if not curvature > 0:
            break
        length = size / curvature
        x = x + length * direction
        residual = residual - length * bent
        before = size
    return x


def _solved_blocks(
    factors: Float[Tensor, "blocks n n"], right: Float[Tensor, "blocks n"]
) -> Float[Tensor, "blocks n"]:
    # two triangular solves: several times faster than cholesky_solve for single columns
    half = torch.linalg.solve_triangular(factors, right[..., None], upper=False)
    return torch.linalg.solve_triangular(factors.mT, half, upper=True)[..., 0]
