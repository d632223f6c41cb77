"""A stage about a point: in steps of its frames, and in variables that are equally stiff."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.method.newton.hessian import hessians
from recon.method.newton.model import FRAME, Framewise
from recon.method.stages import Stage
from recon.method.unknowns import Layout, Unknowns
from recon.solver.banded import Banded, Factor

_FRAMED = frozenset({"translation", "root", "pose"})


@dataclass(frozen=True)
class Local:
    """A stage about unknowns whose variables are steps of zero.

    A row of numbers per clip: the 69 steps of every frame, those of the shape, if it is moved, and
    what else is moved.
    """

    stage: Stage[Any]
    body: BodyModel
    base: Unknowns[Any]
    layout: Layout
    curvature: list[Banded]
    """The Hessian of every clip, by frames and shape."""

    @classmethod
    def about(cls, stage: Stage[Any], body: BodyModel, unknowns: Unknowns[Any]) -> "Local | None":
        """The stage about unknowns; None where no Hessian of it is known."""
        if not isinstance(stage.prior, Framewise) or not stage.free >= _FRAMED:
            return None
        if stage.portion is not None:
            return None
        with torch.no_grad():
            motion = unknowns.motion(stage.prior, body)
            base = Unknowns.of(stage.prior, motion, unknowns.scene, body).detach()
            estimate = base.estimate(stage.prior, body)
            found = hessians(stage, base.variables, estimate, "shape" in stage.free)
        if found is None:
            return None
        return cls(stage, body, base, Layout.of(base, stage.free), found)

    @property
    def frames(self) -> int:
        """Steps of all frames of a clip."""
        return self.curvature[0].inner.shape[0] * FRAME

    @property
    def bordered(self) -> int:
        """Steps of frames and of the shape."""
        return self.frames + self.curvature[0].corner.shape[0]

    @property
    def size(self) -> int:
        """All numbers of a clip."""
        rest = sum(
            shape.numel()
            for path, shape in zip(self.layout.paths, self.layout.shapes, strict=True)
            if path.startswith("scene.")
        )
        return self.bordered + rest

    def zero(self) -> Float[Tensor, "rows n"]:
        """No steps."""
        return self.base.variables.shape.new_zeros(len(self.curvature), self.size)

    def moved(self, base: Unknowns[Any], steps: Float[Tensor, "rows n"]) -> Unknowns[Any]:
        """The unknowns of some clips after steps."""
        prior: Any = self.stage.prior
        framed = steps[:, : self.frames].unflatten(1, (-1, FRAME))
        variables = prior.from_steps(base.variables, framed)
        if self.bordered > self.frames:
            shape = base.variables.shape + steps[:, self.frames : self.bordered]
            variables = variables.derived(shape=shape)
        scene, start = base.scene, self.bordered
        moved: dict[str, Tensor] = {}
        for path, shape in zip(self.layout.paths, self.layout.shapes, strict=True):
            if path.startswith("scene."):
                flat = steps[:, start : start + shape.numel()]
                part = flat.reshape(len(steps), *shape)  # the ground's height has no axis
                moved[path.removeprefix("scene.")] = part
                start += shape.numel()
        if moved:
            paths = iter(scene.tensors())
            scene = scene.map(lambda t: t + moved[p] if (p := next(paths)) in moved else t)
        return Unknowns(variables, scene)

    def objective(
        self, steps_of: Callable[[Tensor, Tensor], Tensor]
    ) -> Callable[[Tensor, Tensor], Tensor]:
        """Weighted terms as a function of a solver's variables and the clips they are of."""
        bound = self.stage.terms, self.base
        bound_to: Tensor | None = None

        def terms(u: Float[Tensor, "active n"], active: Int[Tensor, " active"]) -> Tensor:
            nonlocal bound, bound_to
            if active is not bound_to:
                bound = tuple(t.rows(active) for t in self.stage.terms), self.base[active]
                bound_to = active
            energies, base = bound
            unknowns = self.moved(base, steps_of(u, active))
            estimate = unknowns.estimate(self.stage.prior, self.body)
            return torch.stack([t.weight * t.energy(estimate) for t in energies], -1)

        return terms

    def scaled(self, factors: Sequence[Factor]) -> Callable[[Tensor, Tensor], Tensor]:
        """Steps of variables u; what belongs to neither frames nor shape is as it is."""

        def steps_of(u: Tensor, active: Tensor) -> Tensor:
            some = [factors[k] for k in active.tolist()]
            return _Up.apply(u, some, self.frames, self.bordered)

        return steps_of


class _Up(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, u: Tensor, factors: Sequence[Factor], frames: int, bordered: int
    ) -> Tensor:
        ctx.map = factors, frames, bordered
        return mapped([one.up for one in factors], u, frames, bordered)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, None]:
        factors, frames, bordered = ctx.map
        down = [one.down for one in factors]
        return mapped(down, gradients[0], frames, bordered), None, None, None


Substitution = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def mapped(
    functions: Sequence[Substitution],
    flat: Float[Tensor, "rows n"],
    frames: int,
    bordered: int,
) -> Float[Tensor, "rows n"]:
    """Each row through the function of its clip; what is of neither frames nor shape stays."""
    rows: list[Tensor] = []
    for function, row in zip(functions, flat, strict=True):
        moved, border = function(row[:frames].view(-1, FRAME), row[frames:bordered])
        rows.append(torch.cat((moved.flatten(), border, row[bordered:])))
    return torch.stack(rows)
