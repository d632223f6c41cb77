"""Gauss-Newton Hessians of a stage's objective, clip by clip."""

from typing import Any, TypeGuard

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.core import rotations as so3
from recon.core.camera import transform
from recon.core.motion import Motion
from recon.method.newton.model import (
    ClipModel,
    Framewise,
    OfScene,
    PointSensor,
    WeighedByClip,
)
from recon.method.protocols import REFERENCE_FPS, Estimate
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
from recon.solver.banded import Banded, add_differences

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
    known = any(is_pointwise(_of_clip(term, 0).energy) for term in stage.terms)
    if not isinstance(prior, Framewise) or not known or estimate.motion.frames < 2:
        return None
    found: list[Banded] = []
    for clip in range(len(estimate.motion.translation)):
        turn = prior.turns(variables, clip)
        model = ClipModel(estimate, clip, turn, prior.reach, with_shape)
        for joined in stage.terms:
            term = _of_clip(joined, clip)
            if not prior.add_curvature(term, model) and not _add(term, model):
                return None
        found.append(model.hessian())
    return found


def _of_clip(term: Term, clip: int) -> Term:
    """The term with the weight of one clip."""
    if not isinstance(term.energy, WeighedByClip):
        return term
    weight, energy = term.energy.of_clip(clip)
    return Term(term.name, energy, term.weight * weight)


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
