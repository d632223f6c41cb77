"""The compact inverse Hessian is the dense BFGS update, element by element."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from recon.solver.curvature import Curvature

pytestmark = pytest.mark.numerics


@settings(derandomize=True, deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), pairs=st.integers(0, 9))
def test_direction_equals_the_dense_bfgs_update(seed: int, pairs: int) -> None:
    """Against H <- (I - r s y')H(I - r y s') + r s s' over the last four pairs, two elements
    of which the second skips every other pair."""
    n, slots = 5, 4
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=generator)

    root = random(n, n)
    hessian = root @ root.T + torch.eye(n, dtype=torch.float64)
    curvature = Curvature.empty(2, n, slots, torch.device("cpu"))
    gradient = random(2, n)
    known: list[list[tuple[Tensor, Tensor]]] = [[], []]
    found = curvature.direction(gradient, torch.arange(0))
    for k in range(pairs):
        rows = torch.arange(2 if k % 2 == 0 else 1)
        step = random(len(rows), n)
        change = step @ hessian
        gradient = gradient.clone()
        gradient[rows] += change
        curvature.add(rows, step, change)
        found = curvature.direction(gradient, rows)
        for row in rows.tolist():
            known[row].append((step[row], change[row]))

    identity = torch.eye(n, dtype=torch.float64)
    for row, history in enumerate(known):
        if history:
            s, y = history[-1]
            inverse = (s @ y) / (y @ y) * identity
        else:
            inverse = min(1.0, 1.0 / gradient[row].abs().sum().item()) * identity
        for s, y in history[-slots:]:
            left = identity - torch.outer(s, y) / (s @ y)
            inverse = left @ inverse @ left.T + torch.outer(s, s) / (s @ y)
        torch.testing.assert_close(found[row], -inverse @ gradient[row], rtol=1e-8, atol=1e-8)
