"""GradNorm (Chen et al. 2018): weights of losses that balance how fast each is learned."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

LEAST = 0.5
"""Weight no loss falls below. The times of anchors are learned at once; their gradient then
vanishes, and equal gradients would leave no weight to the others."""
_FIRST = 20
"""Steps over which the first losses are averaged."""


@dataclass
class GradNorm:
    """Weights of some losses; their sum is their number.

    With g_i the norm of a loss' gradient in shared parameters and G_i = w_i g_i, every weight
    follows its target mean(G) r_i^alpha, r_i how much slower than the others the loss falls.
    """

    names: tuple[str, ...]
    alpha: float = 0.5
    rate: float = 0.025
    """Relative change of a weight per step."""
    weights: dict[str, float] = field(default_factory=dict)
    first: dict[str, float] = field(default_factory=dict)
    """Losses of the first steps."""
    steps: int = 0

    def __post_init__(self) -> None:
        """All weights are one before the first step."""
        if not self.weights:
            self.weights = dict.fromkeys(self.names, 1.0)

    def update(self, losses: Mapping[str, Tensor], shared: Tensor) -> None:
        """One step of the weights, before the network's own.

        Args:
            losses: unweighted, on the graph.
            shared: parameters, or activations, that all losses depend on.
        """
        value = {name: losses[name].item() for name in self.names}
        self.steps += 1
        if self.steps <= _FIRST:
            share = 1 / self.steps
            self.first = {
                name: (1 - share) * self.first.get(name, 0.0) + share * value[name]
                for name in self.names
            }
        norms = {name: gradient_norm(losses[name], shared) for name in self.names}
        scaled = {name: self.weights[name] * norms[name] for name in self.names}
        mean = sum(scaled.values()) / len(scaled)
        left = {name: value[name] / max(self.first[name], 1e-12) for name in self.names}
        average = max(sum(left.values()) / len(left), 1e-12)
        for name in self.names:
            target = mean * (left[name] / average) ** self.alpha
            sign = (scaled[name] > target) - (scaled[name] < target)
            self.weights[name] = max(self.weights[name] * (1 - self.rate * sign), LEAST)
        total = sum(self.weights.values())
        self.weights = {name: w * len(self.names) / total for name, w in self.weights.items()}

    def total(self, losses: Mapping[str, Tensor]) -> Tensor:
        """The weighted sum."""
        return torch.stack([self.weights[name] * losses[name] for name in self.names]).sum()


def gradient_norm(loss: Tensor, shared: Tensor) -> float:
    """Length of a loss' gradient in shared tensors; the graph is kept."""
    (gradient,) = torch.autograd.grad(loss, shared, retain_graph=True)
    return gradient.norm().item()
