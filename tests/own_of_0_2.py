"""A sensor as plug-ins of 0.2.0 wrote it: with residuals of its own, clock and mask by hand."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

import recon
from observations.records.sensor import SensorRecord
from observations.timing import at_observation_times, padded
from recon.core.residuals import Residuals, Unit
from recon.core.skeleton import JOINTS
from recon.method.protocols import Estimate


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
