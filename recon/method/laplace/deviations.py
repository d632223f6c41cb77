"""How sure a fit is: standard deviations of joints from the curvature of the objective (Laplace).

Around its minimum -log p of a motion given the data is nearly quadratic. Its Hessian H is taken
in the Gauss-Newton approximation, Σ JᵀJ over all residuals divided by their standard deviations;
the covariance of the motion is H⁻¹ and that of a joint G H⁻¹ Gᵀ, with G the joint's derivative.

Every frame has 69 coordinates: the translation in metres and the rotation steps of 22 joints in
radians, R_j Exp(w_j). The shape is shared by all. A residual of a sensor depends on one frame, a
pose's coordinates likewise, a joint's acceleration on three; so H is banded in time, with the
shape as a border (`recon.solver.blocks`). Where the ground is unknown, its height and tilt are in
the border, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.core.scene import Scene
from recon.method.laplace.grounds import (
    GroundBelief,
    GroundDeviation,
    add_stance,
    deviation,
    perturbed,
)  # fmt: skip
from recon.method.laplace.hessian import FRAME, Accumulated
from recon.method.protocols import REFERENCE_FPS, Decoded, Density, Estimate, Sensor
from recon.solver.blocks import Inverse, inverse

_STEP = 1e-3
"""Metres, radians and standard deviations of shape over which derivatives are differences."""
_DISBELIEVED = 4.0
"""Standard deviations beyond which residuals say ever less: the fit does not believe them."""
_PEOPLE = 1.0
"""Inverse variance of a shape coefficient among people, the most that is believed of it: a prior
that counts for every frame would be ever surer."""
_CHUNK = 150
"""Frames that are looked at together; longer motions are cut, and cuts overlap."""
_OVERLAP = 15


@runtime_checkable
class Believing(Protocol):
    """A prior that says how likely motions are, as a density that has a curvature."""

    def belief(self, noise: float) -> Density:
        """The density that the prior's weights stand for beside data of this noise, metres."""
        ...


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of a fitted motion of one clip."""

    joints: Float[Tensor, "time 22"]
    """Standard deviation of a coordinate of every joint, metres, over its three axes."""
    root: Float[Tensor, " time"]
    """Standard deviation of the rotation of the root about an axis, radians."""
    shape: Float[Tensor, " shape"]
    """Standard deviation of every shape coefficient."""
    ground: GroundDeviation | None = None
    """Standard deviations of the ground; None where it is known, and where nothing tells it."""


def deviations(
    estimate: Estimate,
    sensors: Sequence[Sensor],
    noises: Sequence[Noise],
    density: Density,
    ground: GroundBelief | None = None,
) -> Deviations:
    """How far the joints of a fit of one clip may be from the truth.

    Joints are those in the frame of the recording, whatever is believed of the ground.

    Args:
        estimate: the fit; a leading axis of length one.
        sensors: what was seen, likewise.
        noises: standard deviations of the sensors' coordinates.
        density: how likely poses, shapes and accelerations are, without the data.
        ground: what is believed of an unknown ground; None where it is known or not asked for.
    """
    body = estimate.body.model.to(dtype=torch.float64)
    motion = estimate.motion.detach().to(dtype=torch.float64)
    scene = estimate.scene.detach().to(dtype=torch.float64)
    held = [one.to(dtype=torch.float64) for one in sensors]
    cuts = _cuts(motion.frames)
    windows = [motion.window(first, stop) for first, stop in cuts]
    parts = [
        _of_window(one, scene, body, _during(held, one), noises, density, ground)
        for one in windows
    ]
    joints = motion.translation.new_zeros(motion.frames, len(body.joint_template))
    root = motion.translation.new_zeros(motion.frames)
    for (first, stop), part in zip(cuts, parts, strict=True):
        skip = _OVERLAP // 2 if first > 0 else 0
        joints[first + skip : stop] = part.joints[skip:]
        root[first + skip : stop] = part.root[skip:]
    least = torch.stack([part.shape for part in parts]).amin(0)
    told = [part.ground for part in parts if part.ground is not None]
    # windows of a long recording share one ground, which the surest of them tells best
    surest = min(told, key=lambda one: one.height) if told else None
    return Deviations(joints, root, least, surest)


def _cuts(frames: int) -> list[tuple[int, int]]:
    """First and last frame, exclusive, of overlapping windows."""
    step = _CHUNK - _OVERLAP
    firsts = range(0, max(frames - _OVERLAP, 1), step)
    return [(first, min(first + _CHUNK, frames)) for first in firsts]


def _during(sensors: Sequence[Sensor], motion: Motion) -> list[Sensor]:
    """What the sensors saw during a motion; the rest of a long recording costs nothing."""
    stop = motion.start_time + (motion.frames - 1) / motion.fps
    return [one.window(motion.start_time, stop) for one in sensors]


def _of_window(
    motion: Motion,
    scene: Scene,
    body: BodyModel,
    sensors: Sequence[Sensor],
    noises: Sequence[Noise],
    density: Density,
    ground: GroundBelief | None,
) -> Deviations:
    every = _perturbed(motion, 0 if ground is None else ground.coordinates)
    rows = len(every.translation)
    if ground is None:
        scenes = scene[torch.zeros(rows, dtype=torch.long)]
    else:
        scenes = perturbed(scene, rows, ground, _STEP)
    estimates = Estimate(Decoded(every), body.pose(every), scenes)
    joints = _derivative(estimates.body.joints.flatten(-2))
    frames = motion.frames
    size = joints.shape[-1]
    h = Accumulated.zero(frames, size, like=motion.translation)
    for one, noise in zip(sensors, noises, strict=True):
        h.add_sensor(_clock(one, motion), *_whitened(one, noise, estimates))
    h.add_frames(_derivative(density.whitened(every)) * (REFERENCE_FPS / motion.fps) ** 0.5)
    rate = (motion.fps / REFERENCE_FPS) ** 3
    h.add_accelerations(joints, density.acceleration * rate)
    shapes = motion.shape.shape[-1]
    shape = h.shape.diagonal()[:shapes]
    shape += min(density.shape * frames * REFERENCE_FPS / motion.fps, _PEOPLE)
    told = ground is not None and add_stance(h, estimates, joints, ground)
    found = inverse(h.bordered())
    seen = _derivative(scenes.to_recording(estimates.body.joints).flatten(-2))
    marginals = _marginals(found, seen, shapes)
    if ground is None or ground.coordinates == 0 or not told:
        return marginals
    return replace(marginals, ground=deviation(found.border, scenes, ground, _STEP))


def _perturbed(motion: Motion, more: int) -> Motion:
    """The motion as it is, then after a step of each coordinate in all frames, then of shape.

    `more` rows with the motion as it is follow, in which something else is moved.
    """
    shapes = motion.shape.shape[-1]
    count = 1 + FRAME + shapes + more
    frames = motion.frames
    translation = motion.translation.expand(count, frames, 3).clone()
    steps = motion.translation.new_zeros(count, 22, 3)
    shape = motion.shape.expand(count, shapes).clone()
    for k in range(3):
        translation[1 + k, :, k] += _STEP
    for k in range(FRAME - 3):
        steps[4 + k, k // 3, k % 3] = _STEP
    for k in range(shapes):
        shape[1 + FRAME + k, k] += _STEP
    rotations = motion.rotations @ so3.exp(steps)[:, None]
    return motion.replace(
        translation=translation,
        rotations=rotations,
        shape=shape,
        valid=motion.valid.expand(count, frames),
    )


def _derivative(
    values: Float[Tensor, "steps rows dims"],
) -> Float[Tensor, "rows dims coordinates"]:
    """Differences from the first, per unit of the step."""
    return ((values[1:] - values[:1]) / _STEP).movedim(0, -1)


def _whitened(
    one: Sensor, noise: Noise, estimates: Estimate
) -> tuple[Float[Tensor, "moments residuals coordinates"], Float[Tensor, "moments residuals"]]:
    """Derivatives of a sensor's residuals and their weights, standard deviations taken out."""
    rows = torch.zeros(len(estimates.motion.translation), dtype=torch.long)
    with torch.no_grad():
        found = one[rows].residuals(estimates)
    sigma = torch.full_like(found.values[0, ..., 0], noise.own)
    distance = found.values[0].norm(dim=-1) / (_DISBELIEVED * sigma)
    # the curvature of Geman-McClure's kernel, as far as it is positive
    belief = (1 + distance.square()).reciprocal().square()
    weight = found.weights[0].square() * belief / sigma.square() * (REFERENCE_FPS / one.fps)
    dims = found.values.shape[-1]
    values = found.values.flatten(-2)
    return _derivative(values), weight[..., None].expand(*weight.shape, dims).flatten(-2)


def _clock(one: Sensor, motion: Motion) -> Tensor:
    """The frame of the motion that is nearest to every moment of a sensor."""
    times = one.start_time + torch.arange(one.moments, dtype=torch.float64) / one.fps
    frame = ((times - motion.start_time) * motion.fps).round().long()
    return frame.clamp(0, motion.frames - 1)


def _marginals(
    found: Inverse, joints: Float[Tensor, "time 66 coordinates"], shapes: int
) -> Deviations:
    """Standard deviations of every frame's joints and root, and of the shape.

    Those of the root are given the ground.
    """
    count = len(joints)
    blocks = found.within.unflatten(-1, (2, FRAME)).unflatten(-3, (2, FRAME))
    own = torch.stack((blocks[:, 0, :, 0], blocks[:, 1, :, 1]), 1).flatten(0, 1)[:count]
    onto = found.onto.unflatten(1, (2, FRAME)).flatten(0, 1)[:count]
    moved, shaped = joints[..., :FRAME], joints[..., FRAME:]
    rest = shaped - moved @ onto
    variance = ((moved @ own) * moved).sum(-1) + ((rest @ found.border) * rest).sum(-1)
    given, onto_shape = _given_rest(found.border, shapes), onto[..., :shapes]
    turned = own + onto_shape @ given @ onto_shape.mT
    root = turned[:, 3:6, 3:6].diagonal(dim1=-2, dim2=-1).mean(-1).sqrt()
    per_joint = variance.unflatten(-1, (-1, 3)).mean(-1).sqrt()
    return Deviations(per_joint, root, found.border.diagonal()[:shapes].sqrt())


def _given_rest(covariance: Float[Tensor, "m m"], count: int) -> Float[Tensor, "count count"]:
    """Covariance of the first coordinates where all others are known."""
    first, across, rest = (
        covariance[:count, :count], covariance[:count, count:], covariance[count:, count:],
    )  # fmt: skip
    if rest.numel() == 0:
        return first
    return first - across @ torch.linalg.solve(rest, across.mT)
