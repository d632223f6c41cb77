"""From settings to methods: a prior for the noise, and stages left out or added."""

import pytest
import torch

from observations.joints3d import Joints3D
from priors.humor.collocation import Collocation
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.fitting.methods import FitOptions
from recon.fitting.stages import from_first_pose_stage, prior_stages, with_physics
from recon.method.reconstruction import solve
from recon.method.terms import Term
from recon.physics import energies as physics
from recon.physics.energies import physics_terms
from tests.filmed import bundled
from tests.standing_body import path, standing, times

pytestmark = pytest.mark.numerics


def data() -> tuple[Term, ...]:
    return (Term("data", lambda estimate: estimate.motion.translation.sum((-1, -2)), 1.0),)


@pytest.mark.parametrize("prior", ["pose", "humor", "priors.humos.prior:Humos"])
def test_every_prior_goes_with_physics(prior):
    """Terms of the same name are there once."""
    settings = FitOptions(prior=prior, physics=1.0)
    stages = prior_stages(settings, 0.02, BodyModel.load())(data())
    names = [term.name for term in stages[-1].terms]
    assert len(names) == len(set(names))
    assert {"penetration", "slide"} <= set(names)


def test_the_prior_asked_for_with_weights_for_the_noise():
    weak, strong = (
        prior_stages(FitOptions(prior="pose"), noise, bundled())(data())[-1].prior
        for noise in (0.02, 0.08)
    )
    assert isinstance(weak, PosePrior)
    assert isinstance(strong, PosePrior)
    assert strong.effective_weights.pose == pytest.approx(16 * weak.effective_weights.pose)
    humor = prior_stages(FitOptions(prior="humor"), 0.02, bundled())(data())[-1].prior
    assert isinstance(humor, Collocation)


def test_weights_that_the_caller_chose_are_kept():
    chosen = PoseWeights(2e-4, 1.67e-4, velocity=10.0)
    prior = PosePrior.load(weights=chosen)
    last = prior_stages(FitOptions(prior=prior), 0.02, bundled())(data())[-1]
    assert isinstance(last.prior, PosePrior)
    assert last.prior.weights == chosen


@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_one_image_does_not_place_the_rest_body_again(prior):
    """It would trade stretched limbs against distance."""
    every = prior_stages(FitOptions(prior=prior), 0.02, bundled())(data())
    some = from_first_pose_stage(every)
    assert [stage.name for stage in every[-len(some) :]] == [stage.name for stage in some]
    assert not some[0].free <= {"translation", "root"}
    dropped = every[: len(every) - len(some)]
    assert all(stage.free <= {"translation", "root"} for stage in dropped)
    assert len(dropped) == 1


def test_missing_weights_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        prior_stages(FitOptions(weights=str(tmp_path / "none.safetensors")), 0.02, bundled())


@pytest.mark.parametrize("prior", ["pose", "humor"])
def test_physics_is_a_stage_more_that_weighs_what_was_asked_for(prior):
    before, weak, strong = (
        prior_stages(FitOptions(prior=prior, physics=much), 0.02, bundled())(data())
        for much in (0.0, 1.0, 2.0)
    )
    assert [stage.name for stage in weak] == [*(stage.name for stage in before), "physics"]
    assert weak[-1].prior is weak[-2].prior  # so that it goes on from its variables
    assert weak[-1].free == weak[-2].free
    kept = {term.name: term.weight for term in before[-1].terms}
    added = {term.name: term.weight for term in physics_terms(0.02)}
    assert {term.name: term.weight for term in weak[-1].terms} == kept | added
    doubled = {name: 2 * weight for name, weight in added.items()}
    assert {t.name: t.weight for t in strong[-1].terms} == pytest.approx(kept | doubled)


def test_physics_grows_with_the_noise_as_data_do():
    weak, strong = physics_terms(0.02), physics_terms(0.04)
    for one, other in zip(weak, strong, strict=True):
        assert other.weight == pytest.approx(4 * one.weight)
    assert [t.weight for t in physics_terms(0.0)] == [t.weight for t in physics_terms(0.008)]


@pytest.mark.parametrize("much", [-1.0, float("nan"), float("inf")])
def test_physics_that_rewards_what_it_should_punish_is_refused(much):
    with pytest.raises(ValueError, match="at least 0"):
        prior_stages(FitOptions(prior="pose", physics=much), 0.02, bundled())


def test_physics_puts_a_body_back_on_its_feet():
    """Joints seen 3 cm too low, and feet that glide by 1 cm a frame."""
    body = bundled()
    moment = times(0.4, 30.0)
    still = standing(body.to(dtype=torch.float64), path(like=moment), 30.0).to(dtype=torch.float32)
    truth = body.pose(still).joints
    shift = torch.zeros_like(truth)
    shift[..., 2] = -0.03
    shift[:, [7, 8, 10, 11], 0] = 0.3 * moment.float()[:, None]
    positions = truth + shift + 0.01 * torch.randn(truth.shape)
    seen = Joints3D(
        positions=positions[None],
        visible=torch.ones(1, *truth.shape[:-1], dtype=torch.bool),
        joints=tuple(range(22)),
        fps=30.0,
    )
    plain = PosePrior.load()
    without = solve([seen], plain, body)
    held = solve(
        [seen], lambda data: with_physics(plain.stages(data), physics_terms(0.04), 20), body
    )
    for energy in (physics.penetration, physics.slide):
        assert float(energy(held.estimate)) < 0.1 * float(energy(without.estimate))
    errors = [(r.body.joints - truth).norm(dim=-1).mean().item() for r in (without, held)]
    assert errors[1] < errors[0]
