"""A sensor of your own in one file: inertial units on limbs, which measure how bones are turned.

    python examples/08_own_sensor.py

A sensor is a frozen record of data; `predict` says what it would have measured of a posed body.
With `reads` and `load` it opens files: `recon fit units.npz --reader own_sensor:Imus --out w.npz`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

import recon
from recon.core.rotations import exp
from recon.core.skeleton import joint_index
from recon.method import PosedBody, Sensor


@dataclass(frozen=True)
class Imus(Sensor):
    """How bones are turned in a world with z up, as inertial units with a compass tell it."""

    unit: ClassVar = "radians"  # a chord of a unit circle is an angle, nearly
    vectors: ClassVar = "directions"
    typical_noise: ClassVar = (0.05, 0.015)  # radians; metres at a hand or foot
    values: Tensor  # (clips, frames, points, 3): the x, y and z axis of every unit's bone
    shown: Tensor  # (clips, frames, points)
    bones: tuple[int, ...]
    fps: float
    start_time: float = 0.0
    ground_known: bool = True
    level: bool = True

    def predict(self, body: PosedBody) -> Tensor:
        return body.orientations[..., list(self.bones), :, :].mT.flatten(-3, -2)

    @classmethod
    def reads(cls, path: Path) -> bool:
        return path.suffix == ".npz" and "orientations" in np.load(path).files

    @classmethod
    def load(cls, path: Path, body: recon.BodyModel) -> "Imus":
        del body  # names of joints are enough
        file = np.load(path)
        axes = torch.from_numpy(file["orientations"]).float().mT.flatten(-3, -2)
        bones = tuple(map(joint_index, file["bones"]))
        return cls(axes, torch.ones(axes.shape[:-1], dtype=torch.bool), bones, float(file["fps"]))


def main() -> None:
    torch.manual_seed(0)
    truth = recon.load_motion(Path(recon.__file__).parent / "assets/demo.npz").motion.window(0, 30)
    turns = recon.BodyModel.load().pose(truth).orientations[:, [0, 9, 15, 18, 19, 4, 5]]
    noisy = turns @ exp(0.05 * torch.randn(*turns.shape[:-1]))
    worn = ("pelvis", "spine3", "head", "left_elbow", "right_elbow", "left_knee", "right_knee")
    np.savez("units.npz", orientations=noisy, bones=worn, fps=truth.fps)
    units = recon.load_observation("units.npz", reader=f"{__name__}:Imus")
    (view,) = recon.simulate(truth, "keypoints2d", noise=3.0)
    for name, seen in (("units", [units]), ("camera", [view]), ("both", [view, units])):
        average = [0.0] if seen == [units] else None  # turns alone tell no size
        found = recon.evaluate(recon.fit(seen, prior="pose", shape=average), truth)
        print(f"{name}: joints {100 * found['pa_joints']:.1f} cm after a similarity")


if __name__ == "__main__":
    main()
