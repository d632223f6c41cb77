"""The motion nearest to a given one whose feet obey physics; of finished motions, not of data."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.physics.energies import FloatingUnlessFlying, dynamic_stability, penetration, slide
from recon.physics.samples import NO_GROUND
from recon.solver.lbfgs import LBFGS

PENETRATION, FLOATING, SLIDE, BALANCE = 1000.0, 1000.0, 3000.0, 1.0
"""Weights of the physics energies beside ½ Σ |joint - its place in the given motion|². They and
`SMOOTH` were chosen on eight retargeted validation clips; results depend on them little."""

SMOOTH = 5.0
"""Weight of the second differences of what is changed, per (1/30 s)²."""

SETTLING_ITERATIONS = 60


def settled(
    motion: Motion, moving: Motion, flying: Bool[Tensor, "clips time"], body: BodyModel
) -> Motion:
    """Motions of a batch whose feet stand: they neither sink nor float nor slide, and balance.

    Near a motion, with the accelerations of another: least ½ Σ |p - q|² + `SMOOTH` ½ Σ |second
    difference of p - r|² of the joints p, where q are those of `motion` and r those of
    `moving`, plus the energies of `recon.physics.energies`. Poses, place and heading are moved,
    the shape is not.

    Args:
        motion: on the ground z = 0, or nearly.
        moving: as smoothly as people do; may be the motion itself.
        flying: frames in which nothing pulls the body down.
        body: that moves.
    """
    prior = PosePrior.load(weights=PoseWeights(pose=0.0, shape=0.0, acceleration=SMOOTH))
    stage = Stage(
        name="physics",
        prior=prior,
        terms=(
            Term("near", NearTo(*(body.pose(m).joints for m in (motion, moving))), 1.0),
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


def flies(motion: Motion, body: BodyModel) -> Bool[Tensor, "*batch time"]:
    """Frames in which no vertex is within 5 cm of the ground."""
    return body.pose(motion).vertices[..., 2].amin(-1) > NO_GROUND


@dataclass(frozen=True)
class NearTo(TensorStruct):
    """How far joints are from given places, and their accelerations from given ones."""

    places: Float[Tensor, "*batch time 22 3"]
    moving: Float[Tensor, "*batch time 22 3"]
    """Places of which the accelerations count."""

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ |p - q|² + `SMOOTH` ½ Σ |second difference of p - r|²; metres², at 30 Hz."""
        motion = estimate.motion
        rate = motion.fps / REFERENCE_FPS
        joints = estimate.body.joints
        away = (joints - self.places).square().sum((-1, -2)).where(motion.valid, 0.0)
        bend = (joints - self.moving).diff(n=2, dim=-3).square().sum((-1, -2))
        bend = bend.where(motion.inner(), 0.0)
        return 0.5 * (away.sum(-1) / rate + SMOOTH * bend.sum(-1) * rate**3)
