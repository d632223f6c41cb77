"""The test-time optimisation: its phases, and a planted motion found again."""

from dataclasses import replace

import pytest
import torch

from observations.joints3d import Joints3D
from priors.humor.prior import HumorVariables
from priors.humor.shooting import HumorWeights, Shooting
from recon.body.model import BodyModel
from recon.core.scene import Scene
from recon.method.protocols import Estimate
from recon.method.reconstruction import Method
from recon.method.stages import evaluate_stage, run_stage
from recon.method.terms import Term
from tests.priors.test_humor import humor, motions

pytestmark = pytest.mark.numerics


def zero(estimate: Estimate) -> torch.Tensor:
    return estimate.motion.shape.sum(-1) * 0


def test_the_phases_are_the_published_ones(body: BodyModel) -> None:
    method = Shooting(humor(body))
    assert isinstance(method, Method)
    _, _, first, latents, everything = method.stages((Term("data", zero, 1.0),))
    assert (first.frames, latents.frames, everything.frames) == (15, None, None)
    assert latents.free == {"latents", "shape"}
    assert "contact height" not in {term.name for term in latents.terms}
    weights = {term.name: term.weight for term in everything.terms}
    published = HumorWeights.published_joints()
    assert weights["transition"] == published.transition == 1e-3
    assert weights["bones"] == 10.0


def test_a_phase_of_some_frames_sees_only_them(body: BodyModel) -> None:
    prior = humor(body)
    stage = Shooting(prior).stages((Term("data", zero, 1.0),))[2]
    stage = replace(stage, frames=4, minimiser=replace(stage.minimiser, max_iterations=2))
    start = prior.encode(motions(8))
    scene = Scene.create(2, like=start.translation)
    found, _, solution = run_stage(stage, body, start, scene)
    assert torch.equal(found.latents[:, 3:], start.latents[:, 3:])
    assert not torch.equal(found.latents[:, :3], start.latents[:, :3])
    short = prior.decode(found, 4)
    energies = torch.stack([
        term.weight * term.energy(Estimate(short, body.pose(short.motion), scene))
        for term in stage.terms
    ], -1)  # fmt: skip
    torch.testing.assert_close(solution.trace[:, -1], energies.double())
    whole = evaluate_stage(stage, body, found, scene)
    assert whole.motion.frames == 8


def test_the_last_phase_brings_the_motion_nearer_to_the_data(body: BodyModel) -> None:
    weights = HumorWeights(1e-6, 1e-6, contact_velocity=0.0, contact_height=0.0)
    prior = humor(body)
    truth = prior.decode(prior.encode(motions(6))).motion
    joints = body.pose(truth).joints
    seen = Joints3D(joints, torch.ones(2, 6, 22, dtype=torch.bool), tuple(range(22)), 30.0)
    # untrained, it knows nothing of contacts
    *_, stage = Shooting(prior, weights).stages((Term("data", seen, 1.0),))
    stage = replace(stage, minimiser=replace(stage.minimiser, max_iterations=40))
    start = prior.encode(truth)
    start = start.replace(translation=start.translation + 0.1, root=start.root + 0.1)
    found, _, solution = run_stage(stage, body, start, Scene.create(2, like=joints))
    assert (solution.trace[:, -1].sum(-1) < solution.trace[:, 0].sum(-1)).all()

    def error(variables: HumorVariables) -> torch.Tensor:
        posed = body.pose(prior.decode(variables).motion)
        return (posed.joints - joints).norm(dim=-1).mean((1, 2))

    assert (error(found) < 0.3 * error(start)).all()
