"""Limbs that no sensor saw: which they are, and what is proposed for them."""

from dataclasses import replace

import pytest
import torch

from observations.correspondences import BodyPoints
from observations.joints3d import Joints3D
from observations.keypoints2d import Keypoints2D
from priors.humor.collocation import Collocation, all_joints_located
from priors.humor.likely import LikelyStates
from priors.humor.prior import Humor
from priors.look.looking import UnseenLimbProposals, UnseenLimbs, load_network
from recon.body.model import BodyModel
from recon.core.camera import full_hd_camera
from recon.core.skeleton import LEGS
from recon.method.protocols import Estimate
from recon.method.reconstruction import solve
from recon.method.terms import Term
from tests import laws
from tests.priors.test_humor import humor
from tests.priors.test_humor_collocation import demo_clip
from tests.priors.test_pose import swinging

pytestmark = pytest.mark.numerics

BOTH_LEGS = torch.tensor([joint in (1, 2, *LEGS) for joint in range(22)])


def seen_data(hidden: list[int], clips: int = 1, moments: int = 6, share: float = 1.0) -> Term:
    shown = torch.ones(clips, moments, 22, dtype=torch.bool)
    shown[-1, : round(share * moments), hidden] = False
    positions = torch.zeros(clips, moments, 22, 3)
    return Term("data", Joints3D(positions, shown, tuple(range(22)), 30.0), 1.0)


def test_limbs_are_unseen_from_their_first_bone_of_unknown_direction(body: BodyModel) -> None:
    unseen = UnseenLimbs.of([seen_data(list(LEGS), clips=2)], body)
    assert unseen is not None
    assert not unseen.never[0].any()
    assert not unseen.rotations[0].any()
    assert torch.equal(unseen.never[1], BOTH_LEGS)
    assert torch.equal(unseen.rotations[1], BOTH_LEGS.expand(6, 22))
    shin = UnseenLimbs.of([seen_data([7, 10])], body)
    assert shin is not None
    assert shin.never[0].nonzero()[:, 0].tolist() == [4, 7, 10]


@pytest.mark.parametrize("hidden", [[], [10, 11], [15]])
def test_ends_of_limbs_are_no_limbs(body: BodyModel, hidden: list[int]) -> None:
    """Toes, hands and heads that nobody sees are common, and do not start a search."""
    assert UnseenLimbs.of([seen_data(hidden)], body) is None


def test_a_limb_may_be_unseen_for_a_while(body: BodyModel) -> None:
    some = UnseenLimbs.of([seen_data(list(LEGS), moments=20, share=0.5)], body)
    assert some is not None
    assert not some.never.any()
    assert torch.equal(some.rotations[0, :10], BOTH_LEGS.expand(10, 22))
    assert not some.rotations[0, 10:].any()
    most = UnseenLimbs.of([seen_data(list(LEGS), share=0.9)], body)
    assert most is not None
    assert torch.equal(most.never[0], BOTH_LEGS)


def test_what_few_moments_show_is_seen(body: BodyModel) -> None:
    """Of moments on a faster clock, most hold no data: they said that nothing was ever seen."""
    data = seen_data([7, 10]).energy.derived(fps=2.5).on_faster_clock(12)
    unseen = UnseenLimbs.of([Term("data", data, 1.0)], body)
    assert unseen is not None
    assert unseen.never[0].nonzero()[:, 0].tolist() == [4, 7, 10]
    assert unseen.rotations[0, 1:12].all()
    assert unseen.rotations[0, 12].nonzero()[:, 0].tolist() == [4, 7, 10]


def test_short_gaps_are_left_to_the_prior(body: BodyModel) -> None:
    assert UnseenLimbs.of([seen_data(list(LEGS), moments=20, share=0.25)], body) is None


def test_what_another_sensor_may_see_is_not_searched_for(body: BodyModel) -> None:
    hidden, whole = seen_data(list(LEGS)), seen_data([])
    assert UnseenLimbs.of([hidden, replace(whole, name="other")], body) is None
    unknown = Term("other", lambda e: e.motion.shape.sum(-1), 1.0)
    assert UnseenLimbs.of([hidden, unknown], body) is None


def test_clips_without_unseen_limbs_get_no_proposals(body: BodyModel) -> None:
    clip = swinging(6, 4)
    unseen = UnseenLimbs.of([seen_data(list(LEGS), clips=2, moments=6)], body)
    assert unseen is not None
    propose = UnseenLimbProposals(load_network(), unseen)
    estimate = Estimate.of_clip(clip, body)
    assert propose(estimate, 0) == (None, "")
    motions, said = propose(estimate, 1)
    assert motions is not None
    assert "2 motions" in said
    assert len(motions.translation) == 2
    torch.testing.assert_close(motions.translation, clip.translation.expand(2, -1, -1))
    given = clip.rotations.expand(2, -1, -1, -1, -1)
    torch.testing.assert_close(motions.rotations[:, :, ~BOTH_LEGS], given[:, :, ~BOTH_LEGS])
    assert (motions.rotations - given)[:, :, BOTH_LEGS].abs().amax() > 0.01


def test_what_is_far_from_what_the_network_knows_gets_no_proposals(body: BodyModel) -> None:
    """Its motions of people who float were believed as those of walkers were."""
    clip, unseen = swinging(6, 4), UnseenLimbs.of([seen_data(list(LEGS), moments=6)], body)
    assert unseen is not None
    high = clip.replace(translation=clip.translation + torch.tensor([0.0, 0.0, 3.0]))
    found, said = UnseenLimbProposals(load_network(), unseen)(Estimate.of_clip(high, body), 0)
    assert found is None
    assert "unlike the data of the network" in said


def test_the_stage_is_there_only_where_limbs_are_unseen(body: BodyModel) -> None:
    method = Collocation(humor(body))
    names = [stage.name for stage in method.stages((seen_data(list(LEGS)),))]
    assert names == ["root", "pose", "limbs", "contacts"]
    assert "limbs" not in [stage.name for stage in method.stages((seen_data([10]),))]


@pytest.mark.slow
def test_legs_of_a_walk_that_nobody_saw_walk() -> None:
    """Hidden legs of recorded walks floated above the ground and hardly moved: 13 cm off where
    minima of lower objective lie at 8."""
    body, truth = BodyModel.load(), demo_clip()
    joints = body.pose(truth).joints
    shown = torch.ones(joints.shape[:-1], dtype=torch.bool)
    shown[..., list(LEGS)] = False
    seen = Joints3D(joints, shown, tuple(range(22)), 30.0)
    method = Collocation.for_noise(Humor.load(), 0.01)

    class Before:
        """The method without its search."""

        def stages(self, data: tuple[Term, ...]):
            return tuple(stage for stage in method.stages(data) if stage.name != "limbs")

    def solved(how) -> tuple[float, float]:
        result = solve([seen], how, body)
        away = body.pose(result.motion).joints - joints
        objective = float(result.reports[-1].solution.value[0])
        return away[..., list(LEGS), :].norm(dim=-1).mean().item(), objective

    error, objective = solved(method)
    error_before, objective_before = solved(Before())
    assert objective <= objective_before * 1.02
    assert error < 0.12  # metres
    assert error <= error_before + 0.01


def test_legs_that_no_camera_sees_are_searched_for(body: BodyModel) -> None:
    """Only points in space were asked, and legs below the edge of an image hung still. What a
    detector places there has little confidence, but some."""
    points = BodyPoints.of_layout("smpl22", body)
    seen = torch.full((2, 6, 22), 0.9)
    seen[1, :, list(LEGS)] = torch.tensor([0.0, 0.05, 0.1]).repeat(2)[:, None]
    view = Keypoints2D(torch.zeros(2, 6, 22, 2), seen, points, full_hd_camera(), 30.0)
    unseen = UnseenLimbs.of([Term("data", view, 1.0)], body)
    assert unseen is not None
    assert not unseen.never[0].any()
    assert torch.equal(unseen.never[1], BOTH_LEGS)
    other = view.replace(confidence=torch.full((2, 6, 22), 0.3))
    assert UnseenLimbs.of([Term("data", view, 1.0), Term("other", other, 1.0)], body) is None
    # a place in an image is no place in space
    assert not all_joints_located((Term("other", other, 1.0),), body)


def test_likely_states_keep_the_contract_of_energies(body: BodyModel) -> None:
    unseen = BOTH_LEGS.expand(2, 22)
    walkers = laws.a_motion(body, frames=8)
    laws.check_energy(LikelyStates(Humor.load(), unseen), body, walkers, None)


def test_clips_whose_limbs_were_seen_have_no_energy_of_states(body: BodyModel) -> None:
    unseen = torch.stack((BOTH_LEGS, torch.zeros_like(BOTH_LEGS)))
    estimate = laws.estimate_of(body, laws.a_motion(body, frames=8))
    energy = LikelyStates(Humor.load(), unseen)
    some = energy(estimate)
    assert some[0] > 0
    assert some[1] == 0
    # clips that have converged leave the others behind
    left = laws.estimate_of(body, laws.a_motion(body, frames=8)[1:])
    assert energy[1:](left).tolist() == [0.0]


def test_legs_that_do_not_swing_with_the_arms_are_unlikely_states(body: BodyModel) -> None:
    """Fits of hidden legs took three steps while the arms swung four times: every step was
    likely from the one before, and no state was."""
    walk = demo_clip()
    later = walk.rotations.roll(12, 1)
    legs = torch.tensor([joint in LEGS or joint in (1, 2) for joint in range(22)])
    mixed = walk.replace(rotations=later.where(legs[:, None, None], walk.rotations))
    energy = LikelyStates(Humor.load(), BOTH_LEGS[None])
    true, false = (
        energy(laws.estimate_of(body, m.to(dtype=torch.float64))) for m in (walk, mixed)
    )
    assert float(true) < float(false) - 10 * walk.frames
