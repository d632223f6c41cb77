"""First states of new motions, drawn from the mixture and given a body and rotations."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.state import State, distinct_features
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.core.skeleton import JOINTS
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.method.running import run_stages
from recon.method.terms import Term

_FACING = ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
"""Root of an upright body in its canonical frame: its right along +x, so it looks along +y."""


@dataclass(frozen=True)
class _Joints(TensorStruct):
    """½ Σ |p - p̂|² of all joints of one frame; metres²."""

    positions: Float[Tensor, "clips 22 3"]

    def __call__(self, estimate: Estimate) -> Float[Tensor, " clips"]:
        away = estimate.body.joints[:, 0] - self.positions
        return 0.5 * away.square().sum((-1, -2))


def first_states(
    initial: Mixture,
    body: BodyModel,
    count: int,
    random: torch.Generator,
    temperature: float = 1.0,
) -> tuple[State, Float[Tensor, "clips shape"]]:
    """Canonical states and the shapes of their bodies.

    The mixture knows no rotations. They and the shape are fitted to the drawn joints under the
    pose prior; the state's joints are those of the fitted body.

    Raises:
        ValueError: when the mixture is over other numbers than ours.
    """
    if not torch.equal(initial.features.cpu(), distinct_features()):
        raise ValueError(
            "first states need a mixture over independent features; the released one is over all"
        )
    drawn = initial.sample(count, random, temperature).to(body.template)
    full = drawn.new_zeros(count, 6 * len(JOINTS) + 6)
    full[:, initial.features] = drawn
    positions, velocities = (
        part.unflatten(-1, (len(JOINTS), 3)) for part in full[:, :-6].chunk(2, 1)
    )
    level = full.new_tensor([1.0, 1.0, 0.0])
    shape = full.new_zeros(count, body.shape_size)
    # the pelvis is not drawn: its place is the rest place, its velocity that of the translation
    positions[:, 0] += body.rest_joints(shape)[:, 0] * level
    velocities[:, 0] = full[:, -6:-3]

    prior = PosePrior.load(weights=PoseWeights(pose=1e-5, shape=1e-5))
    motion = _fitted(positions, shape, body, prior)
    return (
        State(
            translation=motion.translation[:, 0] * (1 - level),
            velocity=full[:, -6:-3],
            root=motion.rotations[:, 0, 0],
            angular_velocity=full[:, -3:],
            pose=motion.rotations[:, 0, 1:],
            joints=body.pose(motion).joints[:, 0] - motion.translation[:, 0, None] * level,
            joint_velocities=velocities,
        ),
        motion.shape,
    )


def _fitted(
    positions: Float[Tensor, "clips 22 3"],
    shape: Float[Tensor, "clips shape"],
    body: BodyModel,
    prior: PosePrior,
) -> Motion:
    rotations = torch.eye(3).to(positions).repeat(len(positions), 1, len(JOINTS), 1, 1)
    rotations[:, :, 0] = positions.new_tensor(_FACING)
    pelvis = body.rest_joints(shape)[:, 0]
    start = Motion.create((positions[:, 0] - pelvis)[:, None], rotations, shape, REFERENCE_FPS)
    data = Term("joints", _Joints(positions), 1.0)
    scene = Scene.create(len(positions), like=positions)
    estimate, _ = run_stages(prior.stages((data,)), body, start, scene)
    return estimate.motion.detach()
