"""How sure a fit is: standard deviations of joints from the curvature of the objective (Laplace).

Around its minimum -log p of a motion given the data is nearly quadratic. Its Hessian H is taken
in the Gauss-Newton approximation, Σ JᵀJ over all residuals divided by their standard deviations;
the covariance of the motion is H⁻¹ and that of a joint G H⁻¹ Gᵀ, with G the joint's derivative.

Every frame has 69 coordinates: the translation in metres and the rotation steps of 22 joints in
radians, R_j Exp(w_j). The shape is shared by all. A residual of a sensor depends on one frame, a
pose's coordinates likewise, a joint's acceleration on three; so H is banded in time, with the
shape as a border (`recon.solver.banded`). Where the ground is unknown, its height and tilt are in
the border, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.core.scene import Scene
from recon.method.derivatives import (
    STEP,
    GroundBelief,
    GroundDeviation,
    Neighbourhood,
    add_stance_information,
    ground_std,
)
from recon.method.priors import Density
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.quadratic import FRAME
from recon.method.sensor import Sensor
from recon.solver.banded import Banded, Factor, Inverse, add_differences

_LEAST = 0.1
"""Curvature that every coordinate has at least, 1 / metres² or 1 / radians²: what nothing holds is
unknown by no more than three metres and half a turn."""
_DISBELIEVED = 4.0
"""Standard deviations beyond which residuals say ever less: the fit does not believe them."""
_PEOPLE = 1.0
"""Inverse variance of a shape coefficient among people, the most that is believed of it: a prior
that counts for every frame would be ever surer."""
_CHUNK_FRAMES = 150
"""Frames that are looked at together; longer motions are cut, and cuts overlap."""
_OVERLAP = 15


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
    measures: Float[Tensor, "time measures"] | None = None
    """Standard deviations of what was measured of every frame's pose; None where nothing was."""


Measure = Callable[[Motion], Float[Tensor, "time measures 66"]]
"""Derivatives of numbers that follow from the rotations of each frame of a clip, such as joint
angles, by the rotation steps of its joints."""


def deviations(
    estimate: Estimate,
    sensors: Sequence[Sensor],
    noises: Sequence[Noise],
    density: Density,
    ground: GroundBelief | None = None,
    measure: Measure | None = None,
) -> Deviations:
    """Return the standard deviations of a fit's joints, root, shape and ground, for one clip.

    Positions of joints are those in the frame of the recording.

    Args:
        estimate: the fit; a leading axis of length one.
        sensors: the data, with a leading axis of length one.
        noises: standard deviations of the sensors' coordinates.
        density: how likely poses, shapes and accelerations are, without the data.
        ground: the assumed uncertainty of an unknown ground; None where it is known.
        measure: returns derivatives of further quantities whose standard deviations are wanted.

    Raises:
        ArithmeticError: when the Hessian is not positive definite, and so has no inverse.
    """
    body = estimate.body.model.to(dtype=torch.float64)
    motion = estimate.motion.detach().to(dtype=torch.float64)
    scene = estimate.scene.detach().to(dtype=torch.float64)
    held = [one.to(dtype=torch.float64) for one in sensors]
    cuts = _window_bounds(motion.frames)
    windows = [motion.window(first, stop) for first, stop in cuts]
    parts = [
        _deviations_of_window(one, scene, body, held, noises, density, ground, measure)
        for one in windows
    ]
    joints = motion.translation.new_zeros(motion.frames, len(body.joint_template))
    root = motion.translation.new_zeros(motion.frames)
    measured = parts[0].measures
    if measured is not None:
        measured = joints.new_zeros(motion.frames, measured.shape[-1])
    for (first, stop), part in zip(cuts, parts, strict=True):
        skip = _OVERLAP // 2 if first > 0 else 0
        joints[first + skip : stop] = part.joints[skip:]
        root[first + skip : stop] = part.root[skip:]
        if measured is not None and part.measures is not None:
            measured[first + skip : stop] = part.measures[skip:]
    least = torch.stack([part.shape for part in parts]).amin(0)
    grounds = [part.ground for part in parts if part.ground is not None]
    # windows of a long recording share one ground: take its std from the most certain window
    surest = min(grounds, key=lambda ground: ground.height) if grounds else None
    return Deviations(joints, root, least, surest, measured)


def _window_bounds(frames: int) -> list[tuple[int, int]]:
    """Return first frame and end frame (exclusive) of overlapping windows of a clip."""
    step = _CHUNK_FRAMES - _OVERLAP
    firsts = range(0, max(frames - _OVERLAP, 1), step)
    return [(first, min(first + _CHUNK_FRAMES, frames)) for first in firsts]


def _deviations_of_window(
    motion: Motion,
    scene: Scene,
    body: BodyModel,
    sensors: Sequence[Sensor],
    noises: Sequence[Noise],
    density: Density,
    ground: GroundBelief | None,
    measure: Measure | None,
) -> Deviations:
    near = Neighbourhood(motion, scene, body, ground)
    sensors = [one.window(motion.start_time, motion.stop_time) for one in sensors]
    moved, shaped = near.jacobian[..., :FRAME], near.jacobian[..., FRAME:]
    h = Banded.zero(motion.frames, 2, FRAME, shaped.shape[-1], motion.translation)
    h.inner[:, 0].diagonal(dim1=-2, dim2=-1).add_(_LEAST)
    h.corner.diagonal().add_(_LEAST)
    for one, noise in zip(sensors, noises, strict=True):
        frame = _nearest_frames(one, motion)
        jacobian, weight = _jacobian_and_precision(one, noise, near, frame)
        h.add_frames(frame, jacobian.mT @ (jacobian * weight[..., None]))
    share = density.share(motion)[0, :, None]
    poses = density.by_rotations(motion)[0]
    poses = poses * (share[..., None] * REFERENCE_FPS / motion.fps).sqrt()
    h.inner[:, 0, -poses.shape[-1] :, -poses.shape[-1] :] += poses.mT @ poses
    bends = moved.new_zeros(motion.frames, 3, moved.shape[1])
    weight = share[1:-1] * density.acceleration * (motion.fps / REFERENCE_FPS) ** 3
    add_differences(bends, (1.0, -2.0, 1.0), weight)
    h.add_products(bends, moved, shaped)
    shapes = motion.shape.shape[-1]
    shape = h.corner.diagonal()[:shapes]
    shape += min(density.shape * motion.frames * REFERENCE_FPS / motion.fps, _PEOPLE)
    told = ground is not None and add_stance_information(h, near.translated, near.jacobian, ground)
    factor = Factor(h)
    if not factor.definite:
        raise ArithmeticError("no standard deviations: the fit's Hessian is not positive definite")
    found = factor.inverse()
    marginals = _marginal_deviations(found, near.jacobian_in_recording(), shapes)
    if measure is not None:
        # what is measured depends on rotations only: slopes by all other variables are zero
        slopes = torch.nn.functional.pad(measure(motion[0]), (3, len(h.corner)))
        variance = _variances(found, slopes)
        marginals = replace(marginals, measures=variance.sqrt())
    if ground is None or ground.coordinates == 0 or not told:
        return marginals
    lying = ground_std(found.border, near.translated.scene, ground, STEP)
    return replace(marginals, ground=lying)


def _jacobian_and_precision(
    sensor: Sensor,
    noise: Noise,
    neighbourhood: Neighbourhood,
    frame_of_moment: Int[Tensor, " moments"],
) -> tuple[Float[Tensor, "moments residuals columns"], Float[Tensor, "moments residuals"]]:
    """Return the Jacobian of a sensor's residuals, and each residual's inverse variance."""
    found, slopes = neighbourhood.residuals(sensor, frame_of_moment)
    distance = found.values.norm(dim=-1) / (_DISBELIEVED * noise.own)
    # the curvature of Geman-McClure's robust kernel, without its negative part
    belief = (1 + distance.square()).reciprocal().square()
    weight = found.weights.square() * belief / noise.own**2 * (REFERENCE_FPS / sensor.fps)
    dims = found.values.shape[-1]
    return slopes.flatten(1, 2), weight[..., None].expand(*weight.shape, dims).flatten(-2)


def _nearest_frames(sensor: Sensor, motion: Motion) -> Tensor:
    """Return the number of the motion's frame that is nearest to each frame of a sensor."""
    times = sensor.start_time + torch.arange(sensor.moments, dtype=torch.float64) / sensor.fps
    frame = ((times - motion.start_time) * motion.fps).round().long()
    return frame.clamp(0, motion.frames - 1)


def _marginal_deviations(
    inverse: Inverse, joints: Float[Tensor, "time 66 coordinates"], shapes: int
) -> Deviations:
    """Return standard deviations of every frame's joints and root, and of the shape.

    Those of the root are conditional on the ground.
    """
    own, onto = inverse.within, inverse.onto
    variance = _variances(inverse, joints)
    given, onto_shape = _conditional_covariance(inverse.border, shapes), onto[..., :shapes]
    turned = own + onto_shape @ given @ onto_shape.mT
    root = turned[:, 3:6, 3:6].diagonal(dim1=-2, dim2=-1).mean(-1).sqrt()
    per_joint = variance.unflatten(-1, (-1, 3)).mean(-1).sqrt()
    return Deviations(per_joint, root, inverse.border.diagonal()[:shapes].sqrt())


def _variances(
    inverse: Inverse, slopes: Float[Tensor, "time values coordinates"]
) -> Float[Tensor, "time values"]:
    """Return the variances of quantities of each frame by propagation of the covariance."""
    moved, shaped = slopes[..., :FRAME], slopes[..., FRAME:]
    rest = shaped - moved @ inverse.onto
    return ((moved @ inverse.within) * moved).sum(-1) + ((rest @ inverse.border) * rest).sum(-1)


def _conditional_covariance(
    covariance: Float[Tensor, "m m"], count: int
) -> Float[Tensor, "count count"]:
    """Return the covariance of the first `count` coordinates, conditional on all others."""
    first, across, rest = (
        covariance[:count, :count], covariance[:count, count:], covariance[count:, count:],
    )  # fmt: skip
    if rest.numel() == 0:
        return first
    return first - across @ torch.linalg.solve(rest, across.mT)
