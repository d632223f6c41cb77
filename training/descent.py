"""Helpers of all trainings: random latent codes, KL divergence, the optimiser Muon."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor


def drawn_code(mean: Tensor, log_variance: Tensor, random: torch.Generator | None) -> Tensor:
    """Draw from a normal distribution, differentiably; return the mean if `random` is None."""
    if random is None:
        return mean
    noise = torch.randn(mean.shape, generator=random).to(mean)
    return mean + noise * (0.5 * log_variance).exp()


def divergence_from_normal(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL(N(mean, variance) || N(0, 1)) of every number, nats."""
    return 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance)


_QUINTIC = (3.4445, -4.7750, 2.0315)
"""Coefficients of the iteration X <- a X + b (X Xᵀ) X + c (X Xᵀ)² X, published."""
_ITERATIONS, _MOMENTUM, _SCALE = 5, 0.95, 0.2
_BETAS, _EPS = (0.9, 0.99), 1e-8


class Muon(torch.optim.Optimizer):
    """Muon for some matrices and AdamW for other parameters, at one learning rate."""

    def __init__(
        self, matrices: Iterable[Tensor], others: Iterable[Tensor], lr: float, weight_decay: float
    ) -> None:
        """Store the settings; momentum buffers are created in the first step."""
        groups = [
            {"params": list(matrices), "orthogonal": True},
            {"params": list(others), "orthogonal": False},
        ]
        super().__init__(groups, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Take one step against the gradients of the parameters that have one."""
        del closure
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                state = self.state[parameter]
                update = _muon_step if group["orthogonal"] else _adam_step
                parameter.mul_(1 - group["lr"] * group["weight_decay"])
                parameter.add_(update(parameter.grad, state), alpha=-group["lr"])


def orthogonalised(matrix: Float[Tensor, "rows columns"]) -> Float[Tensor, "rows columns"]:
    """Approximately orthogonalised matrix: its singular values are between 0.7 and 1.2."""
    a, b, c = _QUINTIC
    wide = matrix if matrix.shape[0] <= matrix.shape[1] else matrix.mT
    x = wide / wide.norm().clamp(min=1e-12)
    for _ in range(_ITERATIONS):
        gram = x @ x.mT
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x if wide is matrix else x.mT


def _muon_step(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Muon's update of a weight matrix from its gradient, for a learning rate of one."""
    momentum = state.setdefault("momentum", torch.zeros_like(gradient))
    momentum.lerp_(gradient, 1 - _MOMENTUM)
    ahead = gradient.lerp(momentum, _MOMENTUM)
    return _SCALE * max(gradient.shape) ** 0.5 * orthogonalised(ahead)


def _adam_step(gradient: Tensor, state: dict[str, Any]) -> Tensor:
    """Adam's update of a parameter from its gradient, for a learning rate of one."""
    first = state.setdefault("first", torch.zeros_like(gradient))
    second = state.setdefault("second", torch.zeros_like(gradient))
    count = state["count"] = state.get("count", 0) + 1
    first.lerp_(gradient, 1 - _BETAS[0])
    second.lerp_(gradient.square(), 1 - _BETAS[1])
    scale = (second / (1 - _BETAS[1] ** count)).sqrt() + _EPS
    return first / (1 - _BETAS[0] ** count) / scale
