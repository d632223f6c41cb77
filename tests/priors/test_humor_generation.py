"""Motions that HuMoR makes up: they begin where they should and go where its steps lead."""

from dataclasses import replace

import pytest
import torch

from priors.humor import generation
from priors.humor.generation import (
    body_at_joints,
    first_states,
    predict,
    roll_out_from,
    sample,
)
from priors.humor.mixture import Mixture
from priors.humor.state import (
    Frame,
    State,
    canonical_state,
    independent_features,
    initial_features,
    rest_pelvis,
    states_of,
)
from priors.humor.unrolled import FrozenDecoder, roll_out
from recon.body.contacts import heights_in_contact, rest_heights
from recon.body.model import BodyModel
from recon.core.motion import padded_batch
from recon.core.skeleton import CONTACT_JOINTS, FEET
from tests.priors.test_humor import humor, motions
from tests.priors.test_pose import swinging


def as_predicted(state: State, _: torch.Tensor) -> State:
    return state


def test_steps_as_predicted_are_those_of_the_roll_out(
    body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The prior's means as given latents lead to the same motion, joints and contacts."""
    prior = humor(body)
    state, shape = states_of(motions(), body)[:, 0], motions().shape
    monkeypatch.setattr(generation, "body_at_joints", as_predicted)
    found = roll_out_from(prior, state, shape, 5, None, footing=None)
    pelvis, frame = prior.pelvis(shape), Frame.of(state)
    start = frame.to_frame(state, pelvis).pack()
    decoder = FrozenDecoder.of(prior.networks.decoder)
    latents = torch.zeros(2, 4, 48, dtype=torch.float64)
    for step in range(4):
        inputs = roll_out(decoder, start, pelvis, latents).inputs
        latents[:, step] = prior.networks.prior(inputs[:, step])[0]
    rollout = roll_out(decoder, start, pelvis, latents)
    states = rollout.in_world(frame, pelvis)
    assert found.contacts is not None
    assert found.joints is not None
    torch.testing.assert_close(found.motion.translation[:, 1:], states.translation)
    torch.testing.assert_close(found.motion.rotations[:, 1:, 0], states.root)
    torch.testing.assert_close(found.motion.rotations[:, 1:, 1:], states.pose)
    torch.testing.assert_close(found.joints[:, 1:], states.joints)
    said = found.contacts[:, 1:, list(CONTACT_JOINTS)]
    torch.testing.assert_close(said, rollout.contacts.sigmoid())
    assert torch.equal(found.contacts[:, 0], found.contacts[:, 1])
    with pytest.raises(ValueError, match="two frames"):
        roll_out_from(prior, state, shape, 1, None)


def test_the_body_is_moved_so_that_joints_agree_on_average(body: BodyModel) -> None:
    state, shape = states_of(motions(), body)[:, 0], motions().shape
    rest = body.rest_joints(shape)
    up = torch.tensor([0.0, 0.0, 0.22], dtype=torch.float64)
    one_off = state.joints.clone()
    one_off[:, 4] += up
    predicted = state.replace(joints=one_off)
    moved = body_at_joints(predicted, rest)
    torch.testing.assert_close(moved.translation, state.translation + up / 22)
    torch.testing.assert_close(moved.joints, state.joints + up / 22)
    motion = roll_out_from(humor(body), state, shape, 5, None)
    assert motion.joints is not None
    torch.testing.assert_close(body.pose(motion.motion).joints, motion.joints)


def test_latents_have_the_priors_spread(body: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """A decoder that gives its latent away: the first step of many samples has its variance."""
    prior = humor(body, still=True)
    decoder = prior.networks.decoder
    # the step's height is one number of the latent, past what layers before it make of it
    decoder.net[9].weight[2, -48] = 1.0
    first = states_of(motions(), body)[:1, 0]
    mean, log_variance = prior.networks.prior(canonical_state(first, rest_pelvis(first)).pack())
    many = first.map(lambda t: t.expand(4000, *t.shape[1:]))
    shape = motions().shape[:1].expand(4000, -1)
    random = torch.Generator().manual_seed(0)
    monkeypatch.setattr(generation, "body_at_joints", as_predicted)
    made = roll_out_from(prior, many, shape, 2, random, footing=None).motion
    step = made.translation[:, 1, 2] - made.translation[:, 0, 2]
    expected = (0.5 * log_variance[0, 0]).exp()
    torch.testing.assert_close(step.std(), expected, rtol=0.05, atol=0)  # 4000 draws: 1 %
    torch.testing.assert_close(step.mean(), mean[0, 0], rtol=0, atol=float(expected) / 15)


def test_predictions_start_where_the_motion_ends(body: BodyModel) -> None:
    prior = humor(body)
    motion = motions()
    found = predict(prior, motion, 5, 3, torch.Generator().manual_seed(0)).motion
    assert found.translation.shape == (6, 5, 3)
    assert found.start_time == pytest.approx(7 / 30)  # seconds
    for k in range(6):
        torch.testing.assert_close(found.rotations[k, 0], motion.rotations[k % 2, -1])
        torch.testing.assert_close(found.shape[k], motion.shape[k % 2])
    assert not torch.allclose(found.translation[0, -1], found.translation[2, -1])
    again = predict(prior, motion, 5, 3, torch.Generator().manual_seed(0)).motion
    assert torch.equal(found.translation, again.translation)
    mean = predict(prior, motion, 5, 2, None).motion
    assert torch.equal(mean.translation[:2], mean.translation[2:])
    with pytest.raises(ValueError, match="missing frames at their ends"):
        predict(prior, padded_batch([swinging(6, 20), swinging(9, 21)]), 5, 1, None)


def test_a_prediction_goes_on_from_the_last_frame_at_any_rate(body: BodyModel) -> None:
    """24 frames at 100 Hz end between two frames at 30 Hz; its velocity is of its last step."""
    motion = swinging(24, 3, fps=100.0)[None]
    found = predict(humor(body, still=True), motion, 3, 1, None, footing=None).motion
    assert found.fps == 30
    assert found.start_time == pytest.approx(0.23)  # seconds
    torch.testing.assert_close(found.rotations[:, 0], motion.rotations[:, -1])
    torch.testing.assert_close(found.translation[:, 2], motion.translation[:, -1])  # it is still


def test_samples_have_the_first_joints_that_were_drawn() -> None:
    body = BodyModel.load()
    prior = humor(body, still=True)
    high = motions().to(dtype=torch.float32)
    high = high.replace(translation=high.translation + torch.tensor([0.0, 0.0, 0.5]))
    states = states_of(high, body)[:, 0]
    wanted = initial_features(canonical_state(states, rest_pelvis(states)))[
        :, independent_features()
    ]
    size = wanted.shape[1]
    covariances = 1e-6 * torch.eye(size, dtype=torch.float64).expand(2, size, size)
    mixture = Mixture.create(
        torch.tensor([0.5, 0.5]), wanted.double(), covariances, independent_features()
    )
    prior = replace(prior, initial=mixture)
    found = sample(prior, 4, 6, torch.Generator().manual_seed(0)).motion
    assert found.translation.shape == (6, 4, 3)
    joints = body.pose(found).joints[:, 0].flatten(1)
    features = joints[:, independent_features()[: 66 - 2]]
    nearest = torch.cdist(features, wanted[:, : 66 - 2]).amin(1)
    assert (nearest < 0.05).all()  # metres, over all joints; a draw is 1 mm off in each number
    sunk = wanted.double().clone()
    sunk[:, : 66 - 2 : 3] -= 1.5  # the heights
    below = Mixture.create(torch.tensor([0.5, 0.5]), sunk, covariances, independent_features())
    raised, shape = first_states(below, body, 6, torch.Generator().manual_seed(0))
    touching = heights_in_contact(rest_heights(body, shape))[:, FEET]
    lowest = (raised.joints[:, FEET, 2] - touching).amin(-1)
    torch.testing.assert_close(lowest, torch.zeros(6), atol=1e-5, rtol=0)
    identity = torch.eye(138).expand(1, 138, 138)
    released = replace(prior, initial=Mixture.create(torch.ones(1), identity[0, :1], identity))
    with pytest.raises(ValueError, match="independent features"):
        sample(released, 4, 2, torch.Generator())
