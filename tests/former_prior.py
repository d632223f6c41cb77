"""A prior as a package wrote it for version 0.2: no base class, `method`, and `Traits`."""

from dataclasses import dataclass
from importlib import resources
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

import recon
from recon.core import rotations as so3
from recon.method.free import FreeMotion, FreeVariables
from recon.method.priors import Traits
from recon.method.protocols import Decoded
from recon.method.stages import Stage
from recon.method.terms import Term, joint_acceleration, prior_energy, shape
from recon.solver.lbfgs import LBFGS


@dataclass(frozen=True)
class NearPoses:
    """Joint rotations are normal about a mean pose."""

    traits: ClassVar[Traits] = Traits(knows_gravity=False)
    mean: Float[Tensor, "21 3 3"]
    deviation: float = 0.3
    """Radians per axis."""

    @classmethod
    def of(cls, recorded: recon.Motion) -> "NearPoses":
        """About the mean pose of a motion without an axis of clips."""
        u, _, v = torch.linalg.svd(recorded.rotations[:, 1:].mean(0))
        return cls(u @ v)

    @classmethod
    def load(cls, weights: str, body: recon.BodyModel) -> "NearPoses":
        """The prior of a motion file's poses, or with `open` of the bundled walk's."""
        if weights != "open":
            return cls.of(recon.load_motion(weights).motion)
        with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
            walk = recon.load_motion(path).motion
        return cls.of(walk.to(device=body.template.device, dtype=body.template.dtype))

    def method(self, noise: float, body: recon.BodyModel) -> "NearPosesFit":
        """How it is fitted to data that are off by so many metres per coordinate."""
        del body  # any will do
        return NearPosesFit(self, max(noise, 0.008))

    def encode(self, motion: recon.Motion) -> FreeVariables:
        return FreeMotion().encode(motion)

    def decode(self, variables: FreeVariables) -> Decoded:
        motion = FreeMotion().decode(variables).motion
        away = (
            so3.log(self.mean.to(motion.rotations).mT @ motion.rotations[..., 1:, :, :])
            / self.deviation
        )
        squared = away.square().sum((-1, -2)).where(motion.valid, 0.0)
        return Decoded(motion, {"pose": 0.5 * squared.sum(-1) * 30 / motion.fps})


@dataclass(frozen=True)
class NearPosesFit:
    """The root first, then everything. Weights stand beside ½ |residual|² in metres²."""

    prior: NearPoses
    noise: float

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage, ...]:
        near = Term("pose", prior_energy("pose"), 0.6 * self.noise**2)
        smooth = Term("acceleration", joint_acceleration, 9400 * self.noise**2)
        usual = Term("shape", shape, 1e-5)
        place = frozenset({"translation", "root"})
        everything = place | {"pose", "shape"}
        return (
            Stage("root", FreeMotion(), data, place, LBFGS(30)),
            Stage("all", self.prior, (*data, near, smooth, usual), everything, LBFGS(80)),
        )
