"""The ablated variants of HuMoR: what they leave out, and that they learn and load again."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from benchmarks.ablations import (
    ABLATIONS,
    LearningMvae,
    LearningNoDelta,
    Mvae,
    NoDelta,
    StandardPrior,
    learn,
    load_ablations,
    output_of,
    step_to,
)
from priors.humor.networks import LATENT, HumorNetworks
from priors.humor.state import Frame, State, compose, rest_pelvis, states_of
from priors.humor.steps import explain
from recon.body.model import BodyModel
from tests.priors.test_pose import swinging
from tests.training.test_humor import folder, settings_of

__all__ = ["folder"]


def pairs() -> tuple[State, State]:
    """Neighbouring states, in the frames of the first; axes (clips, steps)."""
    world = worlds()
    frame, pelvis = Frame.of(world[:, :-1]), rest_pelvis(world[:, :1])
    return frame.enter(world[:, :-1], pelvis), frame.enter(world[:, 1:], pelvis)


def worlds() -> State:
    body = BodyModel.load().to(dtype=torch.float64)
    return states_of(swinging(12, 0)[None], body)


def test_a_decoder_without_delta_can_say_every_state() -> None:
    before, after = pairs()
    contacts = torch.randn(*before.translation.shape[:-1], 9, dtype=torch.float64)
    output = torch.cat((output_of(after), contacts), -1)
    reached, logits = compose(before, step_to(before.pack(), output))
    for name, value in reached.tensors().items():
        torch.testing.assert_close(value, after.tensors()[name])
    torch.testing.assert_close(logits, contacts)
    # upright bodies are turned by about pi: their vectors must not jump
    root = output_of(after)[..., 6:9]
    assert (root.norm(dim=-1) - torch.pi).abs().max() < 0.7
    assert root.diff(dim=-2).norm(dim=-1).max() < 0.2


def test_without_delta_the_next_state_does_not_depend_on_what_the_output_is_added_to() -> None:
    networks = NoDelta(64).double()
    before, _ = pairs()
    x, latent = before.pack(), torch.zeros(*before.translation.shape[:-1], LATENT).double()
    output = HumorNetworks.decode(networks, x, latent)
    reached, _ = compose(before, networks.decode(x, latent))
    torch.testing.assert_close(
        reached.joints, output[..., 75 - 66 + 66 : 75 + 66].unflatten(-1, (22, 3))
    )


def test_a_standard_prior_is_surprised_by_every_latent_that_is_not_zero() -> None:
    networks = StandardPrior(64).double()
    world = worlds()
    pelvis = rest_pelvis(world[:, 0])
    before, after = pairs()
    mean, log_variance = networks.posterior(before.pack(), after.pack())
    expected = 0.5 * (log_variance.exp() + mean.square() - 1 - log_variance).sum(-1)
    torch.testing.assert_close(explain(networks, world, pelvis).surprise, expected)


def test_what_learns_is_what_fits() -> None:
    """Scales folded in, an ablated network is the same function."""
    world = worlds().map(torch.Tensor.float)
    scaling = LearningNoDelta.scaling_of(world, rest_pelvis(world[:, 0]))
    learning = LearningMvae(HumorNetworks(64), scaling).eval()
    plain = Mvae(64)
    plain.load_state_dict(learning.plain().state_dict())
    before, after = (state.map(torch.Tensor.float) for state in pairs())
    x, latent = before.pack(), torch.randn(*before.translation.shape[:-1], LATENT)
    reached = [compose(before, n.decode(x, latent))[0].pack() for n in (plain, learning)]
    torch.testing.assert_close(*reached, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(plain.prior(x), learning.prior(x))
    # before it has learned anything it is somewhere near the mean state, not at the origin
    assert (reached[1] - after.pack()).abs().mean() < 0.2


def test_a_variant_learns_once_and_loads(folder: Path, tmp_path: Path) -> None:
    settings = replace(settings_of(folder, tmp_path / "mvae", steps=3), noise=0.0)
    settings = replace(settings, losses=ABLATIONS["mvae"].losses)
    path = learn(ABLATIONS["mvae"], settings, samples=300)
    written = path.stat().st_mtime_ns
    assert learn(ABLATIONS["mvae"], settings).stat().st_mtime_ns == written
    humor = ABLATIONS["mvae"].load(path)
    assert isinstance(humor.networks, Mvae)
    assert isinstance(humor.to(dtype=torch.float64).networks, Mvae)
    assert ABLATIONS["mvae"].method(humor, 0.04).weights.contact_velocity == 0
    assert ABLATIONS["full"].method(humor, 0.04).weights.contact_velocity > 0
    with pytest.raises(FileNotFoundError, match=r"full\.safetensors"):
        load_ablations(tmp_path)
