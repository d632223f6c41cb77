"""Stages: what is freed moves, what is not stays; clips are independent; truth is recovered."""

from dataclasses import dataclass

import pytest
import torch

from observations import Joints3D
from recon.core.scene import Scene
from recon.core.struct import concatenate
from recon.method import terms
from recon.method.free import FreeMotion
from recon.method.reconstruction import solve
from recon.method.stages import Stage, run_stages
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
    with pytest.raises(ValueError, match="names of their own"):
        Stage("x", FreeMotion(), (*data, *data), frozenset({"root"}))
    with pytest.raises(ValueError, match="nothing to fit"):
        solve([], Free(1), toy_body)


def test_joined_records_are_their_parts(toy_body):
    motion = laws.a_motion(toy_body)
    again = concatenate([motion[:1], motion[1:]])
    assert torch.equal(again.rotations, motion.rotations)
