"""A prior of your own in one file: every pose is near those of one recorded motion.

    python examples/09_own_prior.py

A prior is a change of variables with energies, and a method says by which stages it is fitted to
data that are so noisy. Give it to `recon.fit` as an object, or by the place of its class, whose
`load(weights, body)` is then called: `prior="own_prior:NearPoses"` in Python, and in a shell
`recon fit joints.npz --prior own_prior:NearPoses --out motion.npz`. Once a package registers the
class as an entry point `recon.priors`, its name is enough.

It works with all sensors, in recordings of any length, and where the ground is not known. This one
comes from the very walk that it is tried on, and the built-in pose prior is better all the same.
"""

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
from recon.simulation.points import Corruption, joints3d
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


def main() -> None:
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        walk = recon.load_motion(path).motion
    truth = walk.window(0, 30)
    seen = joints3d(truth, body, Corruption(noise=0.04, missing_points=0.3), seed=0)
    for prior in (NearPoses.load("open", body), "pose"):
        result = recon.fit(seen, prior=prior)
        error = (result.joints - body.pose(truth).joints).norm(dim=-1).mean()
        print(f"{prior if isinstance(prior, str) else 'own'}: {100 * float(error):.2f} cm")


if __name__ == "__main__":
    main()
