"""Random smooth functions of time, for windows that show a part of a slow movement.

A window lasts a third of a second, a movement a second or more. So each window sees a random part
of a raised cosine or of a step, and all derivatives are continuous where its own are.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Chance:
    """Random numbers for a number of windows, from one generator, on one device."""

    random: torch.Generator
    like: Tensor
    """A tensor of the kind and device wanted; its first axis counts the windows."""

    def between(self, low: float, high: float) -> Float[Tensor, " windows"]:
        """Uniform numbers, one for every window."""
        drawn = torch.rand(len(self.like), generator=self.random).to(self.like)
        return low + (high - low) * drawn

    def slow(self, low: float, high: float) -> Float[Tensor, " windows"]:
        """Numbers whose logarithm is uniform."""
        drawn = torch.rand(len(self.like), generator=self.random).to(self.like)
        return low * (high / low) ** drawn

    def sign(self) -> Float[Tensor, " windows"]:
        """One or minus one."""
        drawn = torch.rand(len(self.like), generator=self.random).to(self.like)
        return torch.where(drawn < 0.5, -1.0, 1.0)

    def wave(
        self, seconds: Float[Tensor, "windows times"], shortest: float, longest: float
    ) -> Float[Tensor, "windows times"]:
        """Raised cosines between zero and one, of random period (seconds) and phase."""
        period, phase = self.slow(shortest, longest), self.between(0.0, 2 * torch.pi)
        angle = 2 * torch.pi * seconds / period[:, None] + phase[:, None]
        return 0.5 - 0.5 * angle.cos()


def step(
    seconds: Float[Tensor, "windows times"],
    start: Float[Tensor, " windows"],
    lasts: Float[Tensor, " windows"],
) -> Float[Tensor, "windows times"]:
    """A minimum-jerk movement from zero to one: 10 x³ - 15 x⁴ + 6 x⁵, at rest at both ends."""
    x = ((seconds - start[:, None]) / lasts[:, None]).clamp(0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)
