"""Finds the cheapest sequence of states over time (Viterbi's algorithm)."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def cheapest_path(
    cost: Float[Tensor, "batch time states"],
    change: Float[Tensor, "*#batch between states states"],
) -> Int[Tensor, "batch time"]:
    """Return the states over time whose summed cost is least (Viterbi's algorithm).

    Args:
        cost: of every state in every frame.
        change: cost of going from a state (last axis but one) to one of the next frame.
    """
    best, back = cost[:, 0], list[Tensor]()
    for own, between in zip(cost.unbind(1)[1:], change.unbind(-3), strict=True):
        reached = (best[:, :, None] + between).min(1)
        back.append(reached.indices)
        best = reached.values + own
    path = [best.argmin(-1)]
    for came in reversed(back):
        path.append(came.gather(1, path[-1][:, None])[:, 0])
    return torch.stack(path[::-1], 1)
