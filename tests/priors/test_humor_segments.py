"""Multiple shooting: laws that tie segments to the roll-out and to collocation."""

from dataclasses import replace

import pytest
import torch

from priors.humor.prior import Humor
from priors.humor.segments import SegmentedHumor
from priors.humor.shooting import HumorWeights, Schedule, Shooting
from priors.humor.state import states_of
from priors.humor.steps import explain
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion, pad
from recon.core.scene import Scene
from recon.method.protocols import Prior
from recon.method.running import run_stages
from recon.method.terms import Term
from tests.laws import check_heading_invariance, check_prior
from tests.priors.test_humor import humor, motions
from tests.priors.test_humor_shooting import seen_of, zero
from tests.priors.test_pose import swinging


def same(motion: Motion, other: Motion) -> None:
    torch.testing.assert_close(motion.rotations, other.rotations)
    torch.testing.assert_close(motion.translation, other.translation)
    assert torch.equal(motion.valid, other.valid)


@pytest.mark.parametrize("length", [7, 20])
def test_one_segment_is_the_rollout(body: BodyModel, length: int) -> None:
    whole, parts = humor(body), SegmentedHumor(humor(body), length)
    expected = whole.decode(whole.encode(motions()))
    found = parts.decode(parts.encode(motions()))
    same(found.motion, expected.motion)
    torch.testing.assert_close(found.joints, expected.joints)
    torch.testing.assert_close(found.contacts, expected.contacts)
    for name in ("transition", "initial"):
        torch.testing.assert_close(found.energies[name], expected.energies[name])
    assert torch.equal(found.energies["defect"], torch.zeros(2, dtype=torch.float64))


@pytest.mark.parametrize("length", [1, 3, 5])
def test_it_keeps_the_laws_of_priors(body: BodyModel, length: int) -> None:
    prior = SegmentedHumor(humor(body), length)
    assert isinstance(prior, Prior)
    shift = torch.tensor([1.0, -2.0, 0.0], dtype=torch.float64)
    check_heading_invariance(prior, motions(), 0.7, shift)
    held = torch.zeros(8, dtype=torch.long)
    still = motions().replace(
        translation=motions().translation[:, held], rotations=motions().rotations[:, held]
    )
    quiet = SegmentedHumor(humor(body, still=True), length)
    check_prior(quiet, still, tolerance=1e-6)
    defects = quiet.decode(quiet.encode(still)).energies["defect"]
    torch.testing.assert_close(defects, torch.zeros_like(defects), rtol=0, atol=1e-12)


def test_segments_of_one_step_have_the_errors_of_collocation(body: BodyModel) -> None:
    torch.manual_seed(4)
    whitening = torch.randn(207, 207, dtype=torch.float64)
    prior = replace(humor(body), error_whitening=whitening)
    states = states_of(motions(), body)
    explained = explain(prior.networks, states, prior.pelvis(motions().shape))
    errors = 0.5 * (explained.error[:, :-1] @ whitening).square().sum((-1, -2))
    parts = SegmentedHumor(prior, 1)
    found = parts.decode(parts.encode(motions()))
    torch.testing.assert_close(found.energies["defect"], errors)
    kept = found.motion.window(0, 7)
    same(kept, motions().window(0, 7))  # the last frame is the decoder's
    assert found.joints is not None
    away = (found.joints - states.joints)[:, 1:].norm(dim=-1)
    missed = explained.error[..., 75:141].unflatten(-1, (-1, 3)).norm(dim=-1)
    torch.testing.assert_close(away, missed)


def test_states_of_the_rollout_itself_differ_from_it_by_the_networks_joints_alone(
    body: BodyModel,
) -> None:
    """The state where a segment begins has the body's joints, the one that ends the network's."""
    prior, parts = humor(body), SegmentedHumor(humor(body), 3)
    variables = prior.encode(motions(4))
    second, rolled = prior.rolled(variables).states[:, 2], prior.decode(variables).motion
    begun = parts.encode(motions(7))
    states = {
        "translation": (variables.translation, second.translation),
        "velocity": (variables.velocity, second.velocity),
        "angular_velocity": (variables.angular_velocity, second.angular_velocity),
        "joint_velocities": (variables.joint_velocities, second.joint_velocities[:, 1:]),
        "base": (variables.base, torch.cat((second.root[:, None], second.pose), 1)),
    }
    begun = begun.replace(**{name: torch.stack(pair, 1) for name, pair in states.items()})
    begun = begun.replace(latents=torch.cat((variables.latents, begun.latents[:, 3:]), 1))
    away = body.pose(rolled).joints[:, 3] - second.joints
    slid = second.velocity - second.joint_velocities[:, 0]  # the pelvis moves as the body does
    expected = 0.5 * (away.square().sum((-1, -2)) + slid.square().sum(-1))
    torch.testing.assert_close(parts.decode(begun).energies["defect"], expected)


def test_frames_that_do_not_exist_neither_count_nor_change_others(body: BodyModel) -> None:
    both = pad([swinging(9, 20), swinging(6, 21)])
    parts = SegmentedHumor(humor(body), 3)
    alone = parts.decode(parts.encode(both[1:].window(0, 6)))
    found = parts.decode(parts.encode(both))
    for name, energy in found.energies.items():
        torch.testing.assert_close(energy[1:], alone.energies[name])
    same(found.motion[1:].window(0, 6), alone.motion)


def test_fitted_segments_join_and_come_nearer_to_the_data(body: BodyModel) -> None:
    prior = humor(body)
    truth = prior.decode(prior.encode(motions(10))).motion
    joints = body.pose(truth).joints
    start = motions(10).replace(translation=motions(10).translation + 0.1)
    weights = HumorWeights(1e-6, 1e-6, defect=1.0, contact_velocity=0.0, contact_height=0.0)
    method = Shooting(prior, weights, Schedule(all=40), segment=3)
    *_, stage = method.stages((Term("data", seen_of(joints), 1.0),))
    assert "defect" in {term.name for term in stage.terms}
    found, [report] = run_stages([stage], body, start, Scene.create(2, like=joints))
    before = (body.pose(start).joints - joints).norm(dim=-1).mean((1, 2))
    after = (found.body.joints - joints).norm(dim=-1).mean((1, 2))
    assert (after < 0.2 * before).all()
    place = [term.name for term in stage.terms].index("defect")
    trace = report.solution.trace[..., place]
    assert (trace[:, -1] < trace[:, 0]).all()


def test_segments_that_cannot_be_are_refused(body: BodyModel) -> None:
    prior: Humor = humor(body)
    with pytest.raises(ReconError, match="at least one step, got 0"):
        Shooting.for_noise(prior, 0.04, 0)
    with pytest.raises(ReconError, match="are of the roll-out"):
        replace(Shooting.published_joints(prior), segment=5)
    with pytest.raises(ReconError, match="expected a weight of their defects above 0, got 0"):
        Shooting(prior, segment=5)
    stages = Shooting.for_noise(prior, 0.04, 5).stages((Term("data", zero, 1.0),))
    assert [stage.name for stage in stages] == ["root", "pose", "steps", "contacts", "segments"]
