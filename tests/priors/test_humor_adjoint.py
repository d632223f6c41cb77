"""The written-out derivative of the roll-out against the recorded and the numerical one."""

import pytest
import torch
from torch import Tensor

from priors.humor.loop import (
    STATE_ORDER,
    FrozenDecoder,
    RolledOutSteps,
    _rolled_out,
    roll_out_with_biases,
)
from priors.humor.networks import HumorNetworks
from recon.core import rotations as so3
from tests.priors.test_humor_nets import golden

STEPS = 4


def problem(clips: int) -> tuple[FrozenDecoder, Tensor, Tensor]:
    """Frozen weights, a start in the loop's layout and what is added to the layers."""
    torch.manual_seed(2)
    decoder = FrozenDecoder.of(HumorNetworks(64).double().decoder)
    g = golden("humor_rollout")
    names = ("trans", "trans_vel", "root_orient", "root_orient_vel", "pose_body", "joints")
    packed = torch.cat([g[f"init_canonical_{name}"] for name in (*names, "joints_vel")], -1)
    latents = torch.randn(STEPS, clips, 48, dtype=torch.float64)
    added = decoder.constant_inputs(latents, torch.zeros(clips, 3, dtype=torch.float64))
    return decoder, packed[:clips, STATE_ORDER].requires_grad_(), added.requires_grad_()


def recorded(decoder: FrozenDecoder, start: Tensor, added: Tensor) -> RolledOutSteps:
    return _rolled_out(decoder, start, added)[0]


def tensors(made: RolledOutSteps) -> tuple[Tensor, ...]:
    return made.inputs, made.vectors, made.turns, made.rest


@pytest.mark.parametrize("clips", [1, 2])
def test_it_is_the_recorded_derivative(clips: int) -> None:
    decoder, start, added = problem(clips)
    results: list[tuple[Tensor, ...]] = []
    for made in (roll_out_with_biases(decoder, start, added), recorded(decoder, start, added)):
        torch.manual_seed(3)
        value = torch.stack([(t * torch.randn_like(t)).sum() for t in tensors(made)]).sum()
        results.append((value, *torch.autograd.grad(value, (start, added))))
    for ours, expected in zip(*results, strict=True):
        torch.testing.assert_close(ours, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("output", range(4))
def test_it_is_the_numerical_derivative(output: int) -> None:
    decoder, start, added = problem(2)

    def one(start: Tensor, added: Tensor) -> Tensor:
        return tensors(roll_out_with_biases(decoder, start, added))[output]

    assert torch.autograd.gradcheck(one, (start, added), fast_mode=True)


def test_it_is_exact_where_nothing_turns() -> None:
    """Rotation vectors of length zero, whose direction is undefined."""
    networks = HumorNetworks(64).double().requires_grad_(False)
    for parameter in networks.decoder.parameters():
        parameter.zero_()
    decoder = FrozenDecoder.of(networks.decoder)
    _, start, added = problem(2)
    still = torch.zeros_like(added).requires_grad_()
    turns = roll_out_with_biases(decoder, start, still).turns
    (found,) = torch.autograd.grad(turns[0, 0, 5, 1, 2], still)
    spin = found[0, 0, decoder.of_constants.shape[1] - 216 + 139 :][15:18]
    # R' = Exp(2 h) R, so at h = 0 the derivative by h_k is 2 hat(e_k) R
    rotation = start[0, 139:].view(22, 3, 3)[5]
    expected = 2 * (so3.hat(torch.eye(3, dtype=torch.float64)) @ rotation)[:, 1, 2]
    torch.testing.assert_close(spin, expected)


def test_it_can_be_asked_twice_and_leaves_what_it_is_given() -> None:
    decoder, start, added = problem(2)
    made = tensors(roll_out_with_biases(decoder, start, added))
    given = tuple(torch.randn_like(t) for t in made)
    kept = tuple(t.clone() for t in given)
    first = torch.autograd.grad(made, (start, added), given, retain_graph=True)
    second = torch.autograd.grad(made, (start, added), given)
    for a, b in zip(first, second, strict=True):
        assert torch.equal(a, b)
    for a, b in zip(given, kept, strict=True):
        assert torch.equal(a, b)


def test_a_second_derivative_is_refused() -> None:
    decoder, start, added = problem(1)
    value = roll_out_with_biases(decoder, start, added).vectors.square().sum()
    (gradient,) = torch.autograd.grad(value, start, create_graph=True)
    with pytest.raises(RuntimeError, match="differentiate twice"):
        gradient.sum().backward()


def test_one_step_is_enough() -> None:
    decoder, start, added = problem(2)
    value = roll_out_with_biases(decoder, start, added[:1]).rest.sum()
    (gradient,) = torch.autograd.grad(value, start)
    assert gradient.abs().max() > 0
