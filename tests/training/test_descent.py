"""One step of training: clipped, averaged, and none where the gradient is not finite."""

from copy import deepcopy
from dataclasses import dataclass

import pytest
import torch

from training.descent import cosine, descend


@dataclass
class Run:
    networks: torch.nn.Linear
    averaged: torch.nn.Linear
    optimiser: torch.optim.Optimizer
    step: int = 0


def a_run() -> Run:
    networks = torch.nn.Linear(1, 1, bias=False)
    torch.nn.init.ones_(networks.weight)
    averaged = deepcopy(networks).requires_grad_(False)
    optimiser = torch.optim.SGD(networks.parameters(), lr=1.0)
    return Run(networks, averaged, optimiser)


def test_a_step_is_clipped_and_averaged():
    run = a_run()
    descend(run, 100 * run.networks.weight.sum(), rate=0.1, clip=2.0, average=0.995)
    assert run.networks.weight.item() == pytest.approx(1 - 0.1 * 2.0)
    # after the first step one eleventh of the average is kept
    assert run.averaged.weight.item() == pytest.approx((1 + 10 * 0.8) / 11)
    assert run.step == 1


def test_a_gradient_that_is_not_finite_moves_nothing():
    run = a_run()
    descend(run, run.networks.weight.sum() * torch.inf, rate=0.1, clip=1.0, average=0.995)
    assert run.networks.weight.item() == 1.0
    assert run.step == 1


def test_rates_fall_to_a_hundredth():
    assert cosine(0.0) == pytest.approx(1.0)
    assert cosine(0.5) == pytest.approx(0.505)
    assert cosine(1.0) == pytest.approx(0.01)
