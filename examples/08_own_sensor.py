"""A sensor of your own in one file: inertial units on limbs, which measure how bones are turned.

    python examples/08_own_sensor.py

A sensor is a frozen record with its data inside. It says what it would have measured of an
estimated body; energies, noise, windows of long recordings and reports follow from that. Here
units add to one camera, and are fitted alone, where they tell the posture of a body whose size is
given, but not the place.

`reads` and `load` open its files: `recon fit units.npz --reader own_sensor:Imus --out walk.npz`;
`--reader` is not needed once a package registers the class as an entry point `recon.observations`.
"""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

import recon
from observations.records.sensor import SensorRecord
from observations.timing import at_observation_times, padded
from recon.core import rotations as so3
from recon.core.camera import full_hd_camera
from recon.core.residuals import Residuals, Unit
from recon.core.skeleton import JOINTS, joint_index
from recon.method.protocols import Estimate
from recon.reading.images import keypoints_of
from recon.simulation.images import dome, keypoints2d
from recon.simulation.points import Corruption


@dataclass(frozen=True)
class Imus(SensorRecord):
    """Orientations of bones in a world with z up, as inertial units with a compass give them."""

    unit: ClassVar[Unit] = "radians"
    level: ClassVar[bool] = True
    timed: ClassVar[tuple[str, ...]] = ("axes", "worn")
    typical_noise: ClassVar[tuple[float, float]] = (
        0.05,
        0.015,
    )  # radians; metres at a hand or foot
    axes: Float[Tensor, "*batch moments points 3"]
    """Three points for every unit: where the x, y and z axes of its bone point in the world."""
    worn: Bool[Tensor, "*batch moments points"]
    """Whether it was measured."""
    bones: tuple[int, ...]
    """The joint at which the bone of each unit begins; see `recon.core.skeleton.JOINTS`."""
    fps: float
    start_time: float = 0.0
    ground_known: bool = True

    @classmethod
    def of(cls, orientations: Tensor, bones: tuple[int, ...], fps: float) -> "Imus":
        """The sensor of rotation matrices R_world_bone, axes (moments, units, 3, 3)."""
        axes = orientations.mT.flatten(-3, -2)
        return cls(axes, torch.ones(axes.shape[:-1], dtype=torch.bool), bones, fps)

    @classmethod
    def reads(cls, path: Path) -> bool:
        if path.suffix != ".npz" or not path.is_file():
            return False
        with np.load(path, allow_pickle=False) as file:
            return {"orientations", "bones", "fps"} <= set(file.files)

    @classmethod
    def load(cls, path: Path, body: recon.BodyModel) -> "Imus":
        del body  # names of joints are enough
        with np.load(path, allow_pickle=False) as file:
            turns = torch.from_numpy(file["orientations"]).float()
            return cls.of(turns, tuple(map(joint_index, file["bones"])), float(file["fps"]))

    @property
    def shown(self) -> Bool[Tensor, "*batch moments points"]:
        return self.worn

    def point_names(self, body: recon.BodyModel) -> tuple[str, ...]:
        del body
        return tuple(f"{JOINTS[bone]} {axis}" for bone in self.bones for axis in "xyz")

    def residuals(self, estimate: Estimate) -> Residuals:
        """Measured minus predicted axes; a chord of a unit circle is an angle, nearly."""
        turns = estimate.body.orientations[..., list(self.bones), :, :]
        predicted, seen = at_observation_times(
            estimate.scene.to_recording_directions(turns.mT.flatten(-3, -2)), estimate.motion,
            fps=self.fps, start_time=self.start_time, moments=self.moments,
        )  # fmt: skip
        away = self.axes[..., seen, :, :] - predicted
        return padded(away, self.worn[..., seen, :], seen, self.moments, self.unit)

    def start(self, body: recon.BodyModel) -> recon.Motion:
        """A person who stands at the origin and is turned as the first unit is, on the trunk."""
        still = super().start(body)
        first = self.axes[..., :3, :].mT.where(
            self.worn[..., :1, None], still.rotations[..., 0, :, :]
        )
        return still.replace(
            rotations=torch.cat((first[..., None, :, :], still.rotations[..., 1:, :, :]), -3)
        )

    def transformed(self, T_new_old: Float[np.ndarray, "4 4"]) -> "Imus":
        turn = torch.from_numpy(T_new_old[:3, :3]).to(self.axes)
        return self.derived(axes=self.axes @ turn.mT)


def main() -> None:
    torch.manual_seed(0)
    body = recon.BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        truth = recon.load_motion(path).motion.window(0, 30)
    posed = body.pose(truth)
    worn = ("pelvis", "spine3", "head", "left_elbow", "right_elbow", "left_knee", "right_knee")
    bones = tuple(map(joint_index, worn))
    turns = posed.orientations[:, list(bones)]
    measured = turns @ so3.exp(0.05 * torch.randn(*turns.shape[:-1]))
    np.savez("units.npz", orientations=measured, bones=worn, fps=truth.fps)
    units = recon.load_observation("units.npz", reader=f"{__name__}:Imus")

    (camera,) = dome(truth, body, full_hd_camera(), 1)
    view = keypoints_of(keypoints2d(truth, body, camera, Corruption(noise=3.0), seed=0), body)
    for name, seen in (("units", [units]), ("camera", [view]), ("both", [view, units])):
        average = [0.0] if seen == [units] else None  # turns alone tell no size
        result = recon.fit(seen, prior="pose", shape=average)
        away = result.joints - posed.joints
        posture = (away - away[:, :1]).norm(dim=-1).mean()
        world = away.norm(dim=-1).mean()
        print(f"{name}: {100 * float(world):.1f} cm in the world,", end=" ")
        print(f"{100 * float(posture):.1f} cm from the pelvis on")


if __name__ == "__main__":
    main()
