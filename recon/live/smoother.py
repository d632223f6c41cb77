"""Fixed-lag smoothing: a window of the newest frames, refined with every new frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from observations.moments import Tracker, append_frames, frames_between
from recon.body.derivatives import BonePoints
from recon.live.objective import Equations, Objective, Window
from recon.method.quadratic import FRAME
from recon.solver.banded import Banded
from recon.solver.gauss_newton import GaussNewton, Problem, Quadratic, minimise


@dataclass(frozen=True)
class ShapeKnowledge:
    """What past frames tell of the shape b: the energy ½ bᵀ Λ b - ηᵀ b.

    Λ is `information`, η is `pull`.
    """

    information: Float[Tensor, "shape shape"]
    pull: Float[Tensor, " shape"]
    frames: int
    """Number of frames that it was learned from."""

    @classmethod
    def none(cls, shape: Float[Tensor, " shape"]) -> "ShapeKnowledge":
        """Return knowledge from no frames at all."""
        return cls(shape.new_zeros(len(shape), len(shape)), torch.zeros_like(shape), 0)

    def gradient(self, shape: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
        """Return Λ b - η, the gradient of the energy by the shape."""
        return self.information @ shape - self.pull

    def value(self, shape: Float[Tensor, " shape"]) -> float:
        """The energy."""
        return float(0.5 * shape @ self.information @ shape - self.pull @ shape)

    def with_first_frame(
        self, equations: Equations, shape: Float[Tensor, " shape"], weight: float
    ) -> "ShapeKnowledge":
        """Add what a window's first frame says about the shape, its pose marginalised (Schur).

        Energies between this frame and others are left out, which loses a little information.

        Args:
            equations: of the window, about `shape`.
            shape: shape coefficients of the linearisation.
            weight: of |b|² per frame, the density of shapes.
        """
        border, gradient = equations.border[0], equations.gradient_alone[0]
        factor, failed = torch.linalg.cholesky_ex(equations.alone[0])
        if int(failed) != 0:  # a singular system: the frame had no data and adds no information
            return self
        solved = torch.cholesky_solve(torch.cat((border, gradient[:, None]), -1), factor)
        learned = equations.corner[0] - border.mT @ solved[:, :-1]
        slope = equations.gradient_shape[0] - border.mT @ solved[:, -1]
        if not bool(learned.isfinite().all() & slope.isfinite().all()):
            return self  # no step was taken from these equations
        held = 2 * weight * torch.eye(len(shape), dtype=shape.dtype, device=shape.device)
        return ShapeKnowledge(
            self.information + learned + held, self.pull + learned @ shape - slope, self.frames + 1
        )


_OPTIONS = GaussNewton(max_damping=10.0)
"""Settings of steps, with few tries of a damping, because a push has little time."""
_NEWEST = 6
"""Newest frames that are moved under the pose density alone before a prior over steps takes part;
with 4, errors of streams are 1 % larger; with 10, they are the same (validation people)."""
_SPEED_KEPT = 0.9
"""Share of the last step with which a new frame begins."""


@dataclass(frozen=True)
class SmoothedWindow:
    """A window of frames after a push: motion, data, and what is known of the shape."""

    window: Window
    objective: Objective
    seen: tuple[Tracker, ...]
    """Data of the active frames, the last ones of the window; without an axis of clips."""
    knowledge: ShapeKnowledge
    learning: bool
    """Whether the shape is still moved."""
    equations: Equations | None = None
    """Equations of the last step, from which the shape learns when a frame leaves."""

    @property
    def active_frames(self) -> int:
        """Number of frames that are still optimised."""
        return self.seen[0].moments

    def with_new_frame(
        self, seen: Sequence[Tracker], most: int, learn_shape_until: int
    ) -> "SmoothedWindow":
        """Return the window with a new frame, which replaces the oldest beyond `most` active ones.

        Args:
            seen: data of the new frame.
            most: largest number of active frames.
            learn_shape_until: number of frames after which the shape is held.
        """
        data = tuple(append_frames(a, b) for a, b in zip(self.seen, seen, strict=True))
        window = self.window.extended(_SPEED_KEPT)
        knowledge, learning = self.knowledge, self.learning
        if (count := data[0].moments) > most:
            data = tuple(frames_between(one, count - most, count) for one in data)
            # keep `reach` fixed frames before the window, so that the motion continues smoothly
            window = window[-(most + self.objective.reach) :]
            if learning and self.equations is not None:
                objective = self.objective
                weight = objective.weights.shape * objective.scale_to_30_hz
                knowledge = knowledge.with_first_frame(self.equations, objective.shape, weight)
                learning = knowledge.frames < learn_shape_until
        return replace(
            self, window=window, seen=data, knowledge=knowledge, learning=learning, equations=None
        )

    def refined(self, steps: int) -> "SmoothedWindow":
        """Return the window after at most `steps` damped Gauss-Newton steps."""
        refinement = _WindowProblem()
        options = replace(_OPTIONS, max_iterations=steps)
        found, _ = minimise(refinement, self, options)
        return replace(found, equations=refinement.equations)

    def newest_refined_by_poses(self) -> "SmoothedWindow":
        """Return the window after a step of its newest frames under the pose density alone.

        This brings new frames near the data. A prior over steps does not always: its energy rises
        slowly where a motion is far from those it knows, so that its steps there are poor.
        """
        count = min(_NEWEST, self.active_frames)
        seen = (frames_between(one, one.moments - count, one.moments) for one in self.seen)
        objective = self.objective.by_poses
        # frames before the newest that their accelerations depend on
        start = max(self.window.frames - count - objective.reach, 0)
        newest = replace(
            self, window=self.window[start:], objective=objective, seen=tuple(seen), learning=False
        )
        return replace(self, window=self.window[:start].joined(newest.refined(1).window))

    def value_of_shape(self) -> float:
        """Return the energy of the shape while the shape is learned, else zero."""
        shape = self.objective.shape
        if not self.learning:
            return 0.0
        return self.knowledge.value(shape) + self.shape_weight * float(shape.square().sum())

    @property
    def shape_weight(self) -> float:
        """Weight of |b|², the density of shapes, for all active frames."""
        return self.objective.weights.shape * self.objective.scale_to_30_hz * self.active_frames


class _WindowProblem(Problem[SmoothedWindow]):
    """The minimisation of a window's energy by steps of its active frames and of the shape."""

    equations: Equations | None = None
    """The equations that `model` computed last."""

    def model(self, x: SmoothedWindow, rows: Int[Tensor, " rows"]) -> Quadratic:
        """Return the quadratic model of the energy about the window `x`."""
        found = self.equations = x.objective.equations(x.window, x.seen, x.learning)
        slope, corner = found.gradient_shape.sum(0), found.corner.sum(0)
        if x.learning:
            shape, weight = x.objective.shape, 2 * x.shape_weight
            corner = corner + x.knowledge.information + weight * torch.eye(len(shape)).to(shape)
            slope = slope + x.knowledge.gradient(shape) + weight * shape
        return Quadratic(
            slope.new_tensor([[float(found.value) + x.value_of_shape()]], dtype=torch.float64),
            torch.cat((found.gradient.flatten(), slope))[None],
            [Banded(found.inner, found.border, corner)] * len(rows),
        )

    def moved(
        self, x: SmoothedWindow, rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> SmoothedWindow:
        """Return the window, with its objective's shape, after a step of the unknowns."""
        del rows
        frames, shape = steps[0].tensor_split([x.active_frames * FRAME])
        window = x.window.moved(frames.view(x.active_frames, FRAME))
        objective = x.objective
        if x.learning:
            objective = objective_of_shape(objective, objective.shape + shape, x.seen)
        return replace(x, window=window, objective=objective)

    def value(self, x: SmoothedWindow, rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows 1"]:
        """The energy."""
        value = x.objective.energy(x.window, x.seen) + x.value_of_shape()
        return torch.full((len(rows), 1), value, dtype=torch.float64)


def objective_of_shape(
    objective: Objective, shape: Float[Tensor, " shape"], seen: Sequence[Tracker]
) -> Objective:
    """Return the objective with the body's shape replaced by the given one."""
    body = objective.body
    return replace(
        objective,
        points=tuple(one.points_on_bones(body, shape, objective.offsets) for one in seen),
        joints=BonePoints.of_joints(body, shape),
        shape=shape,
        rest=body.rest_joints(shape),
    )
