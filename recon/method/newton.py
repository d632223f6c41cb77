"""Gauss-Newton Hessians of a stage's objective, clip by clip."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeGuard

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.camera import transform
from recon.core.motion import Motion
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import FRAME, ClipModel, OfScene, PointSensor
from recon.method.stages import Stage
from recon.method.terms import (
    Term,
    ground_moved,
    joint_acceleration,
    joint_velocity,
    lens_changed,
    offsets,
    shape,
)
from recon.method.unknowns import Layout, Unknowns
from recon.solver.banded import Banded, Factor, add_differences

_SAME_MOMENT = 1e-4
"""Frames; moments closer than this to a frame are that frame's."""

_OF_SCENE = (offsets, ground_moved, lens_changed)
"""Terms of the scene's own variables, which are minimised as they are."""


def hessians(
    stage: Stage[Any], variables: Any, estimate: Estimate, with_shape: bool
) -> list[Banded] | None:
    """The Hessian of every clip at an estimate, of all terms whose curvature is known.

    None where the prior's variables are no steps of frames, nothing is known of the data, or
    there is a term whose curvature is not known: steps that leave it out overshoot.
    """
    prior = stage.prior
    known = any(is_pointwise(term.energy) for term in stage.terms)
    if prior.reach == 0 or not known or estimate.motion.frames < 2:
        return None
    found: list[Banded] = []
    for clip in range(len(estimate.motion.translation)):
        turn = prior.turns(variables, clip)
        model = ClipModel(estimate, clip, turn, prior.reach, with_shape)
        for term in stage.terms:
            if not prior.add_curvature(term, model) and not _add(term, model):
                return None
        found.append(model.hessian())
    return found


def is_pointwise(energy: Any) -> TypeGuard[PointSensor]:
    """Whether an energy is a sum over moments of points with a place in the world."""
    alone = getattr(energy, "placed", True) and getattr(energy, "momentwise", True)
    return isinstance(energy, PointSensor) and alone


def _add(term: Term, model: ClipModel) -> bool:
    """Add what is known of a term that is not the prior's own; whether anything is."""
    energy, motion = term.energy, model.motion
    rate = motion.fps / REFERENCE_FPS
    if is_pointwise(energy):
        _add_points(term.weight, energy, model)
    elif energy is shape:
        frames = float(motion.valid.sum()) / rate
        model.part.corner.diagonal().add_(2 * term.weight * frames)
    elif energy is joint_acceleration:
        exists = motion.inner().to(motion.translation)[:, None]
        add_differences(model.joints, (1.0, -2.0, 1.0), term.weight * rate**3 * exists)
    elif energy is joint_velocity:
        exists = (motion.valid[1:] & motion.valid[:-1]).to(motion.translation)[:, None]
        add_differences(model.joints, (-1.0, 1.0), term.weight * rate * exists)
    else:
        return energy in _OF_SCENE
    return True


def _add_points(weight: float, sensor: PointSensor, model: ClipModel) -> None:
    """Add the curvature of points, which lie between two frames where clocks differ."""
    clip, motion, scene = model.clip, model.motion, model.estimate.scene
    one: Any = sensor
    one = one[clip]
    if isinstance(one, OfScene):
        one = one.settled(scene[clip])
    carried = sensor.carried(model.body, motion.shape, scene.offsets[clip])
    places = carried.of(*model.posed)
    if scene.ground is not None:
        places = transform(so3.inverse_rigid(scene.ground.T_world_recording[clip]), places)
    before, share, seen = _between(motion, sensor)
    after = (before + 1).clamp(max=motion.frames - 1)
    share = share.to(places)[:, None, None]
    predicted = places.new_zeros(sensor.moments, *places.shape[1:])
    predicted[seen] = places[before].lerp(places[after], share)
    curvature = weight * one.point_model(predicted).curvature[seen]
    if scene.ground is not None:
        turn = scene.ground.T_world_recording[clip, :3, :3]
        curvature = turn @ curvature @ turn.mT
    jacobian, shaped = model.by_steps(carried)
    share = share[..., None]
    every = curvature.new_zeros(motion.frames, *curvature.shape[1:])
    own = every.index_add(0, before, (1 - share).square() * curvature)
    own.index_add_(0, after, share.square() * curvature)
    part, columns, edge = model.part, jacobian.flatten(1, 2), shaped.flatten(1, 2)
    pulled = (own @ jacobian).flatten(1, 2)
    part.inner[:, 0] += columns.mT @ pulled
    if model.with_shape:
        part.border.add_(pulled.mT @ edge)
        part.corner.add_(edge.flatten(0, 1).mT @ (own @ shaped).flatten(0, 2))
    if not bool((share > 0).any()):
        return
    across = every.index_add(0, before, share * (1 - share) * curvature)[:-1]
    ahead = (across @ jacobian[1:]).flatten(1, 2)
    part.inner[:-1, 1] += columns[:-1].mT @ ahead
    if model.with_shape:
        pulled = (across @ shaped[1:]).flatten(1, 2)
        part.border[:-1] += columns[:-1].mT @ pulled
        part.border[1:] += ahead.mT @ edge[:-1]
        mixed = edge[:-1].flatten(0, 1).mT @ pulled.flatten(0, 1)
        part.corner.add_(mixed + mixed.mT)


def _between(
    motion: Motion, sensor: PointSensor
) -> tuple[Int[Tensor, " seen"], Float[Tensor, " seen"], Int[Tensor, " seen"]]:
    """The frame before each moment, the share of the way to the next, and the moments within."""
    times = sensor.start_time + torch.arange(sensor.moments, dtype=torch.float64) / sensor.fps
    place = (times - motion.start_time) * motion.fps
    seen = (place > -_SAME_MOMENT) & (place < motion.frames - 1 + _SAME_MOMENT)
    place = place[seen].clamp(0, motion.frames - 1)
    nearest = place.round()
    place = torch.where((place - nearest).abs() < _SAME_MOMENT, nearest, place)
    before = place.floor()
    return before.long(), place - before, seen.nonzero()[:, 0]


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
        if stage.prior.reach == 0 or not stage.free >= _FRAMED:
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
            return _Up.apply(u, some, self.bordered)

        return steps_of


class _Up(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, factors: Sequence[Factor], bordered: int) -> Tensor:
        ctx.map = factors, bordered
        return _mapped([one.up for one in factors], u, bordered)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        factors, bordered = ctx.map
        return _mapped([one.down for one in factors], gradients[0], bordered), None, None


def _mapped(
    functions: Sequence[Callable[[Tensor], Tensor]], flat: Float[Tensor, "rows n"], bordered: int
) -> Float[Tensor, "rows n"]:
    """Each row through the function of its clip; what is of neither frames nor shape stays."""
    rows = [f(row[:bordered]) for f, row in zip(functions, flat, strict=True)]
    return torch.cat((torch.stack(rows), flat[:, bordered:]), 1)
