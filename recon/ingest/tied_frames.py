"""Levenberg-Marquardt for sequences of frames that are weakly tied to their neighbours.

Every frame has variables and an energy of its own; ties between neighbours are springs. All
frames step at once, by the solution of one banded system, but each frame has its own damping, is
refused its step where that would raise its energy, and leaves when it has converged. A curvature
is kept as long as the steps that are made with it shrink well. `recon.solver.gauss_newton` damps a
whole sequence and computes all of its curvature in every iteration.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.core.struct import S

_FIRST_RAISE = 1e-3
"""Damping of a frame whose undamped step was refused."""
_RAISE, _LOWER = 10.0, 0.1
_MAX_DAMPING = 1e6
"""Damping beyond which a frame is taken to be as good as it gets."""
_SHRINKS = 0.1
"""Share of the last predicted decrease that the next one may be while a curvature is kept."""
_ROUNDING = 8.0
"""Relative rise of an energy, in units of the last place, that is taken for none."""
_MAX_EXCESS_SHARE = 0.9
"""Share of a step's size in the model by which a frame's energy may exceed what was foreseen."""
_CHUNK_FRAMES = 128
"""Frames whose curvatures are computed together: what they need stays in the cache."""


class TiedFrames(ABC, Generic[S]):
    """The energies of a sequence of frames, and of ties between neighbouring frames."""

    linked: Bool[Tensor, " between"]
    """Whether a frame is tied to the next one."""

    @property
    @abstractmethod
    def stiffness(self) -> Float[Tensor, " n"]:
        """Second derivatives of a tie by the variables of one of its frames."""

    @abstractmethod
    def energies_and_gradients(
        self, state: S, rows: Int[Tensor, " rows"]
    ) -> tuple[Float[Tensor, " rows"], Float[Tensor, "rows n"]]:
        """Energies of some frames without ties, and their gradients by each frame's variables."""

    @abstractmethod
    def curvature(self, state: S, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows n n"]:
        """Gauss-Newton Hessians of some frames without ties; positive semidefinite."""

    @abstractmethod
    def share_data_kind(
        self, some: Int[Tensor, " rows"], others: Int[Tensor, " rows"]
    ) -> Bool[Tensor, " rows"]:
        """Mask of pairs of frames with the same kind of data, which can share a Hessian."""

    @abstractmethod
    def tie_energies(
        self, state: S
    ) -> tuple[Float[Tensor, " between"], Float[Tensor, "frames n"]]:
        """Energies of the ties between neighbouring frames, and their gradients."""

    @abstractmethod
    def moved(self, state: S, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]) -> S:
        """The state after steps of some frames."""


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Settings of `minimise_frames`: limits, tolerances and damping."""

    max_iterations: int = 50
    """A safety net: frames end by tolerance."""
    tolerance: float = 1e-4
    """A frame has converged when its step promises, and brings, less than this share of its
    energy."""
    floor: float = 0.0
    """Energy of a frame below which decreases count as if it were this large."""
    damping: float = 0.0
    """Share of the diagonal that it is raised by at first."""
    stride: int = 1
    """Frames of such a run share one curvature until that turns out not to do."""
    inner_tolerance: float = 0.1
    """Relative residual of a step's equations."""
    inner_iterations: int = 8


@dataclass(frozen=True)
class MinimisedFrames(Generic[S]):
    """The frames after a minimisation, with their energies."""

    state: S
    value: Float[Tensor, " frames"]
    """Energies of the frames without ties."""
    between: Float[Tensor, " between"]
    """Energies of the ties."""
    converged: Bool[Tensor, " frames"]
    """Whether a frame ended by tolerance."""
    iterations: int
    curvatures: int
    """Curvatures computed, over all frames and iterations."""

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
        energies: of the frames.
        state: where to begin.
        settings: of the minimisation.
        rows: frames that move, ascending; others stay where they are. None moves all.
    """
    count = len(energies.linked) + 1
    every = torch.arange(count)
    rows = every if rows is None else rows
    value, gradient = energies.energies_and_gradients(state, every)
    between, pull = energies.tie_energies(state)
    curvatures = _HessianFactors.none(gradient)
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
        ties = Ties(energies.stiffness, (rows.diff() == 1) & energies.linked[rows[:-1]])
        steps = solve_tied(
            curvatures.of(rows),
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
        times_vector = pull[rows] + energies.stiffness * steps - 0.5 * ties.times_vector(steps)
        change = values - value[rows] + (times_vector * steps).sum(-1)
        good = change <= rounding * scale  # false where `change` is NaN
        rising = (change > rounding * scale).nonzero()[:, 0]
        size = curvatures.size(rows[rising], steps[rising])
        good[rising] = change[rising] + promise[rising] <= _MAX_EXCESS_SHARE * size
        if not bool(good.all()):
            # rejected frames keep their state, which changes the ties of their neighbours
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
    """Cholesky factors of the frames' damped Hessians, ties included."""

    factors: Float[Tensor, "frames n n"]
    owner: Int[Tensor, " frames"]
    """The frame whose factor a frame uses."""
    count: int
    """Curvatures computed so far."""

    @classmethod
    def none(cls, gradient: Float[Tensor, "frames n"]) -> "_HessianFactors":
        """An empty store for the factors of all frames."""
        frames, size = gradient.shape
        return cls(gradient.new_zeros(frames, size, size), torch.arange(frames), 0)

    def of(self, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows n n"]:
        """Cholesky factors of the damped Hessians of some frames."""
        return self.factors[self.owner[rows]]

    def size(
        self, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> Float[Tensor, " rows"]:
        """Half of each step's squared length in the metric of its frame's Hessian."""
        return 0.5 * (self.of(rows).mT @ steps[..., None]).square().sum((1, 2))

    def recompute(
        self,
        energies: TiedFrames[S],
        state: S,
        rows: Int[Tensor, " rows"],
        damping: Float[Tensor, " frames"],
        stride: int,
    ) -> None:
        """Recompute the factors of some frames; up to `stride` similar frames share one."""
        middle = (rows // stride * stride + stride // 2).clamp(max=len(self.owner) - 1)
        self.owner[rows] = middle.where(energies.share_data_kind(rows, middle), rows)
        for some in self.owner[rows].unique().split(_CHUNK_FRAMES):
            curvature = energies.curvature(state, some)
            diagonal = curvature.diagonal(dim1=1, dim2=2)
            diagonal += 2 * energies.stiffness
            diagonal *= 1 + damping[some, None]
            self.factors[some] = torch.linalg.cholesky_ex(curvature).L
            self.count += len(some)


def _with_tied_neighbours(
    flags: Bool[Tensor, " frames"], linked: Bool[Tensor, " between"]
) -> Bool[Tensor, " frames"]:
    """The flags, true also for frames tied to a flagged one."""
    found = flags.clone()
    found[1:] |= flags[:-1] & linked
    found[:-1] |= flags[1:] & linked
    return found


def _half_of_adjacent_ties(between: Float[Tensor, " between"]) -> Float[Tensor, " frames"]:
    """Half of the energies of the ties on both sides of every frame."""
    ends = torch.nn.functional.pad(0.5 * between, (1, 1))
    return ends[1:] + ends[:-1]


@dataclass(frozen=True)
class Ties:
    """Off-diagonal blocks -l_i T of the Hessian, from springs between neighbouring frames."""

    stiffness: Float[Tensor, " n"]
    """Diagonal of T."""
    linked: Bool[Tensor, " between"]
    """l_i: whether block i is tied to block i + 1; one fewer than there are blocks."""

    def times_vector(self, x: Float[Tensor, "blocks n"]) -> Float[Tensor, "blocks n"]:
        """The springs' product with a vector: T (l_i x_(i+1) + l_(i-1) x_(i-1))."""
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
    """Solve the system of blocks and ties by conjugate gradients, preconditioned by blocks.

    The product of a block with a direction follows from the recurrence of the directions, so that
    only the factors are needed.

    Args:
        factors: lower Cholesky factors of the blocks A_i.
        ties: between them; the whole matrix must be positive definite.
        right: r.
        tolerance: of the residual's norm in the inverse of the blocks, relative to the first one.
        iterations: at most so many; without any the ties are left out.
    """
    x = _solved_blocks(factors, right)
    if iterations == 0 or not bool(ties.linked.any() & (ties.stiffness > 0).any()):
        return x
    # x solves the system without ties of neighbouring frames: what it leaves is the ties' force
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
