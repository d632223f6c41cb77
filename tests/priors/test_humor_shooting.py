"""The roll-out as a method: its phases and presets, and a planted motion found again."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from observations.joints3d import Joints3D
from priors.humor.collocation import Collocation
from priors.humor.shooting import PUBLISHED, HumorWeights, IterationSchedule, Shooting
from priors.humor.unrolled import HumorVariables
from priors.pose.prior import PosePrior
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.scene import Scene, UnknownGround
from recon.method.free import FreeMotion
from recon.method.protocols import Estimate
from recon.method.reconstruction import solve
from recon.method.running import run_stages
from recon.method.stages import Stage
from recon.method.terms import Term
from recon.method.unknowns import Unknowns
from recon.solver.lbfgs import LBFGS
from tests import laws
from tests.priors.test_humor import humor, motions

pytestmark = pytest.mark.numerics


def zero(estimate: Estimate) -> torch.Tensor:
    return estimate.motion.shape.sum(-1) * 0


def test_the_phases_are_the_published_ones(body: BodyModel) -> None:
    method = Shooting.published(humor(body), "joints")
    _, _, first, latents, everything = method.stages((Term("data", zero, 1.0),))
    start = humor(body).encode(motions(20))
    assert first.portion is not None
    assert first.portion(start).valid.shape[1] == 15
    assert latents.portion is None
    assert everything.portion is None
    assert [s.minimiser.max_iterations for s in (first, latents, everything)] == [600, 500, 300]
    assert latents.free == {"latents", "shape"}
    assert "contact height" not in {term.name for term in latents.terms}
    weights = {term.name: term.weight for term in everything.terms}
    published = PUBLISHED["joints"][0]
    assert weights["transition"] == published.transition == 1e-3
    assert weights["bones"] == 10.0


@pytest.mark.parametrize(
    ("case", "unit", "weight", "expected"),
    [
        ("joints", "metres", 1.0, {"transition": 1e-3, "initial": 1e-3, "consistency": 1.0}),
        ("points", "metres", 1.0, {"transition": 5e-4, "contact height": 1.0}),
        ("images", "pixels", 0.002, {"transition": 0.075, "bones": 2000.0, "ground held": 0.167}),
        ("depth", "pixels", 0.002, {"shape": 0.034, "contact velocity": 100.0, "ground held": 1}),
    ],
)
def test_presets_have_the_published_weights_whatever_the_fit_gives(
    body: BodyModel, case: str, unit: str, weight: float, expected: dict[str, float]
) -> None:
    class Seen:
        def __call__(self, estimate: Estimate) -> torch.Tensor:
            return zero(estimate)

    seen = Seen()
    seen.unit = unit  # type: ignore[attr-defined]
    method = Shooting.published(humor(body), case)
    *_, last = method.stages((Term("data", seen, 17.0),))
    weights = {term.name: term.weight for term in last.terms}
    assert weights["data"] == weight
    assert expected.items() <= weights.items()


def test_a_phase_without_iterations_is_left_out(body: BodyModel) -> None:
    stages = Shooting.for_noise(humor(body), 0.04).stages((Term("data", zero, 1.0),))
    assert [stage.name for stage in stages] == ["root", "pose", "contacts", "all"]


def test_it_begins_where_collocation_ends(body: BodyModel) -> None:
    """Its start took Newton's direction where the default moves slow changes of the clip first.

    Where legs were hidden, that start was 4.3 cm from the truth and the default's motion 2.0 (a
    validation window), and the roll-out stayed about where it began.
    """
    data, prior = (Term("data", zero, 1.0),), humor(body)
    method = Shooting.for_noise(prior, 0.0)
    *begun, last = method.stages(data)
    assert isinstance(method.start, Collocation)
    own = Collocation.for_noise(prior, 0.0).stages(data)
    assert [(s.name, s.minimiser) for s in begun] == [(s.name, s.minimiser) for s in own]
    assert [s.second_order is None for s in begun] == [s.second_order is None for s in own]
    assert "latents" in last.free


def test_a_phase_of_some_frames_sees_only_them(body: BodyModel) -> None:
    prior = humor(body)
    stage = Shooting.published(prior, "joints").stages((Term("data", zero, 1.0),))[2]
    stage = replace(
        stage,
        portion=lambda x: x.first_frames(4),
        minimiser=replace(stage.minimiser, max_iterations=2),
    )
    start = prior.encode(motions(8))
    scene = Scene.create(2, like=start.translation)
    found, _, solution = laws.minimised(stage, body, start, scene)
    assert torch.equal(found.latents[:, 3:], start.latents[:, 3:])
    assert not torch.equal(found.latents[:, :3], start.latents[:, :3])
    short = prior.decode(found.first_frames(4))
    energies = torch.stack([
        term.weight * term.energy(Estimate(short, body.pose(short.motion), scene))
        for term in stage.terms
    ], -1)  # fmt: skip
    torch.testing.assert_close(solution.trace[:, -1], energies.double())
    whole = Unknowns(found, scene).estimate(prior, body)
    assert whole.motion.frames == 8


def seen_of(joints: torch.Tensor) -> Joints3D:
    visible = torch.ones(joints.shape[:-1], dtype=torch.bool)
    return Joints3D(joints, visible, tuple(range(22)), 30.0)


def test_the_last_phase_brings_the_motion_nearer_to_the_data(body: BodyModel) -> None:
    weights = HumorWeights(1e-6, 1e-6, contact_velocity=0.0, contact_height=0.0)
    prior = humor(body)
    truth = prior.decode(prior.encode(motions(6))).motion
    joints = body.pose(truth).joints
    # untrained, it knows nothing of contacts
    *_, stage = Shooting(prior, weights).stages((Term("data", seen_of(joints), 1.0),))
    stage = replace(stage, minimiser=replace(stage.minimiser, max_iterations=40))
    start = prior.encode(truth)
    start = start.replace(translation=start.translation + 0.1, root=start.root + 0.1)
    found, _, solution = laws.minimised(stage, body, start, Scene.create(2, like=joints))
    assert (solution.trace[:, -1].sum(-1) < solution.trace[:, 0].sum(-1)).all()

    def error(variables: HumorVariables) -> torch.Tensor:
        posed = body.pose(prior.decode(variables).motion)
        return (posed.joints - joints).norm(dim=-1).mean((1, 2))

    assert (error(found) < 0.3 * error(start)).all()


class Hurried(PosePrior):
    """The pose prior with two iterations a stage, as a start."""

    def stages(self, data: tuple[Term, ...], *how: Any) -> tuple[Stage[Any], ...]:
        stages = super().stages(data, *how)
        return tuple(replace(stage, minimiser=LBFGS(2)) for stage in stages)


def test_a_clip_alone_is_the_clip_in_its_batch_and_hidden_points_say_nothing(
    body: BodyModel,
) -> None:
    prior = humor(body)
    joints = body.pose(motions(6)).joints
    method = Shooting(
        prior, schedule=IterationSchedule(first=2, latents=2, all=3), start=Hurried.load()
    )
    visible = seen_of(joints).visible.clone()
    visible[:, 2:4, :8] = False
    hidden = seen_of(joints.where(visible[..., None], 0.0)).replace(visible=visible)
    elsewhere = hidden.replace(positions=joints.where(visible[..., None], 5.0))
    both = solve([hidden], method, body)
    alone = solve([hidden[1:]], method, body)
    other = solve([elsewhere], method, body)
    torch.testing.assert_close(
        alone.motion.rotations[0], both.motion.rotations[1], rtol=0.0, atol=1e-5
    )
    torch.testing.assert_close(
        alone.motion.translation[0], both.motion.translation[1], rtol=0.0, atol=1e-5
    )
    assert torch.equal(other.motion.rotations, both.motion.rotations)


def test_a_motion_on_an_unknown_ground_is_encoded_and_rolled_out_in_the_world(
    body: BodyModel,
) -> None:
    """Latents were encoded in the frame of the recording, where up is elsewhere."""
    prior = humor(body)
    motion = motions(6)
    method = Shooting(prior, schedule=IterationSchedule(all=1), start=Hurried.load())
    *_, stage = method.stages((Term("data", zero, 1.0),))
    stage = replace(stage, terms=stage.terms[:1], minimiser=LBFGS(0))
    known, _ = run_stages([stage], body, motion, Scene.create(2, like=motion.translation))
    ground = UnknownGround.create(torch.tensor([[0.1, 0.2, 0.0], [0.0, 0.0, 0.0]]).double())
    ground = ground.replace(tilt=ground.tilt + 2.0, lift=ground.lift + 0.3)
    T = so3.inverse_rigid(ground.T_world_recording)
    recorded = motion.carried(T, body.rest_joints(motion.shape)[:, 0])
    scene = Scene.create(2, like=motion.translation).replace(ground=ground)
    found, _ = run_stages([stage], body, recorded, scene)
    torch.testing.assert_close(found.motion.rotations, known.motion.rotations)
    torch.testing.assert_close(found.motion.translation, known.motion.translation)
    assert known.decoded.joints is not None
    torch.testing.assert_close(found.decoded.joints, known.decoded.joints)
    ends, _ = run_stages([stage, replace(stage, prior=FreeMotion(), free=frozenset({"shape"}))],
                         body, recorded, scene)  # fmt: skip
    torch.testing.assert_close(ends.motion.rotations, known.motion.rotations)
    turned = prior.encode(recorded)
    assert not torch.allclose(turned.latents, prior.encode(motion).latents, atol=1e-3)
