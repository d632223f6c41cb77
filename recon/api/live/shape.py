"""The shape of a person, learned frame by frame from what leaves the window."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.api.live.objective import Equations


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
