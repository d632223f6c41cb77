"""Stretches of motion as few numbers: overlapping windows, and directions in which they vary."""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from priors.humos.frames import NUMBERS
from recon.core.struct import TensorStruct

HOP = 8
"""Frames from one window to the next: 0.4 s at 20 Hz."""
WINDOW = 2 * HOP
_LEAST = 0.02
"""Deviation of a direction, beside that of the first, below which it is not scaled up further."""


@dataclass(frozen=True)
class LappedBasis(TensorStruct):
    """Linear map between the rows of a motion and coefficients of about unit variance.

    Window k holds frames 8 (k - 1), ..., 8 (k + 1) - 1, each times a sine window whose squares
    add up to one over neighbours; rows beyond the ends repeat the first and the last. So the sum
    of all windows is the motion again, and no seam is seen where some directions are left out.
    """

    mean: Float[Tensor, " window_numbers"]
    directions: Float[Tensor, "basis window_numbers"]
    """Principal directions of windows, orthonormal."""
    deviation: Float[Tensor, " basis"]
    """Standard deviation along each, metres."""

    @classmethod
    def fit(cls, rows: Float[Tensor, "clips time numbers"], basis: int) -> "LappedBasis":
        """A basis fitted to stretches of motion, each of two hops or longer.

        Raises:
            ValueError: when there are fewer windows than directions asked for.
        """
        windows = _cut(rows)[:, 1:-1].flatten(0, 1)
        if len(windows) <= basis:
            raise ValueError(f"{basis} directions need more windows than {len(windows)}")
        mean = windows.mean(0)
        away = (windows - mean).double()
        values, vectors = torch.linalg.eigh(away.mT @ away / (len(windows) - 1))
        deviation = values.flip(0)[:basis].clamp(min=0).sqrt().float()
        return cls(mean, vectors.flip(1).mT[:basis].float().contiguous(), deviation)

    @property
    def scale(self) -> Float[Tensor, " basis"]:
        """Metres that one unit of a coefficient is."""
        return self.deviation.clamp(min=_LEAST * float(self.deviation[0]))

    def analyse(
        self, rows: Float[Tensor, "*batch time numbers"]
    ) -> Float[Tensor, "*batch windows basis"]:
        """Coefficients of all windows of a motion."""
        return (_cut(rows) - self.mean) @ self.directions.mT / self.scale

    def synthesise(
        self, coefficients: Float[Tensor, "*batch windows basis"], frames: int
    ) -> Float[Tensor, "*batch time numbers"]:
        """The first frames of a motion of these coefficients."""
        windows = self.mean + (coefficients * self.scale) @ self.directions
        return _lay(windows.unflatten(-1, (WINDOW, NUMBERS)), frames)


def windows_of(frames: int) -> int:
    """Windows that so many frames are cut into."""
    return math.ceil(frames / HOP) + 1


def existing_windows(
    count: Int[Tensor, "*batch 1"], frames: int
) -> Bool[Tensor, "*batch windows"]:
    """Windows that hold one of the first `count` of so many frames."""
    first = torch.arange(windows_of(frames), device=count.device) * HOP
    return first < count + HOP


def _cut(rows: Float[Tensor, "*batch time numbers"]) -> Float[Tensor, "*batch windows all"]:
    """Windows of the motion, flattened."""
    frames = rows.shape[-2]
    count = windows_of(frames)
    place = torch.arange(-HOP, count * HOP, device=rows.device).clamp(0, frames - 1)
    padded = rows[..., place, :]
    windows = padded.unfold(-2, WINDOW, HOP).transpose(-1, -2)
    return (windows * _sine().to(rows)[:, None]).flatten(-2)


def _lay(
    windows: Float[Tensor, "*batch windows 16 numbers"], frames: int
) -> Float[Tensor, "*batch time numbers"]:
    """Windows laid over each other and added up."""
    weighed = windows * _sine().to(windows)[:, None]
    early, late = weighed[..., 1:, :HOP, :], weighed[..., :-1, HOP:, :]
    return (early + late).flatten(-3, -2)[..., :frames, :]


@lru_cache(maxsize=1)
def _sine() -> Float[Tensor, " window"]:
    return ((torch.arange(WINDOW) + 0.5) * math.pi / WINDOW).sin()
