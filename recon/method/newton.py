"""Gauss-Newton Hessians of a stage's objective, clip by clip."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import FRAME, ClipModel
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
from recon.method.timing import SAME_MOMENT
from recon.method.unknowns import Layout, Unknowns, rows_of
from recon.solver.banded import Banded, add_differences
from recon.solver.gauss_newton import Problem, Quadratic

_OF_SCENE = (offsets, ground_moved, lens_changed)
"""Terms of the scene's own variables, which are minimised as they are."""
_SURFACE = "add_surface_curvature"
"""Method of energies of points that are matched to places of the surface."""


class NoHessian(LookupError):
    """Raised when a term's Hessian is not known: steps that ignore the term would overshoot."""


def hessians(
    stage: Stage[Any], variables: Any, estimate: Estimate, with_shape: bool
) -> list[Banded]:
    """Return the Gauss-Newton Hessian of a stage's objective for every clip at an estimate.

    Raises:
        NoHessian: when no data term has a known Hessian, or any other term lacks one.
    """
    prior = stage.prior
    known = any(is_pointwise(t.energy) or hasattr(t.energy, _SURFACE) for t in stage.terms)
    if not known or estimate.motion.frames < 2:
        raise NoHessian(stage.name)
    found: list[Banded] = []
    for clip in range(len(estimate.motion.translation)):
        turn = prior.turns(variables, clip)
        model = ClipModel(estimate, clip, turn, prior.reach, with_shape)
        for term in stage.terms:
            if not prior.add_curvature(term, model) and not _add_term(term, model):
                raise NoHessian(term.name)
        found.append(model.hessian())
    return found


def is_pointwise(energy: Any) -> bool:
    """Return whether an energy is a sum over frames of energies of single points in space."""
    alone = getattr(energy, "placed", True) and getattr(energy, "momentwise", True)
    return hasattr(energy, "point_model") and alone


def _add_term(term: Term, model: ClipModel) -> bool:
    """Add the Hessian of a term that is not the prior's; return False if it is not known."""
    energy: Any = term.energy
    motion = model.motion
    rate = motion.fps / REFERENCE_FPS
    if is_pointwise(energy):
        _add_point_curvature(term.weight, energy, model)
    elif hasattr(energy, _SURFACE):
        energy.add_surface_curvature(term.weight, model)
    elif energy is shape:
        frames = motion.valid.sum() / rate
        model.part.corner.diagonal().add_(2 * term.weight * frames)
    elif energy is joint_acceleration:
        exists = motion.inner().to(motion.translation)[:, None]
        add_differences(model.joints, (1.0, -2.0, 1.0), term.weight * rate**3 * exists)
    elif energy is joint_velocity:
        exists = motion.pairs.to(motion.translation)[:, None]
        add_differences(model.joints, (-1.0, 1.0), term.weight * rate * exists)
    else:
        return energy in _OF_SCENE
    return True


def _add_point_curvature(weight: float, sensor: Any, model: ClipModel) -> None:
    """Add the Hessian of a sensor of points, whose times may lie between motion frames."""
    clip, motion, scene = model.clip, model.motion, model.estimate.scene
    one: Any = sensor[clip]
    if hasattr(one, "with_constants_of"):
        one = one.with_constants_of(scene[clip])
    carried = sensor.points_on_bones(model.body, motion.shape, scene.offsets[clip])
    places = carried.positions(*model.posed)
    if scene.ground is not None:
        places = so3.transform(so3.inverse_rigid(scene.ground.T_world_recording[clip]), places)
    before, share, seen, on_frames = _neighbouring_frames(
        (sensor.start_time, sensor.fps, sensor.moments),
        (motion.start_time, motion.fps, motion.frames),
        places.device,
        places.dtype,
    )
    after = (before + 1).clamp(max=motion.frames - 1)
    share = share[:, None, None]
    predicted = places.new_zeros(sensor.moments, *places.shape[1:])
    predicted[seen] = places[before].lerp(places[after], share)
    found = one.point_model(predicted)
    curvature = weight * found.curvature[seen]
    if scene.ground is not None and not found.isotropic:
        turn = scene.ground.T_world_recording[clip, :3, :3]
        curvature = turn @ curvature @ turn.mT
    if carried.own_joints is not None and found.isotropic and on_frames:
        # isotropic curvatures a·I are summed by joint as a: all terms share the joints' Jacobian
        isotropic = curvature[..., 0, 0]
        joints = cached_constant(carried.own_joints, places.device)
        every = isotropic.new_zeros(motion.frames, *isotropic.shape[1:])
        own = every.index_add(0, before, isotropic)
        model.joints[:, 0].unflatten(-1, (-1, 3)).index_add_(
            1, joints, own[..., None].expand(-1, -1, 3)
        )
        return
    jacobian, shaped = model.jacobians_by_steps(carried)
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
    if on_frames:
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


_Clock = tuple[float, float, int]
"""Time of the first sample, seconds; samples per second; number of samples."""


@lru_cache(maxsize=16)
def _neighbouring_frames(
    sensor: _Clock, motion: _Clock, device: torch.device, dtype: torch.dtype
) -> tuple[Int[Tensor, " seen"], Float[Tensor, " seen"], Int[Tensor, " seen"], bool]:
    """Return the frames of a motion between which the samples of a sensor lie.

    This is computed on the CPU and cached, as a GPU would have to wait for their number.

    Returns:
        The frame before each sample; the fraction of the way to the next frame, 0 to 1; the
        numbers of the samples; and whether all samples are at frames.
    """
    began, fps, moments = sensor
    times = began + np.arange(moments) / fps
    place = (times - motion[0]) * motion[1]
    last = motion[2] - 1
    (seen,) = np.nonzero((place > -SAME_MOMENT) & (place < last + SAME_MOMENT))
    place = place[seen].clip(0, last)
    nearest = place.round()
    place = np.where(np.abs(place - nearest) < SAME_MOMENT, nearest, place)
    before = np.floor(place)
    share = place - before
    with torch.inference_mode(False):
        return (
            torch.from_numpy(before).to(device=device, dtype=torch.long),
            torch.from_numpy(share).to(device=device, dtype=dtype),
            torch.from_numpy(seen).to(device),
            not share.any(),
        )


_FRAMED = frozenset({"translation", "root", "pose"})


@dataclass(frozen=True)
class StageProblem(Problem[Unknowns[Any]]):
    """The least-squares problem of a stage, whose unknowns are changed by steps.

    A clip's row of numbers: the 69 steps of every frame, those of the shape, if it is moved, and
    those of the free parts of the scene. Unknowns are encoded anew after each step.
    """

    stage: Stage[Any]
    body: BodyModel
    layout: Layout
    motion_size: int
    """Number of steps of all frames of a clip, 69 of each."""
    hessian_size: int
    """Number of steps of frames and shape, which the Hessian covers."""
    with_shape: bool
    """Whether the shape is moved as well."""

    @classmethod
    def around(
        cls, stage: Stage[Any], body: BodyModel, unknowns: Unknowns[Any]
    ) -> tuple["StageProblem", Unknowns[Any]]:
        """Return the problem of a stage, and the unknowns from which its steps begin.

        Raises:
            NoHessian: when the prior has no steps of frames, or the stage moves only some.
        """
        framed = stage.prior.reach > 0 and stage.free >= _FRAMED
        if not framed or stage.portion is not None:
            raise NoHessian(stage.name)
        with torch.no_grad():
            motion = unknowns.motion(stage.prior, body)
            base = Unknowns.of(stage.prior, motion, unknowns.scene, body).detach()
        shape = motion.shape.shape[-1] if "shape" in stage.free else 0
        size = motion.frames * FRAME
        layout = Layout.of(base, stage.free)
        return cls(stage, body, layout, size, size + shape, shape > 0), base

    @property
    def scene_parts(self) -> list[tuple[str, torch.Size]]:
        """Names of the free parts of the scene, each with its size for one clip."""
        every = zip(self.layout.paths, self.layout.shapes, strict=True)
        return [(path[6:], shape) for path, shape in every if path.startswith("scene.")]

    @property
    def size(self) -> int:
        """Number of unknowns of one clip: steps of its frames, its shape, its scene."""
        return self.hessian_size + sum(shape.numel() for _, shape in self.scene_parts)

    def hessians(self, base: Unknowns[Any]) -> list[Banded]:
        """Return the Hessian of every clip by steps of frames and of the shape.

        Raises:
            NoHessian: when the Hessian of a term is not known.
        """
        with torch.no_grad():
            estimate = base.estimate(self.stage.prior, self.body)
            return hessians(self.stage, base.variables, estimate, self.with_shape)

    def after_steps(self, base: Unknowns[Any], steps: Float[Tensor, "rows n"]) -> Unknowns[Any]:
        """Return unknowns `base` after steps, as a differentiable function of the steps."""
        prior: Any = self.stage.prior
        framed = steps[:, : self.motion_size].unflatten(1, (-1, FRAME))
        variables = prior.from_steps(base.variables, framed)
        if self.with_shape:
            shape = base.variables.shape + steps[:, self.motion_size : self.hessian_size]
            variables = variables.derived(shape=shape)
        scene, start = base.scene, self.hessian_size
        moved: dict[str, Tensor] = {}
        for path, shape in self.scene_parts:
            flat = steps[:, start : start + shape.numel()]
            moved[path] = flat.reshape(len(steps), *shape)  # shape is () for the ground's height
            start += shape.numel()
        if moved:
            paths = iter(scene.tensors())
            scene = scene.map(lambda t: t + moved[p] if (p := next(paths)) in moved else t)
        return Unknowns(variables, scene)

    def model(self, x: Unknowns[Any], rows: Int[Tensor, " rows"]) -> Quadratic:
        """Return the objective of the clips `rows`, with gradient and Hessian by steps."""
        stage, base = rows_of(self.stage, x, rows)
        with torch.enable_grad():
            zero = base.variables.shape.new_zeros(len(rows), self.size, requires_grad=True)
            estimate = self.after_steps(base, zero).estimate(stage.prior, self.body)
            terms = stage.values(estimate)
            (gradient,) = torch.autograd.grad(terms.sum(), zero)
        with torch.no_grad():
            found = hessians(stage, base.variables, estimate, self.with_shape)
        return Quadratic(terms.detach(), gradient, found)

    def moved(
        self, x: Unknowns[Any], rows: Int[Tensor, " rows"], steps: Float[Tensor, "rows n"]
    ) -> Unknowns[Any]:
        """Return all clips' unknowns after the clips `rows` moved, encoded anew from there."""
        with torch.no_grad():
            moved = self.after_steps(rows_of(self.stage, x, rows)[1], steps)
            motion = moved.motion(self.stage.prior, self.body)
            moved = Unknowns.of(self.stage.prior, motion, moved.scene, self.body)
            if len(rows) == len(x.scene.offsets):
                return moved
            new = iter(moved.tensors().values())
            return x.map(lambda old: old.index_copy(0, rows, next(new)))

    def value(self, x: Unknowns[Any], rows: Int[Tensor, " rows"]) -> Float[Tensor, "rows terms"]:
        """Return the weighted terms of the clips `rows`."""
        stage, base = rows_of(self.stage, x, rows)
        with torch.no_grad():
            return stage.values(base.estimate(stage.prior, self.body))
