"""The frames that a stream still moves, in the variables of the pose density."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from priors.pose.density import PoseDensity
from recon.core import rotations as so3
from recon.core.struct import TensorStruct

VARIABLES = 69
"""Variables of one frame: translation, a step of the root's rotation, coordinates of the pose."""


@dataclass(frozen=True)
class Window(TensorStruct):
    """A stretch of motion; `step` moves it."""

    translation: Float[Tensor, "time 3"]
    """SMPL translation, metres."""
    root: Float[Tensor, "time 3 3"]
    """Rotation of the root in the world."""
    pose: Float[Tensor, "time 63"]
    """Coordinates z of `PoseDensity`."""

    @classmethod
    def of(
        cls,
        translation: Float[Tensor, "time 3"],
        rotations: Float[Tensor, "time 22 3 3"],
        density: PoseDensity,
    ) -> "Window":
        """The variables of a motion; exact."""
        return cls(translation, rotations[:, 0], density.coordinates(rotations[:, 1:]))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.translation)

    def rotations(self, density: PoseDensity) -> Float[Tensor, "time 22 3 3"]:
        """Rotations of all joints relative to their parents."""
        return torch.cat((self.root[:, None], density.rotations(self.pose)), 1)

    def moved(self, steps: Float[Tensor, "active 69"]) -> "Window":
        """The window with its last frames moved, the root by R Exp(step)."""
        place, turn, pose = steps.split((3, 3, VARIABLES - 6), -1)
        held = self.frames - len(steps)
        return Window(
            torch.cat((self.translation[:held], self.translation[held:] + place)),
            torch.cat((self.root[:held], self.root[held:] @ so3.exp(turn))),
            torch.cat((self.pose[:held], self.pose[held:] + pose)),
        )

    def extended(self, damping: float) -> "Window":
        """One frame more, in which the motion of the last two goes on, slowed by a factor."""
        before, last = self[-2:-1], self[-1:]
        turn = so3.log(before.root.mT @ last.root)
        return Window(
            torch.cat((self.translation, last.translation.lerp(before.translation, -damping))),
            torch.cat((self.root, last.root @ so3.exp(damping * turn))),
            torch.cat((self.pose, last.pose.lerp(before.pose, -damping))),
        )
