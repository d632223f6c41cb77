"""Second-order minimisation of stages: Hessians against derivatives, and where it ends."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from priors.pose.prior import PosePrior, PoseWeights
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.marquardt import factorised, marquardt, preconditioned
from recon.method.newton import NoHessian, StageProblem
from recon.method.protocols import Estimate
from recon.method.reconstruction import solve
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.method.unknowns import Unknowns
from recon.solver.banded import Banded
from recon.solver.solution import Progress, Termination
from tests import laws
from tests.priors.test_pose import swinging
from tests.solver.test_banded import dense

WEIGHTS = PoseWeights(pose=1e-3, shape=1e-3, velocity=2.0, acceleration=5.0)


def seen_by(body: BodyModel, frames: int = 5, fps: float = 30.0, clips: int = 1) -> Joints3D:
    motions = [swinging(frames, 1 + k) for k in range(clips)]
    joints = torch.stack([body.pose(one[None]).joints[0] for one in motions]).float()
    shown = torch.ones(joints.shape[:-1], dtype=torch.bool)
    return Joints3D(joints, shown, tuple(range(22)), fps).to(dtype=torch.float64)


def pose_stage(data: Sequence[Any], body: BodyModel) -> Stage[Any]:
    prior = PosePrior.load(weights=WEIGHTS)
    terms = tuple(Term(f"data {k}", one, 1.5) for k, one in enumerate(data))
    return prior.stages(terms)[1]


def start_of(stage: Stage[Any], motion: Motion, body: BodyModel) -> Unknowns[Any]:
    scene = Scene.create(len(motion.translation), like=motion.translation)
    return Unknowns.of(stage.prior, motion, scene, body)


def residuals(stage: Stage[Any], estimate: Estimate) -> Tensor:
    """All residuals of a pose stage whose half squares add up to its objective."""
    motion, joints = estimate.motion, estimate.body.joints
    prior: Any = stage.prior
    density, w = prior.density, prior.weights
    rate = motion.fps / 30
    z = density.to(dtype=torch.float64).coordinates(motion.rotations[..., 1:, :, :])
    parts = [
        (2 * w.pose / rate) ** 0.5 * z,
        (2 * w.shape * motion.frames / rate) ** 0.5 * motion.shape,
        (w.velocity * rate) ** 0.5 * joints.diff(dim=-3),
        (w.acceleration * rate**3) ** 0.5 * joints.diff(n=2, dim=-3),
    ]
    for term in stage.terms:
        energy: Any = term.energy
        if isinstance(energy, Joints3D | Markers3D):
            found = energy.residuals(estimate)
            scale = (term.weight * 30 / energy.fps) ** 0.5
            parts.append(scale * found.values * found.weights[..., None])
    return torch.cat([part.flatten() for part in parts])


@pytest.mark.parametrize("kind", ["joints", "slower clock", "markers"])
def test_the_hessian_is_that_of_the_residuals(body: BodyModel, kind: str) -> None:
    """JᵀJ, with J by differences, of data, poses, shape and smoothness together."""
    exact = body.to(dtype=torch.float64)
    motion = swinging(5, 3)[None]
    if kind == "markers":
        vertices = tuple(range(0, 100, 7))
        points = exact.pose(motion).points(torch.tensor(vertices)) + 0.01
        shown = torch.ones(points.shape[:-1], dtype=torch.bool)
        shown[:, 2, 3:] = False
        seen: Any = Markers3D(points.float(), shown, vertices, 30.0)
    else:
        fps = 18.0 if kind == "slower clock" else 30.0
        seen = seen_by(body, 3 if kind == "slower clock" else 5, fps)
    stage = pose_stage([seen.to(dtype=torch.float64)], exact)
    local, base = StageProblem.around(stage, exact, start_of(stage, motion, exact))

    def at(steps: Tensor) -> Tensor:
        moved = local.after_steps(base, steps[None])
        return residuals(stage, moved.estimate(stage.prior, exact))

    zero = torch.zeros(local.size, dtype=torch.float64)
    h = 1e-6
    with torch.no_grad():
        here = at(zero)
        moved = [at(zero.index_fill(0, torch.tensor(k), h)) for k in range(len(zero))]
    jacobian = (torch.stack(moved, -1) - here[:, None]) / h
    expected = jacobian.mT @ jacobian
    found = dense(local.model(base, torch.arange(1)).hessian[0])
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4 * float(expected.max()))


def test_it_ends_by_tolerance_where_first_order_reaches_its_limit(body: BodyModel) -> None:
    """Pose stages of hidden points ended at 120 iterations, and said nothing of the rest."""
    motion = swinging(20, 1)[None]
    points = body.pose(motion).joints.float()
    shown = torch.ones(points.shape[:-1], dtype=torch.bool)
    shown[..., [4, 5, 7, 8, 10, 11]] = False
    seen = Joints3D(points.where(shown[..., None], 0.0), shown, tuple(range(22)), 30.0)
    prior = PosePrior.load(weights=PoseWeights.for_noise(0.01))
    newton = solve([seen], prior, body).reports[-1]
    plain = solve([seen], _FirstOrder(prior), body).reports[-1]
    assert newton.solution.termination[0] is Termination.CONVERGED
    assert int(newton.solution.iterations[0]) <= 15
    assert float(newton.solution.value[0]) <= float(plain.solution.value[0]) * (1 + 1e-3)
    trace = newton.solution.trace[0].sum(-1)
    assert (trace.diff() <= 0).all()


class _FirstOrder:
    def __init__(self, prior: PosePrior) -> None:
        self.prior = prior

    def stages(self, data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        return tuple(replace(stage, second_order=None) for stage in self.prior.stages(data))


@pytest.mark.parametrize("way", [marquardt, preconditioned])
def test_clips_of_a_batch_do_not_touch_each_other(body: BodyModel, way: Any) -> None:
    seen = seen_by(body, 8, clips=3)
    stage = replace(pose_stage([seen], body), second_order=way)
    start = seen.start(body)
    start = start.replace(translation=start.translation + torch.tensor([0.0, 0.1, 0.0]))
    whole = start_of(stage, start, body)
    variables, _, solution = laws.minimised(stage, body, whole.variables, whole.scene)
    alone = replace(pose_stage([seen[[1]]], body), second_order=way)
    one = start_of(alone, start[[1]], body)
    single, _, found = laws.minimised(alone, body, one.variables, one.scene)
    assert set(solution.termination) == {Termination.CONVERGED}
    both = stage.prior.decode(variables).motion.translation[1]
    torch.testing.assert_close(
        both, alone.prior.decode(single).motion.translation[0], atol=1e-4, rtol=0
    )
    assert float(solution.value[1]) == pytest.approx(float(found.value[0]), rel=1e-4)


@pytest.mark.parametrize("way", [marquardt, preconditioned])
def test_a_clip_that_is_not_finite_is_told_and_leaves_the_others(
    body: BodyModel, way: Any
) -> None:
    seen = seen_by(body, 6, clips=2)
    positions = seen.positions.clone()
    positions[1, 2, 3] = torch.nan
    stage = replace(pose_stage([seen.derived(positions=positions)], body), second_order=way)
    whole = start_of(stage, seen.start(body), body)
    variables, _, solution = laws.minimised(stage, body, whole.variables, whole.scene)
    assert solution.termination[0] is Termination.CONVERGED
    assert solution.termination[1] is Termination.NONFINITE
    assert all(bool(t.isfinite().all()) for t in variables.tensors().values() if t.ndim > 0)


@pytest.mark.parametrize("way", [marquardt, preconditioned])
def test_watching_can_stop_it(body: BodyModel, way: Any) -> None:
    told: list[Progress] = []

    def watch(_: str, progress: Progress) -> bool:
        told.append(progress)
        return len(told) == 2

    seen = seen_by(body, 6)
    stage = replace(pose_stage([seen], body), second_order=way)
    whole = start_of(stage, seen.start(body), body)
    _, _, solution = laws.minimised(stage, body, whole.variables, whole.scene, watch)
    assert solution.termination == (Termination.STOPPED,)
    assert len(told) == 2


def test_without_a_known_hessian_first_order_goes_on(body: BodyModel) -> None:
    def energy(estimate: Estimate) -> Tensor:
        return estimate.motion.translation.square().sum((-1, -2))

    stage = pose_stage([seen_by(body)], body)
    stage = replace(stage, terms=(Term("own", energy, 1.0), *stage.terms[1:]))
    start = start_of(stage, swinging(6, 0)[None], body)
    local, base = StageProblem.around(stage, body, start)
    with pytest.raises(NoHessian):
        local.model(base, torch.arange(1))
    variables, _, _ = laws.minimised(stage, body, start.variables, start.scene)
    assert stage.prior.decode(variables).motion.translation.abs().max() < 1e-2


def test_a_hessian_that_cannot_be_factorised_scales_nothing() -> None:
    bad = Banded.zero(4, 2, 69, 1, torch.zeros(0))
    bad.inner[:, 0] = torch.nan
    u = torch.randn(4 * 69 + 1)
    torch.testing.assert_close(factorised(bad).solve_upper(u), u, rtol=1e-4, atol=1e-5)
