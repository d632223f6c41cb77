"""HuMoR over all steps at once: its energies, and what it makes of a noisy motion."""

import pytest
import torch

from observations.depth import PointCloud
from observations.joints3d import Joints3D
from observations.surfels import Surfels
from priors.humor.collocation import Collocation
from priors.humor.prior import Humor
from priors.humor.state import states_of
from priors.humor.steps import posterior_outputs
from priors.pose.prior import PosePrior
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, padded_batch
from recon.method.priors import Prior
from recon.method.reconstruction import solve
from recon.method.terms import Term
from tests.priors.test_humor import humor, motions
from tests.priors.test_pose import swinging
from training.humor.train import error_whitening

pytestmark = pytest.mark.numerics


def collocated(body: BodyModel) -> Collocation:
    return Collocation(humor(body))


def test_it_is_a_prior_whose_energies_do_not_depend_on_place_or_heading(body: BodyModel) -> None:
    prior = collocated(body)
    assert isinstance(prior, Prior)
    motion = motions()
    decoded = prior.decode(prior.encode(motion))
    torch.testing.assert_close(decoded.motion.translation, motion.translation)
    turn = so3.about_z(torch.tensor(0.7, dtype=torch.float64))
    pelvis = body.rest_joints(motion.shape)[:, None, 0]
    there = (motion.translation + pelvis) @ turn.mT + torch.tensor([1.0, -2.0, 0.0]).double()
    rotations = torch.cat(
        (turn @ motion.rotations[..., :1, :, :], motion.rotations[..., 1:, :, :]), -3
    )
    moved = prior.decode(
        prior.encode(motion.replace(translation=there - pelvis, rotations=rotations))
    )
    assert set(decoded.energies) == {"pose", "step", "latents"}
    for name, energy in decoded.energies.items():
        torch.testing.assert_close(moved.energies[name], energy, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(moved.contacts, decoded.contacts)


def test_padding_changes_nothing(body: BodyModel) -> None:
    prior = collocated(body)
    both = prior.decode(prior.encode(padded_batch([swinging(8, 1), swinging(5, 2)])))
    short = prior.decode(prior.encode(swinging(5, 2)[None]))
    for name, energy in short.energies.items():
        torch.testing.assert_close(both.energies[name][1:], energy)


def test_steps_agree_with_the_rollout(body: BodyModel) -> None:
    """A motion that the decoder made, by the means it was encoded to, has no error."""
    prior = humor(body)
    made = prior.decode(prior.encode(motions(6)))
    states = states_of(made.motion, body)
    found = posterior_outputs(prior.networks, states, prior.pelvis(made.motion.shape))
    assert found.error.shape == (2, 5, 207)
    assert (found.surprise >= 0).all()
    still = humor(body, still=True)
    held = made.motion.replace(
        translation=made.motion.translation[:, :1].expand(-1, 6, -1),
        rotations=made.motion.rotations[:, :1].expand(-1, 6, -1, -1, -1),
    )
    found = posterior_outputs(still.networks, states_of(held, body), still.pelvis(held.shape))
    assert found.error.abs().max() < 1e-9  # a decoder that never moves explains who never moves


def test_whitened_errors_have_about_unit_variance(body: BodyModel) -> None:
    prior = humor(body)
    states = states_of(padded_batch([swinging(60, k) for k in range(8)]), body)
    pelvis = prior.pelvis(torch.zeros(8, body.shape_size, dtype=torch.float64))
    whitening = error_whitening(prior.networks, states, pelvis)
    errors = posterior_outputs(prior.networks, states, pelvis).error.flatten(0, 1) @ whitening
    assert errors.square().mean() <= 1.0
    assert errors.square().mean(0).max() > 0.9


def test_one_frame_is_refused(body: BodyModel) -> None:
    with pytest.raises(ValueError, match="at least two"):
        collocated(body).encode(swinging(1, 0)[None])


@pytest.fixture(scope="module")
def trained() -> Humor:
    return Humor.load()


def test_a_noisy_motion_gets_better_than_by_the_pose_prior_alone(trained: Humor) -> None:
    body = BodyModel.load()
    truth = demo_clip()
    joints = body.pose(truth).joints
    noise = 0.04 * torch.randn(joints.shape, generator=torch.Generator().manual_seed(0))
    seen = Joints3D(
        joints + noise, torch.ones(joints.shape[:-1], dtype=torch.bool), tuple(range(22)), 30.0
    )
    method = Collocation(trained)
    result = solve([seen], method, body)
    plain = solve([seen], PosePrior.load(), body)

    def error(motion: Motion) -> float:
        return (body.pose(motion).joints - joints).norm(dim=-1).mean().item()

    assert error(result.motion) < 0.97 * error(plain.motion)
    assert result.contacts is not None
    assert result.reports[-1].stage.name == "contacts"


def demo_clip() -> Motion:
    from importlib import resources

    from recon.formats.motions import load_motion

    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        return load_motion(path).motion.resample(30.0).window(0, 60)[None]


def test_feet_are_held_last(body: BodyModel) -> None:
    data = Term("data", lambda e: e.motion.shape.sum(-1), 1.0)
    *_, poses, contacts = Collocation(humor(body)).stages((data,))
    own = {term.name for term in contacts.terms} - {term.name for term in poses.terms}
    assert own == {"step", "latents", "contact velocity"}


def test_poses_are_found_roughly_first(body: BodyModel) -> None:
    positions = torch.zeros(2, 10, 22, 3)
    shown = torch.ones(2, 10, 22, dtype=torch.bool)
    whole = Term("data", Joints3D(positions, shown, tuple(range(22)), 30.0), 1.0)
    shown = shown.clone()
    shown[1, :5, [4, 7, 10]] = False
    hidden = Term("data", Joints3D(positions, shown, tuple(range(22)), 30.0), 1.0)
    method = Collocation(humor(body))
    assert [s.name for s in method.stages((whole,))] == ["root", "pose", "contacts"]
    assert [s.name for s in method.stages((hidden,))] == ["root", "pose", "contacts"]


def test_fits_of_clouds_alone_weigh_latents_less_and_end_later(body: BodyModel) -> None:
    shown = torch.ones(1, 4, 22, dtype=torch.bool)
    joints = Term("joints", Joints3D(torch.zeros(1, 4, 22, 3), shown, tuple(range(22)), 30.0), 1.0)
    seen = PointCloud(torch.zeros(1, 4, 1, 3), shown[..., :1], Surfels.of(body, 100), 30.0)
    cloud = Term("cloud", seen, 1.0)

    def settings(*data: Term) -> tuple[float, float]:
        last = collocated(body).stages(data)[-1]
        (weight,) = (term.weight for term in last.terms if term.name == "latents")
        return weight, last.minimiser.tolerance_decrease

    for alone, both in zip(settings(cloud), settings(cloud, joints), strict=True):
        assert alone < both
    assert settings(cloud, joints) == settings(joints)


def test_every_stage_takes_the_density_that_is_given(body: BodyModel) -> None:
    """Collocation loaded the bundled density by itself: people held out of the networks' training
    were among those whose poses it knew."""
    bundled = PosePrior.load().density
    wider = bundled.replace(basis=2 * bundled.basis)
    data = Term("data", lambda e: e.motion.shape.sum(-1), 1.0)
    for density, expected in ((None, bundled), (wider, wider)):
        method = Collocation.for_noise(humor(body), 0.04, density)
        _, poses, *steps = method.stages((data,))
        assert isinstance(poses.prior, PosePrior)
        torch.testing.assert_close(poses.prior.density.basis, expected.basis)
        for stage in steps:
            assert isinstance(stage.prior, Collocation)
            torch.testing.assert_close(stage.prior.poses.density.basis, expected.basis)
