"""Fixed-lag smoothing: a window of the newest frames, moved a little with every moment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from observations.moments import Tracker, joined, moments
from recon.body.derivatives import CarriedPoints
from recon.live.objective import Equations, Objective, Window
from recon.solver.banded import Factor


@dataclass(frozen=True)
class ShapeKnowledge:
    """A quadratic energy ½ bᵀ Λ b - ηᵀ b about the shape b: all that past frames say of it."""

    information: Float[Tensor, "shape shape"]
    """Λ."""
    pull: Float[Tensor, " shape"]
    """η."""
    frames: int
    """Number of frames that it was learned from."""

    @classmethod
    def none(cls, shape: Float[Tensor, " shape"]) -> "ShapeKnowledge":
        """Before any frame."""
        return cls(shape.new_zeros(len(shape), len(shape)), torch.zeros_like(shape), 0)

    def gradient(self, shape: Float[Tensor, " shape"]) -> Float[Tensor, " shape"]:
        """Derivative of the energy."""
        return self.information @ shape - self.pull

    def value(self, shape: Float[Tensor, " shape"]) -> float:
        """The energy."""
        return float(0.5 * shape @ self.information @ shape - self.pull @ shape)

    def learned(
        self, equations: Equations, shape: Float[Tensor, " shape"], weight: float
    ) -> "ShapeKnowledge":
        """Knowledge that includes a window's first frame, its pose eliminated (Schur complement).

        Ties of the frame to its neighbours are left out, which makes it tell a little less.

        Args:
            equations: of the window about this shape.
            shape: about which they are.
            weight: of |b|² per frame, the density of shapes.
        """
        border, gradient = equations.border[0], equations.gradient_alone[0]
        factor, failed = torch.linalg.cholesky_ex(equations.alone[0])
        if int(failed) != 0:  # nothing was seen, so the frame says nothing
            return self
        solved = torch.cholesky_solve(torch.cat((border, gradient[:, None]), -1), factor)
        said = equations.corner[0] - border.mT @ solved[:, :-1]
        slope = equations.gradient_shape[0] - border.mT @ solved[:, -1]
        held = 2 * weight * torch.eye(len(shape), dtype=shape.dtype, device=shape.device)
        return ShapeKnowledge(
            self.information + said + held, self.pull + said @ shape - slope, self.frames + 1
        )


_MIN_DAMPING, _MAX_DAMPING = 1e-6, 1e3
"""Least share that the diagonal is raised by in an accepted step, and the share at which a frame
is taken to be as good as it gets."""
_REFUSED_DAMPING = 1e-2
"""Share after the first step that gained nothing."""
_MIN_DECREASE = 1e-4
"""Relative decrease of the energy below which no further step is taken."""
_SLOWED = 0.9
"""Share of the last step with which a new frame begins."""


@dataclass(frozen=True)
class Smoothed:
    """The window and what is known of the person, after a push."""

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
    def active(self) -> int:
        """Frames that are still moved."""
        return self.seen[0].moments

    def extended(self, seen: Sequence[Tracker], most: int, learn_until: int) -> "Smoothed":
        """A window that has one frame more, and the oldest one less if there are more than `most`.

        Args:
            seen: data of the new frame.
            most: active frames.
            learn_until: frames after which the shape is held.
        """
        data = tuple(joined(a, b) for a, b in zip(self.seen, seen, strict=True))
        window, knowledge, learning = self.window.extended(_SLOWED), self.knowledge, self.learning
        if (count := data[0].moments) > most:
            data = tuple(moments(one, count - most, count) for one in data)
            # as many are held where they are, so that motion goes on without a seam
            window = window[-(most + self.objective.reach) :]
            if learning and self.equations is not None:
                objective = self.objective
                weight = objective.weights.shape * objective.rate
                knowledge = knowledge.learned(self.equations, objective.shape, weight)
                learning = knowledge.frames < learn_until
        return replace(
            self, window=window, seen=data, knowledge=knowledge, learning=learning, equations=None
        )

    def refined(self, steps: int) -> "Smoothed":
        """After so many damped Gauss-Newton steps, or fewer where they gain nothing."""
        now = self
        for _ in range(steps):
            equations = now.objective.equations(now.window, now.seen, now.learning)
            now = replace(now, equations=equations)
            after = now._stepped(equations)
            if after is None:
                return now
            now, gained = after
            if gained <= _MIN_DECREASE * abs(equations.value):
                return now
        return now

    def _stepped(self, equations: Equations) -> tuple["Smoothed", float] | None:
        """After one step that lowers the energy, and by how much; None where none does."""
        objective, shape = self.objective, self.objective.shape
        before = equations.value + self._value_of_shape(shape)
        damping, slope = _MIN_DAMPING, equations.gradient_shape.sum(0)
        held = slope.new_zeros(len(slope), len(slope))
        if self.learning:
            weight = 2 * objective.weights.shape * objective.rate * self.active
            held = self.knowledge.information + weight * torch.eye(len(shape)).to(shape)
            slope = slope + self.knowledge.gradient(shape) + weight * shape
        while damping < _MAX_DAMPING:
            system = equations.damped(damping)
            factor = Factor(replace(system, corner=system.corner + held))
            if factor.definite:
                down = -torch.cat((equations.gradient.flatten(), slope))
                found = factor.solve(down)
                steps = found[: equations.gradient.numel()].view_as(equations.gradient)
                reshape = found[equations.gradient.numel() :]
                window, tried = self.window.moved(steps), objective
                if self.learning:
                    tried = reshaped(objective, shape + reshape, self.seen)
                value = tried.value(window, self.seen) + self._value_of_shape(tried.shape)
                if value <= before:
                    return replace(self, window=window, objective=tried), before - value
            damping = max(100 * damping, _REFUSED_DAMPING)
        return None

    def _value_of_shape(self, shape: Float[Tensor, " shape"]) -> float:
        """Energy of the shape while it is learned."""
        objective = self.objective
        if not self.learning:
            return 0.0
        weight = objective.weights.shape * objective.rate * self.active
        return self.knowledge.value(shape) + weight * float(shape.square().sum())


def reshaped(
    objective: Objective, shape: Float[Tensor, " shape"], seen: Sequence[Tracker]
) -> Objective:
    """The objective for a body of another shape."""
    body = objective.body
    return replace(
        objective,
        points=tuple(one.carried(body, shape, objective.offsets) for one in seen),
        joints=CarriedPoints.joints(body, shape),
        shape=shape,
        rest=body.rest_joints(shape),
    )
