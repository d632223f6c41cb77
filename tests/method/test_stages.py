"""Stages: what is freed moves, what is not stays; clips are independent; truth is recovered."""

from dataclasses import dataclass, replace

import pytest
import torch

from observations.joints3d import Joints3D
from recon.core import rotations as so3
from recon.core.scene import Scene, UnknownGround
from recon.core.struct import concatenate
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.priors import as_prior
from recon.method.reconstruction import solve
from recon.method.running import Hypotheses, run_hypotheses, run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.solver.lbfgs import LBFGS, Termination
from tests import laws

pytestmark = pytest.mark.numerics


@dataclass
class Free:
    """A method: root first, then everything, with a little smoothness."""

    iterations: int

    def stages(self, data):
        free = FreeMotion()
        steady = (
            Term("smooth", terms.joint_acceleration, 1.0),
            Term("rest", terms.rest_pose, 1e-3),
        )
        everything = frozenset({"translation", "root", "pose"})
        return (
            Stage("root", free, data, frozenset({"translation", "root"}), LBFGS(self.iterations)),
            Stage("pose", free, (*data, *steady), everything, LBFGS(self.iterations)),
        )


def observed(body, motion, noise=0.0, seed=1):
    joints = body.pose(motion).joints
    generator = torch.Generator().manual_seed(seed)
    joints = joints + noise * torch.randn(joints.shape, generator=generator, dtype=joints.dtype)
    visible = torch.ones(joints.shape[:-1], dtype=torch.bool)
    return Joints3D(joints, visible, tuple(range(22)), motion.fps)


def test_a_planted_motion_is_recovered_and_noise_lessened(body):
    motion = laws.a_motion(body, clips=2, frames=20)
    motion = motion.replace(shape=motion.shape * 0)
    result = solve([observed(body, motion, noise=0.02)], Free(300), body)
    noise = (observed(body, motion, noise=0.02).positions - body.pose(motion).joints).norm(dim=-1)
    error = (result.body.joints - body.pose(motion).joints).norm(dim=-1)
    assert error.mean() < 0.85 * noise.mean()
    assert "pose" in str(result)
    assert result.failed == (False, False)


def test_a_clip_alone_is_the_clip_in_its_batch(body):
    motion = laws.a_motion(body, clips=3, frames=5)
    observation = observed(body, motion, noise=0.01)
    together = solve([observation], Free(30), body)
    row = torch.tensor([1])
    alone = solve([observation[row]], Free(30), body)
    gap = (together.body.joints[row] - alone.body.joints).norm(dim=-1)
    assert gap.max() < 1e-3  # metres
    value = [r.solution.value for r in (together.reports[-1], alone.reports[-1])]
    assert torch.allclose(value[0][row], value[1], rtol=1e-2)


def test_only_what_is_free_moves(toy_body):
    motion = laws.a_motion(toy_body)
    observation = observed(toy_body, laws.a_motion(toy_body, seed=1))
    stage = Stage("root", FreeMotion(), (Term("data", observation, 1.0),), frozenset({"root"}))
    scene = Scene.create(2, like=motion.translation)
    estimate, _ = run_stages((stage,), toy_body, motion, scene)
    assert torch.equal(estimate.motion.translation, motion.translation)
    assert torch.allclose(
        estimate.motion.rotations[..., 1:, :, :], motion.rotations[..., 1:, :, :]
    )
    assert not torch.allclose(
        estimate.motion.rotations[..., 0, :, :], motion.rotations[..., 0, :, :]
    )


def test_the_scene_is_freed_by_its_path(toy_body):
    motion = laws.a_motion(toy_body)
    shift = torch.tensor([0.01, 0.02, -0.03]).double()
    posed = toy_body.pose(motion)
    positions = posed.joints + (posed.orientations @ shift[:, None])[..., 0]
    visible = torch.ones(positions.shape[:-1], dtype=torch.bool)
    seen = Joints3D(positions, visible, tuple(range(22)), 30.0, offset_rows=(0, 22))
    stage = Stage(
        "offsets", FreeMotion(), (Term("data", seen, 1.0),), frozenset({"scene.offsets"})
    )
    estimate, _ = run_stages((stage,), toy_body, motion, Scene.create(2, 22, like=shift))
    assert torch.allclose(estimate.scene.offsets, shift.expand(2, 22, 3), atol=1e-6)


def test_a_clip_with_nan_fails_alone_and_stays_finite(toy_body):
    motion = laws.a_motion(toy_body, clips=3)
    observation = observed(toy_body, motion, noise=0.01)
    wild = observation.positions.clone()
    wild[1] = 1e200  # its square overflows
    spoilt = observation.derived(positions=wild)
    stage = Stage(
        "pose", FreeMotion(), (Term("data", spoilt, 1.0),),
        frozenset({"translation", "root", "pose"}), LBFGS(20),
    )  # fmt: skip
    scene = Scene.create(3, like=motion.translation)
    estimate, (report,) = run_stages((stage,), toy_body, motion, scene)
    assert report.solution.termination[1] is Termination.NONFINITE
    assert all(report.solution.termination[k] is not Termination.NONFINITE for k in (0, 2))
    assert estimate.body.joints.isfinite().all()
    good = torch.tensor([0, 2])
    clean = Stage(
        "pose", FreeMotion(), (Term("data", observation[good], 1.0),), stage.free, LBFGS(20)
    )
    expected, _ = run_stages((clean,), toy_body, motion[good], scene[good])
    assert torch.allclose(estimate.body.joints[good], expected.body.joints, atol=1e-6)


def test_one_prior_object_continues_from_its_variables(toy_body):
    encoded = []

    class Counting(FreeMotion):
        def encode(self, motion):
            encoded.append(1)
            return super().encode(motion)

    prior, motion = Counting(), laws.a_motion(toy_body)
    data = (Term("data", observed(toy_body, motion), 1.0),)
    stage = Stage("a", prior, data, frozenset({"translation"}), LBFGS(2))
    run_stages((stage, stage), toy_body, motion, Scene.create(2, like=motion.translation))
    assert len(encoded) == 1


def test_stages_refuse_what_does_not_exist(toy_body):
    motion = laws.a_motion(toy_body)
    data = (Term("data", observed(toy_body, motion), 1.0),)
    wrong = Stage("x", FreeMotion(), data, frozenset({"latents"}))
    with pytest.raises(ValueError, match=r"latents.*translation"):
        run_stages((wrong,), toy_body, motion, Scene.create(2, like=motion.translation))
    with pytest.raises(ValueError, match="terms of different names"):
        Stage("x", FreeMotion(), (*data, *data), frozenset({"root"}))
    with pytest.raises(ValueError, match="nothing to fit"):
        solve([], Free(1), toy_body)


def test_joined_records_are_their_parts(toy_body):
    motion = laws.a_motion(toy_body)
    again = concatenate([motion[:1], motion[1:]])
    assert torch.equal(again.rotations, motion.rotations)


def test_of_several_hypotheses_the_one_of_the_lowest_objective_is_kept(body):
    truth = laws.a_motion(body, clips=2, frames=5)
    observation = observed(body, truth)
    turned = truth.rotations.clone()
    turned[:, :, 0] = so3.exp(torch.tensor([0.0, 0.0, 3.0]).to(turned)) @ turned[:, :, 0]
    wrong = truth.replace(rotations=turned)
    rows = torch.tensor([True, False])
    first = truth.replace(rotations=turned.where(rows[:, None, None, None, None], truth.rotations))
    second = truth.replace(
        rotations=truth.rotations.where(rows[:, None, None, None, None], turned)
    )
    found = solve([observation], Free(2), body, start=first, others=[wrong, second])
    assert found.chosen == (2, 0)
    assert len(found.motion.translation) == 2
    assert (found.body.joints - body.pose(truth).joints).norm(dim=-1).mean() < 0.05


def test_a_stage_keeps_as_many_hypotheses_as_it_says_by_the_objective_it_names(body):
    truth = laws.a_motion(body, clips=1, frames=3)
    prior = FreeMotion()
    higher = [truth.replace(translation=truth.translation + step) for step in (0.3, 0.1, 0.2)]
    height = Term("height", lambda estimate: -estimate.motion.translation[..., 2].sum(-1), 1.0)
    still = Term("still", lambda estimate: estimate.motion.rotations.flatten(1).sum(-1) * 0, 1.0)
    stage = Stage(
        "keep", prior, (still,), frozenset({"pose"}), LBFGS(1), kept=2, ranking=(height,)
    )
    scene = Scene.create(1, like=truth.translation)
    began = Hypotheses.of_motions(prior, higher, scene, body)
    found, reports = run_hypotheses([stage, replace(stage, kept=1)], body, began)
    assert found.number is not None
    assert found.number.tolist() == [0]
    assert [len(report.solution.value) for report in reports] == [1, 1]
    once, _ = run_hypotheses([stage], body, began)
    assert once.number is not None
    assert once.number.tolist() == [0, 2]


@dataclass(frozen=True)
class Rematched:
    """An energy whose correspondences are those of the moment, as of points without names."""

    seen: Joints3D

    def matched(self, estimate):
        del estimate
        return self.seen

    def __call__(self, estimate):
        return self.seen(estimate)


def test_only_the_last_round_of_correspondences_is_minimised_to_the_end(toy_body):
    """Every round was, though the next one changed the correspondences; it took a third more."""
    motion = laws.a_motion(toy_body, clips=1)
    tolerances = []

    def noted(stage, *_):
        tolerances.append(stage.minimiser.tolerance_decrease)

    data = (Term("data", Rematched(observed(toy_body, motion)), 1.0),)
    free = frozenset({"translation", "root"})
    stage = Stage("root", FreeMotion(), data, free, LBFGS(9), second_order=noted, rounds=3)
    run_stages((stage,), toy_body, motion, Scene.create(1, like=motion.translation))
    assert tolerances[0] == tolerances[1] > tolerances[2] == stage.minimiser.tolerance_decrease


def test_a_stage_goes_on_from_the_best_of_what_is_proposed(toy_body):
    """Each clip gets proposals of its own, and reports of earlier stages keep to its rows."""
    truth, start = laws.a_motion(toy_body), laws.a_motion(toy_body, seed=1)
    data = Term("data", observed(toy_body, truth), 1.0)
    asked = list[int]()

    def propose(estimate, clip):
        asked.append(clip)
        assert len(estimate.motion.translation) == 1
        if clip == 0:
            return None, "from the row"
        return concatenate([truth[[0]], truth[[1]]]), "proposed"

    still = LBFGS(1)
    first = Stage("root", FreeMotion(), (data,), frozenset({"translation"}), still)
    chosen = replace(first, name="proposed", proposals=propose, kept=1)
    scene = Scene.create(2, like=truth.translation)
    began = Hypotheses.of_motions(first.prior, [start], scene, toy_body)
    found, reports = run_hypotheses((first, chosen), toy_body, began)
    assert asked == [0, 1]
    assert len(found.unknowns.scene.offsets) == 2
    motion = found.unknowns.motion(found.prior, toy_body)
    torch.testing.assert_close(motion.rotations[1], truth.rotations[1])
    torch.testing.assert_close(motion.rotations[0], start.rotations[0])
    assert [len(report.solution.value) for report in reports] == [2, 2]
    compared = reports[-1].compared
    assert compared is not None
    assert compared.clip.tolist() == [0, 1, 1]
    assert [report.remarks for report in reports] == [(), ("from the row", "proposed")]


def test_proposals_are_motions_in_the_world(toy_body):
    """A recording whose ground lies elsewhere is searched on the ground of the world."""
    truth = laws.a_motion(toy_body, clips=1)
    pivot = torch.zeros(1, 3).to(truth.translation)
    ground = UnknownGround.create(pivot).replace(lift=pivot[:, 0] + 0.7)
    scene = replace(Scene.create(1, like=truth.translation), ground=ground)
    began = Hypotheses.of_motions(FreeMotion(), [truth], scene, toy_body)
    world = began.estimate(toy_body).motion
    made, origin, _ = began.with_proposals(lambda estimate, _: (estimate.motion, ""), toy_body)
    assert origin.tolist() == [0]
    motion = made.unknowns.motion(made.prior, toy_body)
    torch.testing.assert_close(motion.translation[0], truth.translation[0])
    assert (world.translation - truth.translation).abs().max() > 0.5


def test_a_former_prior_that_named_its_protocol_is_fitted_by_its_stages_of_data(toy_body):
    """`Prior` was a protocol in version 0.2, from which a class could derive, too."""

    class Former(FreeMotion):
        def stages(self, data):  # pyright: ignore[reportIncompatibleMethodOverride]
            return (Stage("mine", self, data, frozenset({"translation"}), LBFGS(2)),)

    data = (Term("data", observed(toy_body, laws.a_motion(toy_body)), 1.0),)
    (stage,) = as_prior(Former()).stages(data, 0.02, toy_body)
    assert stage.name == "mine"
    assert stage.prior.knows_gravity is False
    assert as_prior(FreeMotion()).stages(data)[-1].name == "all"
