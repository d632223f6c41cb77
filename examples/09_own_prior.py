"""A prior of your own in one file: every pose is near those of one recorded motion.

    python examples/09_own_prior.py

A prior changes variables into a motion (`decode`) and back (`encode`), and says in energies how
likely the variables are. Those of `FreeMotion` are the motion itself. Give your prior to
`recon.fit` as an object, or by the place of its class, whose `load(weights, body)` is then called:
`prior="own_prior:NearPoses"` in Python, and in a shell
`recon fit joints.npz --prior own_prior:NearPoses --out motion.npz`. Once a package registers the
class as an entry point `recon.priors`, its name is enough.

It works with all sensors, in recordings of any length, and where the ground is not known. This one
comes from the very walk that it is tried on, and the built-in pose prior is better all the same.
"""

from dataclasses import dataclass
from pathlib import Path

import torch

import recon
from recon.method import Decoded, FreeMotion

DEMO = Path(recon.__file__).parent / "assets" / "demo.npz"


@dataclass(frozen=True)
class NearPoses(FreeMotion):
    """Joint rotations are normal about a mean pose: -log p = ½ Σ (angle / deviation)²."""

    mean: torch.Tensor
    """Rotation matrices of the 21 joints below the root, (21, 3, 3)."""
    deviation: float = 0.3
    """Radians per axis."""

    @classmethod
    def load(cls, weights, body):
        """The prior of a motion file's poses, or with `open` of the bundled walk's."""
        motion = recon.load_motion(DEMO if weights == "open" else weights).motion
        u, _, v = torch.linalg.svd(motion.rotations[:, 1:].mean(0))
        return cls((u @ v).to(body.template))

    def decode(self, variables):
        motion = super().decode(variables).motion
        # |A - B|² of rotation matrices is twice the square of a small angle between them
        away = (motion.rotations[..., 1:, :, :] - self.mean.to(motion.rotations)) / self.deviation
        squared = 0.5 * away.square().sum((-1, -2, -3)).where(motion.valid, 0.0)
        return Decoded(motion, {"pose": 0.5 * squared.sum(-1) * 30 / motion.fps})


def main():
    seen = recon.simulate(DEMO, "joints3d", noise=0.04, missing_points=0.3, frames=(0, 30))
    for prior in (NearPoses.load("open", seen.body), "pose"):
        error = recon.evaluate(recon.fit(seen, prior=prior), seen.truth)["joints_all"]
        print(f"{prior if isinstance(prior, str) else 'own'}: {100 * error:.2f} cm")


if __name__ == "__main__":
    main()
