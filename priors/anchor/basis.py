"""Cycles as few numbers: slow cosines of time, then directions in which cycles vary."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from priors.anchor.frames import ANCHORS, POSE_NUMBERS, ROW_NUMBERS
from priors.cosines import cosines
from recon.core.struct import TensorStruct

COSINES = 24
"""Cosines that a channel is made of; what is left out turns joints by a third of a degree."""
CODES = (ROW_NUMBERS - 1) * COSINES + 1
"""Numbers of a cycle before principal directions: cosines of pose and translation, duration."""
_PLACE = (POSE_NUMBERS / 3) ** 0.5
_TIME = (POSE_NUMBERS * ANCHORS / 3) ** 0.5
"""Worth of a translation's and of the duration's error beside that of a pose's number, where every
loss is a mean over its own numbers."""
_LEAST_SPAN = 0.01
"""Metres or seconds that normalised numbers extend over, at least."""
_LEAST = 0.02
"""Deviation of a direction, beside that of the first, below which it is not scaled up further."""
_ROUNDING = 1e-4
"""Deviation of a direction, beside that of the first, below which it is rounding and not variance:
single precision leaves about 1e-6 of it in directions in which no cycle differs from another."""


@dataclass(frozen=True)
class CycleBasis(TensorStruct):
    """Linear map between the rows chi of a cycle and coefficients of about unit variance.

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

    @classmethod
    def fit(cls, rows: Float[Tensor, "cycles 100 124"], basis: int) -> "CycleBasis":
        """A basis fitted to training cycles.

        Raises:
            ValueError: when there are fewer cycles than directions asked for.
        """
        if len(rows) <= basis:
            raise ValueError(f"{basis} directions need more cycles than {len(rows)}")
        low, high = rows[..., POSE_NUMBERS:].amin((0, 1)), rows[..., POSE_NUMBERS:].amax((0, 1))
        low = torch.cat((low[:3], low.new_zeros(1)))
        high = high.maximum(low + _LEAST_SPAN)
        plain = cls(low, high, rows.new_zeros(CODES), torch.eye(CODES)[:0], rows.new_zeros(0))
        codes = plain.codes(plain.normalised(rows))
        mean = codes.mean(0)
        _, lengths, directions = torch.linalg.svd(codes - mean, full_matrices=False)
        deviation = lengths[:basis] / math.sqrt(len(rows) - 1)
        return cls(low, high, mean, directions[:basis].contiguous(), deviation)

    @property
    def scale(self) -> Float[Tensor, " basis"]:
        """The standard deviation that one unit of each coefficient stands for."""
        return self.deviation.clamp(min=_LEAST * float(self.deviation[0]))

    @property
    def whitening(self) -> Float[Tensor, " basis"]:
        """Factors that give every coefficient unit variance over the training cycles.

        Directions without variance, whose deviation is rounding, are not blown up to it.
        """
        return self.scale / self.deviation.clamp(min=_ROUNDING * float(self.deviation[0]))

    def normalised(
        self, rows: Float[Tensor, "*batch anchors 124"]
    ) -> Float[Tensor, "*batch anchors 124"]:
        """Rows chi in the units of the losses."""
        span = self.high - self.low
        rest = (rows[..., POSE_NUMBERS:] - self.low) / span
        rest = torch.cat((2 * rest[..., :3] - 1, rest[..., 3:]), -1)
        return torch.cat((rows[..., :POSE_NUMBERS], rest), -1)

    def metric(
        self, normalised: Float[Tensor, "*batch anchors 124"]
    ) -> Float[Tensor, "*batch anchors 124"]:
        """The inverse of `normalised`: radians-free 6D, metres, seconds."""
        span = (self.high - self.low) / self.high.new_tensor([2.0, 2.0, 2.0, 1.0])
        low = self.low + span * span.new_tensor([1.0, 1.0, 1.0, 0.0])
        scale = torch.cat((span.new_ones(POSE_NUMBERS), span))
        return torch.cat((low.new_zeros(POSE_NUMBERS), low)) + scale * normalised

    def codes(self, normalised: Float[Tensor, "*batch 100 124"]) -> Float[Tensor, "*batch codes"]:
        """Cosines of every channel and the duration, each worth what the losses make of it."""
        waves = cosines(ANCHORS, COSINES).to(normalised)
        slow = waves.mT @ normalised[..., :-1] * _worth(normalised)
        return torch.cat((slow.flatten(-2), _TIME * normalised[..., -1, -1:]), -1)

    def from_codes(self, codes: Float[Tensor, "*batch codes"]) -> Float[Tensor, "*batch 100 124"]:
        """Normalised rows; times grow evenly from zero to the duration."""
        slow = codes[..., :-1].unflatten(-1, (COSINES, ROW_NUMBERS - 1)) / _worth(codes)
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
        """Normalised rows of coefficients."""
        return self.from_codes(self.mean + (coefficients * self.scale) @ self.directions)


def _worth(like: Tensor) -> Float[Tensor, " channels"]:
    return torch.cat((like.new_ones(POSE_NUMBERS), like.new_full((3,), _PLACE)))
