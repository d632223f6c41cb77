"""A cycle of motion as 100 anchor frames: poses, translations and times in numbers of fixed count.

Marsot et al., section 3: anchors lie evenly in time from the cycle's first moment to its last,
so that cycles of any duration are of one size; each carries the time it stands for.
"""

from dataclasses import dataclass
from enum import Enum

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, carried_translation
from recon.core.skeleton import JOINTS, TOES
from recon.core.struct import TensorStruct

ANCHORS = 100
POSED = [joint for joint in range(len(JOINTS)) if joint not in TOES]
"""The 20 joints whose rotations are kept, the root first; toes keep their rest pose."""
POSE_NUMBERS = 6 * len(POSED)
"""Numbers of a pose."""
ROW_NUMBERS = POSE_NUMBERS + 3 + 1
"""Numbers of an anchor: pose, translation, time."""
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


class Alignment(Enum):
    """The part of a cycle's place and orientation that aligning its first anchor removes."""

    YAW = "yaw"
    """Heading and place on the ground: gravity and height stay."""
    FULL = "full"
    """All of its rotation and translation, as published; which way is up is lost."""


@dataclass(frozen=True)
class Anchors(TensorStruct):
    """Cycles as anchor frames."""

    rotations: Float[Tensor, "*batch anchors 20 3 3"]
    """Relative to the parent joint; the root in the world, or in the frame of the first anchor."""
    translation: Float[Tensor, "*batch anchors 3"]
    """SMPL translation, metres."""
    times: Float[Tensor, "*batch anchors"]
    """Seconds since the first anchor."""

    @classmethod
    def of(cls, motion: Motion) -> "Anchors":
        """A motion of one cycle (batched or not), from its first to its last frame."""
        last = (motion.frames - 1) / motion.fps
        moments = torch.linspace(0, last, ANCHORS, dtype=torch.float64)
        at = motion.at(motion.start_time + moments, (ANCHORS - 1) / max(last, 1e-9))
        times = moments.to(motion.translation).expand(at.translation.shape[:-1])
        return cls(at.rotations[..., POSED, :, :], at.translation, times)

    @property
    def duration(self) -> Float[Tensor, "*batch"]:
        """Seconds from the first anchor to the last."""
        return self.times[..., -1]

    @property
    def full_rotations(self) -> Float[Tensor, "*batch anchors 22 3 3"]:
        """All joints, toes at rest."""
        shape = (*self.rotations.shape[:-3], len(JOINTS), 3, 3)
        every = torch.eye(3).to(self.rotations).expand(shape).clone()
        every[..., POSED, :, :] = self.rotations
        return every

    def motion(self, shape: Float[Tensor, "*batch shape"], fps: float) -> Motion:
        """The anchors as frames of a rate."""
        return Motion.create(self.translation, self.full_rotations, shape, fps)

    def pack(self) -> Float[Tensor, "*batch anchors 124"]:
        """The rows chi: 6D rotations less those of the identity, translation (m), time (s)."""
        columns = so3.to_6d(self.rotations)
        pose = (columns - columns.new_tensor(_IDENTITY)).flatten(-2)
        return torch.cat((pose, self.translation, self.times[..., None]), -1)

    @classmethod
    def unpack(cls, rows: Float[Tensor, "*batch anchors 124"]) -> "Anchors":
        """The inverse of `pack`; pairs of columns that are no rotation are made one."""
        columns = rows[..., :POSE_NUMBERS].unflatten(-1, (len(POSED), 6))
        return cls(
            rotations=so3.from_6d(columns + columns.new_tensor(_IDENTITY)),
            translation=rows[..., POSE_NUMBERS:-1],
            times=rows[..., -1],
        )

    def carried(
        self, T: Float[Tensor, "*batch 4 4"], pelvis: Float[Tensor, "*batch 3"]
    ) -> "Anchors":
        """Cycles after a rigid transform, given the pelvis of the unposed body."""
        root = T[..., None, None, :3, :3] @ self.rotations[..., :1, :, :]
        return self.replace(
            rotations=torch.cat((root, self.rotations[..., 1:, :, :]), -3),
            translation=carried_translation(self.translation, T, pelvis),
        )

    def aligned(
        self, alignment: Alignment, pelvis: Float[Tensor, "*batch 3"]
    ) -> tuple["Anchors", Float[Tensor, "*batch 4 4"]]:
        """The cycles in the frame of their first anchor, and T_world_cycle, which takes them back.

        `FULL`: the first root rotation is the identity, the first translation zero. `YAW`: the
        first root faces +y, and its translation is zero but for the height.
        """
        first, start = self.rotations[..., 0, 0, :, :], self.translation[..., 0, :]
        if alignment is Alignment.YAW:
            turn, kept = so3.heading(first), start * start.new_tensor([0.0, 0.0, 1.0])
        else:
            turn, kept = first.mT, torch.zeros_like(start)
        shift = kept + pelvis - (turn @ (start + pelvis)[..., None])[..., 0]
        return self.carried(so3.rigid(turn, shift), pelvis), so3.rigid(
            turn.mT, -(turn.mT @ shift[..., None])[..., 0]
        )


def rest_pelvis(
    body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> Float[Tensor, "*batch 3"]:
    """Pelvis of the unposed body, which turning a motion must leave in place, metres."""
    return body.rest_joints(shape)[..., 0, :]
