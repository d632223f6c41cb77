"""A prior of your own in one file: every pose is near those of one recorded motion.

    python examples/09_own_prior.py

A prior is a change of variables with energies, and says by which stages it is fitted. Give it to
`recon.fit` as an object, or by the place of its class, `prior="my_module:NearPoses"`, whose
`load()` is then called. This one comes from the very walk that it is tried on, and the built-in
pose prior is better all the same.
"""

from importlib import resources

import torch

import recon
from recon.core import rotations as so3
from recon.method.free import FreeMotion, FreeVariables
from recon.method.protocols import Decoded
from recon.method.terms import joint_acceleration, prior_energy, shape
from recon.simulation.points import Corruption, joints3d
from recon.solver.lbfgs import LBFGS


class NearPoses:
    """Joint rotations are normal about the mean pose of a motion."""

    def __init__(self, recorded: recon.Motion, deviation: float = 0.3) -> None:
        """Take the mean pose of a motion (no clip axis); the deviation is in radians."""
        mean = recorded.rotations[:, 1:].mean(0)
        u, _, v = torch.linalg.svd(mean)
        self.mean, self.deviation = u @ v, deviation

    @classmethod
    def load(cls) -> "NearPoses":
        """The prior of the bundled walk."""
        with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
            return cls(recon.load_motion(path).motion)

    def encode(self, motion: recon.Motion) -> FreeVariables:
        return FreeMotion().encode(motion)

    def decode(self, variables: FreeVariables) -> Decoded:
        motion = FreeMotion().decode(variables).motion
        away = so3.log(self.mean.mT @ motion.rotations[..., 1:, :, :]) / self.deviation
        squared = away.square().sum((-1, -2)).where(motion.valid, 0.0)
        return Decoded(motion, {"pose": 0.5 * squared.sum(-1) * 30 / motion.fps})

    def stages(self, data: tuple[recon.Term, ...]) -> tuple[recon.Stage, ...]:
        near = recon.Term("pose", prior_energy("pose"), 1e-3)
        smooth = recon.Term("acceleration", joint_acceleration, 15.0)
        usual = recon.Term("shape", shape, 1e-5)
        place = frozenset({"translation", "root"})
        everything = place | {"pose", "shape"}
        return (
            recon.Stage("root", FreeMotion(), data, place, LBFGS(max_iterations=30)),
            recon.Stage("all", self, (*data, near, smooth, usual), everything, LBFGS(80)),
        )


def main() -> None:
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        walk = recon.load_motion(path).motion
    truth = walk.window(0, 30)
    seen = joints3d(truth, body, Corruption(noise=0.04, missing_points=0.3), seed=0)
    for prior in (NearPoses.load(), "pose"):
        result = recon.fit(seen, prior=prior)
        error = (result.joints - body.pose(truth).joints).norm(dim=-1).mean()
        print(f"{prior if isinstance(prior, str) else 'own'}: {100 * float(error):.2f} cm")


if __name__ == "__main__":
    main()
