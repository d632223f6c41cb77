"""Retargeting: transfers a motion to a body of another shape."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humos.prior import Humos, at_network_rate, count_at_network_rate, spline_matrix
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length, with_shape
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.method.windows import Windows, joined_windows
from recon.physics.energies import FloatingUnlessFlying, dynamic_stability, penetration, slide
from recon.physics.metrics import NO_GROUND
from recon.solver.lbfgs import LBFGS

PENETRATION, FLOATING, SLIDE, BALANCE = 1000.0, 1000.0, 3000.0, 1.0
"""Weights of the physics energies relative to ½ Σ |joint - its place in the given motion|². They
and `SMOOTH` were chosen on eight retargeted validation clips; results depend on them little."""

SMOOTH = 5.0
"""Weight of the second differences of the correction, per (1/30 s)²."""

SETTLING_ITERATIONS = 60


def corrected_on_ground(
    motion: Motion, accelerations_of: Motion, flying: Bool[Tensor, "clips time"], body: BodyModel
) -> Motion:
    """Correct motions so that feet do not sink, float or slide, and the body is balanced.

    The result stays near a motion with the accelerations of another: it minimises ½ Σ |p - q|² +
    `SMOOTH` ½ Σ |second difference of p - r|² over the joints p, where q are those of `motion` and
    r those of `accelerations_of`, plus the energies of `recon.physics.energies`. Poses, place and
    heading are changed, the shape is not.

    Args:
        motion: motions on the ground z = 0, or nearly.
        accelerations_of: a motion as smooth as people move; may be `motion` itself.
        flying: frames in which nothing pulls the body to the ground.
        body: body model of the motions.
    """
    prior = PosePrior.load(weights=PoseWeights(pose=0.0, shape=0.0, acceleration=SMOOTH))
    stage = Stage(
        name="physics",
        prior=prior,
        terms=(
            Term(
                "near",
                JointTargetEnergy(*(body.pose(m).joints for m in (motion, accelerations_of))),
                1.0,
            ),
            Term("penetration", penetration, PENETRATION),
            Term("floating", FloatingUnlessFlying(flying), FLOATING),
            Term("slide", slide, SLIDE),
            Term("balance", dynamic_stability, BALANCE),
        ),
        free=frozenset({"translation", "root", "pose"}),
        minimiser=LBFGS(max_iterations=SETTLING_ITERATIONS, tolerance_decrease=1e-4),
    )
    scene = Scene.create(len(motion.shape), like=motion.translation)
    estimate, _ = run_stages([stage], body, motion, scene)
    return estimate.motion


def airborne_frames(motion: Motion, body: BodyModel) -> Bool[Tensor, "*batch time"]:
    """Return a mask of frames in which no vertex is within 5 cm of the ground."""
    return body.pose(motion).vertices[..., 2].amin(-1) > NO_GROUND


@dataclass(frozen=True)
class JointTargetEnergy(TensorStruct):
    """Energy of the distances of joints from given positions and accelerations."""

    places: Float[Tensor, "*batch time 22 3"]
    moving: Float[Tensor, "*batch time 22 3"]
    """Positions of joints (m) whose second differences are the given accelerations."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """Return ½ Σ |p - `places`|² + `SMOOTH` ½ Σ |second differences of p - `moving`|².

        Here p are the joints of the estimate; the unit is m² for motions at 30 Hz.
        """
        motion = estimate.motion
        rate = motion.fps / REFERENCE_FPS
        joints = estimate.body.joints
        away = (joints - self.places).square().sum((-1, -2)).where(motion.valid, 0.0)
        bend = (joints - self.moving).diff(n=2, dim=-3).square().sum((-1, -2))
        bend = bend.where(motion.inner(), 0.0)
        return 0.5 * (away.sum(-1) / rate + SMOOTH * bend.sum(-1) * rate**3)


WINDOW, OVERLAP = 10.0, 3.0
"""Duration (s) that is retargeted at once (200 frames at 20 Hz), and the overlap (s) of
neighbours."""
SHORTEST_MOTION = 1.0
"""Least duration (s) of a clip."""


def retarget(motion: Motion, shape: Float[Tensor, " shape"], prior: Humos) -> Motion:
    """Return the same motion performed by a body of another shape.

    The prior proposes a motion, and the nearest one to it that obeys physics is the result.

    Args:
        motion: one clip, at any rate; the ground is z = 0.
        shape: shape coefficients of the other body.
        prior: network that transfers motions between shapes.

    Returns:
        A clip with the same number of frames, rate and start position.

    Raises:
        ValueError: when the clip is shorter than a second, or frames of it do not exist.
    """
    body = prior.body
    motion, shape = _checked_arguments(motion, shape, body)
    start = motion.translation[0] + body.rest_joints(motion.shape)[0]

    def retargeted(window: Motion) -> Motion:
        return _corrected_proposal(_network_proposal(window, shape, prior, start), window, body)

    return _applied_in_windows(motion, retargeted)


def retarget_by_physics(motion: Motion, shape: Float[Tensor, " shape"], body: BodyModel) -> Motion:
    """Return the same motion on a body of another shape, by physics without a network.

    The result is the motion nearest to the scaled copy (`recon.body.motion_files.with_shape`)
    that obeys physics. Result and errors are those of `retarget`.
    """
    motion, shape = _checked_arguments(motion, shape, body)
    # scale the whole motion, not each window, since its path grows from the clip's start
    grown = with_shape(motion, body, shape)

    def retargeted(window: Motion) -> Motion:
        first = round((window.start_time - motion.start_time) * motion.fps)
        return _corrected_proposal(grown.window(first, first + window.frames), window, body)

    return _applied_in_windows(motion, retargeted)


def _network_proposal(
    window: Motion, shape: Float[Tensor, " shape"], prior: Humos, start: Float[Tensor, "3"]
) -> Motion:
    """Return the prior's proposal for one window, its path scaled by leg length about `start`."""
    with torch.no_grad():
        found = prior.encode(window[None])
        grown = leg_length(prior.body, shape) / leg_length(prior.body, window.shape)
        level = start * start.new_tensor([1.0, 1.0, 0.0])
        place = level + grown * (found.base[..., :3, 3] - level)
        base = so3.rigid(found.base[..., :3, :3], place)
        shift = found.shift * found.shift.new_tensor([1.0, 1.0, 0.0])
        other = found.replace(shape=shape[None], base=base, shift=shift)
        made = prior.decode(other).motion[0]
    # take heights of the scaled motion, corrected at 20 Hz: corrections of all frames would jitter
    scaled = with_shape(window, prior.body, shape)
    away = at_network_rate(made).translation - at_network_rate(scaled).translation
    height = scaled.translation + _spline_matrix(made) @ away
    return made.replace(translation=torch.cat((made.translation[:, :2], height[:, 2:]), 1))


def _corrected_proposal(proposal: Motion, window: Motion, body: BodyModel) -> Motion:
    """Correct a proposal on the ground at 20 Hz; between these frames, interpolate corrections.

    A network's proposal stands on the ground in every frame, by which its height may tremble.

    Args:
        proposal: proposed motion for a window.
        window: the same window of the motion that is retargeted.
        body: body model of both.
    """
    coarse, source = at_network_rate(proposal), at_network_rate(window)
    scaled = with_shape(source, body, proposal.shape)
    flying = airborne_frames(source, body)
    stands = corrected_on_ground(coarse[None], scaled[None], flying[None], body).detach()[0]
    between = _spline_matrix(proposal)
    turns = so3.log(coarse.rotations.mT @ stands.rotations).flatten(1)
    moves = stands.translation - coarse.translation
    return proposal.replace(
        rotations=proposal.rotations @ so3.exp((between @ turns).unflatten(-1, (22, 3))),
        translation=proposal.translation + between @ moves,
    )


def _spline_matrix(motion: Motion) -> Float[Tensor, "frames coarse"]:
    """Return the matrix that interpolates by splines from frames at 20 Hz to a motion's frames."""
    coarse = count_at_network_rate(motion.frames, motion.fps)
    return spline_matrix(coarse, motion.frames, motion.fps).to(motion.translation)


def _applied_in_windows(motion: Motion, function: Callable[[Motion], Motion]) -> Motion:
    """Apply `function` to windows of `WINDOW` seconds that share `OVERLAP`; join the results."""
    windows = Windows.cover(motion.frames, int(WINDOW * motion.fps), round(OVERLAP * motion.fps))
    parts = [motion.window(first, first + windows.frames) for first in windows.starts]
    return joined_windows([function(part) for part in parts])


def _checked_arguments(
    motion: Motion, shape: Float[Tensor, " shape"], body: BodyModel
) -> tuple[Motion, Float[Tensor, " shape"]]:
    """Return motion and shape in single precision, or raise an error that says what is wrong."""
    if motion.translation.ndim != 2 or not bool(motion.valid.all()):
        raise ReconError(
            "expected one clip all of whose frames exist; take the clips of a batch one by one, "
            "without their padding"
        )
    if motion.frames < max(2, SHORTEST_MOTION * motion.fps):
        raise ReconError(
            f"expected at least {SHORTEST_MOTION:g} s of motion and two frames, got "
            f"{motion.frames} frames, {motion.frames / motion.fps:.2f} s; give a longer clip"
        )
    size = body.shape_size
    if shape.shape != (size,) or motion.shape.shape != (size,):
        raise ReconError(
            f"expected shapes of {size} coefficients, got {tuple(shape.shape)} for a motion of "
            f"{tuple(motion.shape.shape)}; fill the missing ones with zeros"
        )
    numbers = {"motion": (*motion.tensors().values(),), "shape": (shape,)}
    for name, tensors in numbers.items():
        if not all(bool(tensor.isfinite().all()) for tensor in tensors):
            raise ReconError(f"the {name} has nan or infinity; fill its gaps first")
    return motion.to(dtype=torch.float32), shape.float()
