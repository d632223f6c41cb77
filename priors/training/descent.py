"""One step of an optimiser, and the average of the weights over time that is the result."""

import math
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor, nn


@runtime_checkable
class Descending(Protocol):
    """A training run, as far as a step of it goes."""

    optimiser: torch.optim.Optimizer
    step: int

    @property
    def networks(self) -> nn.Module:
        """The networks that are trained."""
        ...

    @property
    def averaged(self) -> nn.Module:
        """Their average over time."""
        ...


def descend(run: Descending, loss: Tensor, rate: float, clip: float, average: float) -> None:
    """One step against the gradient of a loss; none where the gradient is not finite.

    Args:
        run: whose step it is.
        loss: one number.
        rate: learning rate of this step.
        clip: longest gradient.
        average: share of the averaged weights that is kept; less in the first steps.
    """
    run.optimiser.zero_grad()
    loss.backward()
    norm = torch.nn.utils.clip_grad_norm_(run.networks.parameters(), clip)
    for group in run.optimiser.param_groups:
        group["lr"] = rate
    if bool(norm.isfinite()):
        run.optimiser.step()
    run.step += 1
    keep = min(average, run.step / (run.step + 10))
    with torch.no_grad():
        for mean, now in zip(run.averaged.parameters(), run.networks.parameters(), strict=True):
            mean.lerp_(now, 1 - keep)


def cosine(progress: float) -> float:
    """Factor of a learning rate that falls from 1 to a hundredth as progress goes from 0 to 1."""
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress))
