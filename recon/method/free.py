"""The fit without a prior: its variables are the motion itself."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, carried_translation
from recon.core.struct import TensorStruct
from recon.method.priors import Prior
from recon.method.protocols import Decoded


@dataclass(frozen=True)
class FreeVariables(TensorStruct):
    """A motion as steps away from a base: R = base · Exp(step)."""

    translation: Float[Tensor, "*batch time 3"]
    root: Float[Tensor, "*batch time 3"]
    """Rotation step of the root, radians."""
    pose: Float[Tensor, "*batch time 21 3"]
    """Rotation steps of the body joints, radians."""
    shape: Float[Tensor, "*batch shape"]
    base: Float[Tensor, "*batch time 22 3 3"]
    valid: Bool[Tensor, "*batch time"]
    fps: float
    start_time: float

    def carried(self, T: Float[Tensor, "*batch 4 4"], body: BodyModel) -> "FreeVariables":
        """Return the variables of the motion after a rigid transform of the world."""
        pelvis = body.rest_joints(self.shape)[..., 0, :]
        root = T[..., None, None, :3, :3] @ self.base[..., :1, :, :]
        return self.replace(
            translation=carried_translation(self.translation, T, pelvis),
            base=torch.cat((root, self.base[..., 1:, :, :]), -3),
        )


@dataclass(frozen=True)
class FreeMotion(Prior[FreeVariables]):
    """The trivial prior: every motion is equally likely."""

    knows_gravity: ClassVar[bool] = False

    def encode(self, motion: Motion) -> FreeVariables:
        """Return variables whose base is the given motion and whose steps are zero."""
        zero = torch.zeros_like(motion.rotations[..., 0])
        return FreeVariables(
            translation=motion.translation,
            root=zero[..., 0, :],
            pose=zero[..., 1:, :],
            shape=motion.shape,
            base=motion.rotations,
            valid=motion.valid,
            fps=motion.fps,
            start_time=motion.start_time,
        )

    def decode(self, variables: FreeVariables) -> Decoded:
        """Return the motion whose rotations are base · Exp(step)."""
        steps = torch.cat((variables.root[..., None, :], variables.pose), -2)
        return Decoded(
            Motion(
                translation=variables.translation,
                rotations=variables.base @ so3.exp(steps),
                shape=variables.shape,
                valid=variables.valid,
                fps=variables.fps,
                start_time=variables.start_time,
            )
        )
