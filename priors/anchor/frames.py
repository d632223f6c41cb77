"""A cycle of motion as 100 anchor frames, so that cycles of any length have equally many numbers.

Marsot et al., section 3: anchors lie evenly in time from the cycle's first moment to its last,
so that cycles of any duration are of one size; each carries the time it stands for.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from priors.cosines import cosines
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


@dataclass(frozen=True)
class Anchors(TensorStruct):
    """Gait cycles, each described by 100 anchor frames that are evenly spaced in time."""

    rotations: Float[Tensor, "*batch anchors 20 3 3"]
    """Relative to the parent joint; the root in the world, or in the frame of the first anchor."""
    translation: Float[Tensor, "*batch anchors 3"]
    """SMPL translation, metres."""
    times: Float[Tensor, "*batch anchors"]
    """Seconds since the first anchor."""

    @classmethod
    def of(cls, motion: Motion) -> "Anchors":
        """Return 100 anchors of a motion (batched or not) that is one cycle from end to end."""
        last = motion.duration
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
        """Rotations of all 22 joints; the toe joints, which anchors lack, have the identity."""
        shape = (*self.rotations.shape[:-3], len(JOINTS), 3, 3)
        every = torch.eye(3).to(self.rotations).expand(shape).clone()
        every[..., POSED, :, :] = self.rotations
        return every

    def motion(self, shape: Float[Tensor, "*batch shape"], fps: float) -> Motion:
        """Return the anchor frames as a motion of a body, with `fps` anchors per second."""
        return Motion.create(self.translation, self.full_rotations, shape, fps)

    def pack(self) -> Float[Tensor, "*batch anchors 124"]:
        """Return rows of anchors: 6D rotations minus the identity's, translation (m), time (s)."""
        columns = so3.to_6d(self.rotations)
        pose = (columns - columns.new_tensor(_IDENTITY)).flatten(-2)
        return torch.cat((pose, self.translation, self.times[..., None]), -1)

    @classmethod
    def unpack(cls, rows: Float[Tensor, "*batch anchors 124"]) -> "Anchors":
        """Return the anchors whose packed rows (`pack`) are given; makes rotations orthonormal."""
        columns = rows[..., :POSE_NUMBERS].unflatten(-1, (len(POSED), 6))
        return cls(
            rotations=so3.from_6d(columns + columns.new_tensor(_IDENTITY)),
            translation=rows[..., POSE_NUMBERS:-1],
            times=rows[..., -1],
        )

    def carried(
        self, T: Float[Tensor, "*batch 4 4"], pelvis: Float[Tensor, "*batch 3"]
    ) -> "Anchors":
        """Gait cycles moved by a rigid transform; the root turns about the unposed `pelvis`."""
        root = T[..., None, None, :3, :3] @ self.rotations[..., :1, :, :]
        return self.replace(
            rotations=torch.cat((root, self.rotations[..., 1:, :, :]), -3),
            translation=carried_translation(self.translation, T, pelvis),
        )

    def aligned(
        self, pelvis: Float[Tensor, "*batch 3"]
    ) -> tuple["Anchors", Float[Tensor, "*batch 4 4"]]:
        """The cycles in the frame of their first anchor, and T_world_cycle, the transform back.

        The first root faces +y, and its translation is zero but for the height. The published
        alignment takes away all rotation and translation, so that which way is up is lost.
        """
        start = self.translation[..., 0, :]
        turn = so3.undo_heading(self.rotations[..., 0, 0, :, :])
        kept = start * start.new_tensor([0.0, 0.0, 1.0])
        shift = kept + pelvis - (turn @ (start + pelvis)[..., None])[..., 0]
        return self.carried(so3.rigid(turn, shift), pelvis), so3.rigid(
            turn.mT, -(turn.mT @ shift[..., None])[..., 0]
        )


def rest_pelvis(
    body: BodyModel, shape: Float[Tensor, "*batch shape"]
) -> Float[Tensor, "*batch 3"]:
    """Position of the unposed body's pelvis, metres: motions are rotated about it."""
    return body.rest_joints(shape)[..., 0, :]


COSINES = 24
"""Cosines that a channel is made of; what is left out turns joints by a third of a degree."""
CODES = (ROW_NUMBERS - 1) * COSINES + 1
"""Numbers of a cycle before principal directions: cosines of pose and translation, duration."""
_PLACE = (POSE_NUMBERS / 3) ** 0.5
_TIME = (POSE_NUMBERS * ANCHORS / 3) ** 0.5
"""Worth of a translation's and of the duration's error beside that of a pose's number, where every
loss is a mean over its own numbers."""
_LEAST = 0.02
"""Deviation of a direction, beside that of the first, below which it is not scaled up further."""
_ROUNDING = 1e-4
"""Deviation of a direction, beside that of the first, below which it is rounding and not variance:
single precision leaves about 1e-6 of it in directions in which no cycle differs from another."""


@dataclass(frozen=True)
class CycleBasis(TensorStruct):
    """Linear map between the numbers of a gait cycle and coefficients of about unit variance.

    Normalised as published (section 4.1): translation to [-1, 1] per axis and time to [0, 1] by
    the least and greatest of the training cycles; 6D rotations only less those of the identity.
    Anchors lie evenly in time, so that their times are one number, the duration.
    """

    low: Float[Tensor, " 4"]
    """Least translation (m) and duration (s) of the training cycles."""
    high: Float[Tensor, " 4"]
    mean: Float[Tensor, " codes"]
    directions: Float[Tensor, "basis codes"]
    """Principal directions, orthonormal."""
    deviation: Float[Tensor, " basis"]
    """Standard deviation along each."""

    @property
    def scale(self) -> Float[Tensor, " basis"]:
        """The standard deviation that one unit of each coefficient stands for."""
        return self.deviation.clamp(min=_LEAST * float(self.deviation[0]))

    @property
    def whitening(self) -> Float[Tensor, " basis"]:
        """Factors by which coefficients are multiplied to have unit variance in the training data.

        Directions without variance, whose deviation is rounding, are not blown up to it.
        """
        return self.scale / self.deviation.clamp(min=_ROUNDING * float(self.deviation[0]))

    def normalised(
        self, rows: Float[Tensor, "*batch anchors 124"]
    ) -> Float[Tensor, "*batch anchors 124"]:
        """Return packed rows of cycles (`Anchors.pack`) in the units of the training losses."""
        span = self.high - self.low
        rest = (rows[..., POSE_NUMBERS:] - self.low) / span
        rest = torch.cat((2 * rest[..., :3] - 1, rest[..., 3:]), -1)
        return torch.cat((rows[..., :POSE_NUMBERS], rest), -1)

    def denormalised(
        self, normalised: Float[Tensor, "*batch anchors 124"]
    ) -> Float[Tensor, "*batch anchors 124"]:
        """Return normalised rows in physical units again: 6D rotations, metres, seconds."""
        span = (self.high - self.low) / self.high.new_tensor([2.0, 2.0, 2.0, 1.0])
        low = self.low + span * span.new_tensor([1.0, 1.0, 1.0, 0.0])
        scale = torch.cat((span.new_ones(POSE_NUMBERS), span))
        return torch.cat((low.new_zeros(POSE_NUMBERS), low)) + scale * normalised

    def codes(self, normalised: Float[Tensor, "*batch 100 124"]) -> Float[Tensor, "*batch codes"]:
        """Return a cycle's duration and cosine coefficients over time of all other row entries."""
        waves = cosines(ANCHORS, COSINES).to(normalised)
        slow = waves.mT @ normalised[..., :-1] * _scales_of_row_entries(normalised)
        return torch.cat((slow.flatten(-2), _TIME * normalised[..., -1, -1:]), -1)

    def from_codes(self, codes: Float[Tensor, "*batch codes"]) -> Float[Tensor, "*batch 100 124"]:
        """Return the normalised rows of a cycle from its cosine coefficients and duration."""
        slow = codes[..., :-1].unflatten(-1, (COSINES, ROW_NUMBERS - 1)) / _scales_of_row_entries(
            codes
        )
        even = torch.linspace(0, 1, ANCHORS, dtype=codes.dtype, device=codes.device)
        times = codes[..., -1:, None] / _TIME * even[:, None]
        return torch.cat((cosines(ANCHORS, COSINES).to(codes) @ slow, times), -1)

    def analyse(self, rows: Float[Tensor, "*batch 100 124"]) -> Float[Tensor, "*batch basis"]:
        """Coefficients of cycles."""
        codes = self.codes(self.normalised(rows))
        return (codes - self.mean) @ self.directions.mT / self.scale

    def synthesise(
        self, coefficients: Float[Tensor, "*batch basis"]
    ) -> Float[Tensor, "*batch 100 124"]:
        """Return the normalised anchor rows of cycles from their coefficients in this basis."""
        return self.from_codes(self.mean + (coefficients * self.scale) @ self.directions)


def _scales_of_row_entries(like: Tensor) -> Float[Tensor, " channels"]:
    return torch.cat((like.new_ones(POSE_NUMBERS), like.new_full((3,), _PLACE)))
