"""The naive roll-out computes what ours does: objective and gradient of the last stage."""

from dataclasses import replace

import pytest
import torch

from benchmarks.naive_humor import NaiveHumor
from benchmarks.rollout import Problem, drawn


@pytest.mark.parametrize(("clips", "frames"), [(1, 8), (2, 4)])
def test_objective_and_gradient_are_the_same(clips: int, frames: int) -> None:
    humor = drawn(64).to(dtype=torch.float64)
    problem, naive = Problem.create(humor, clips, frames), NaiveHumor.of(humor)
    value, gradients = problem.ours()
    expected, by_naive = problem.naive(naive)
    torch.testing.assert_close(value, expected, rtol=1e-12, atol=0)
    assert gradients.keys() == by_naive.keys() == problem.free
    for name, gradient in gradients.items():
        scale = float(by_naive[name].abs().max())
        assert scale > 0
        torch.testing.assert_close(gradient, by_naive[name], rtol=0, atol=1e-9 * scale)


def test_the_naive_one_forms_gradients_of_the_weights_and_ours_does_not() -> None:
    humor = drawn(64)
    problem, naive = Problem.create(humor, 1, 3), NaiveHumor.of(humor)
    problem.ours()
    problem.naive(naive)
    assert all(p.grad is None for p in humor.networks.parameters())
    assert all(p.grad is not None for p in naive.networks.decoder.parameters())
    assert all(p.grad is not None for p in naive.networks.prior_net.parameters())


def test_every_term_counts() -> None:
    """A term left out on one side would be seen."""
    humor = drawn(64).to(dtype=torch.float64)
    problem, naive = Problem.create(humor, 1, 4), NaiveHumor.of(humor)
    whole, _ = problem.ours()
    for k, term in enumerate(problem.terms):
        some = replace(problem, terms=(*problem.terms[:k], *problem.terms[k + 1 :]))
        less, _ = some.naive(naive)
        assert (whole - less).abs() > 0, term.name
