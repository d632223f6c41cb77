"""A sensor of your own in one file: radio beacons that measure how far away a tag is.

    python examples/08_own_sensor.py

An observation holds its data and has three methods: the energy, the residuals behind it, and a
first guess. Here tags on wrists and ankles add to joints of the trunk. `recon.solve` takes any
observation; `recon.fit` and the command line take the four built-in kinds only.
"""

from dataclasses import dataclass
from importlib import resources

import torch
from jaxtyping import Float
from torch import Tensor

import recon
from priors import PosePrior
from recon.core.residuals import Residuals
from recon.core.skeleton import joint_index
from recon.core.struct import TensorStruct
from recon.method.protocols import REFERENCE_FPS, Estimate
from recon.simulation.points import Corruption, joints3d

TAGS = tuple(joint_index(f"{s}_{j}") for s in ("left", "right") for j in ("wrist", "ankle"))
TRUNK = tuple(joint_index(n) for n in ("pelvis", "spine3", "left_shoulder", "right_shoulder"))


@dataclass(frozen=True)
class Ranges(TensorStruct):
    """Distances in metres between beacons and tags, at the frames of the motion."""

    beacons: Float[Tensor, "*batch beacons 3"]
    """Places of the beacons in the world, metres."""
    distances: Float[Tensor, "*batch moments points"]
    """Measured distances, metres; a point is a pair of a tag and a beacon."""
    seen: Float[Tensor, "*batch moments points"]
    """1 where a distance was measured, 0 elsewhere."""
    fps: float

    def residuals(self, estimate: Estimate) -> Residuals:
        """Measured minus predicted distance of every pair, metres."""
        tags = estimate.body.joints[..., list(TAGS), None, :]
        predicted = (tags - self.beacons[..., None, None, :, :]).norm(dim=-1).flatten(-2)
        values = (self.distances - predicted) * self.seen
        return Residuals(values[..., None], self.seen, "metres")

    def __call__(self, estimate: Estimate) -> Float[Tensor, "*batch"]:
        """½ Σ residual² over what was measured, taken at 30 Hz; metres²."""
        squared = self.residuals(estimate).values.square().sum((-3, -2, -1))
        return 0.5 * squared * (REFERENCE_FPS / self.fps)

    def start(self, body: recon.BodyModel) -> recon.Motion:  # noqa: ARG002
        """Distances alone tell no first guess: another observation has to come first."""
        raise ValueError("ranges give no first guess: put another observation before them")


def main() -> None:
    torch.manual_seed(0)
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 30)
    joints = body.pose(truth).joints[None]
    beacons = torch.tensor(
        [[[4.0, 4.0, 0.1], [-4.0, 4.0, 2.5], [4.0, -4.0, 2.5], [-4.0, -4.0, 0.1]]]
    )
    exact = (joints[..., list(TAGS), None, :] - beacons[:, None, None]).norm(dim=-1).flatten(-2)
    measured = exact + 0.03 * torch.randn(exact.shape)
    ranges = Ranges(beacons, measured, torch.ones_like(measured), truth.fps)

    every = joints3d(truth, body, Corruption(noise=0.01), seed=0)[None]
    trunk = recon.Joints3D(
        every.positions[..., list(TRUNK), :], every.visible[..., list(TRUNK)], TRUNK, truth.fps
    )
    for name, seen in (("trunk", [trunk]), ("trunk and ranges", [trunk, ranges])):
        weights = [1.0, (0.01 / 0.03) ** 2][
            : len(seen)
        ]  # inverse variances, relative to the first
        result = recon.solve(seen, PosePrior.load(), body, weights=weights)
        error = (result.body.joints - joints)[..., list(TAGS), :].norm(dim=-1).mean()
        print(f"{name}: wrists and ankles off by {100 * float(error):.1f} cm")


if __name__ == "__main__":
    main()
