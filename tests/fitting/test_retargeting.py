"""The same motion on another body: times and place stay, feet stay on the ground."""

from importlib import resources

import pytest
import torch

from priors.humos.prior import Humos
from recon.body.identities import identity
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length, with_shape
from recon.core import rotations as so3
from recon.fitting.retargeting import retarget, retarget_by_physics
from recon.formats.motions import load_motion
from recon.physics.metrics import physics_metrics, physics_samples
from tests.priors.tiny_humos import tiny_prior
from tests.walking import a_walk

BODY = BodyModel.load()


@pytest.fixture(scope="module")
def prior():
    return tiny_prior(BODY)


def other(seed=0):
    return torch.randn(BODY.shape_size, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("fps", [20.0, 30.0])
def test_times_place_and_the_new_body(prior, fps):
    walk = a_walk(BODY, seconds=2.0, fps=fps).replace(start_time=3.0)
    made = retarget(walk, other(), prior)
    assert (made.frames, made.fps, made.start_time) == (walk.frames, fps, 3.0)
    torch.testing.assert_close(made.shape, other())
    start = [m.translation[0] + BODY.rest_joints(m.shape)[0] for m in (walk, made)]
    assert float((start[0] - start[1])[:2].norm()) < 0.05


def test_the_path_grows_with_the_legs(prior):
    walk = a_walk(BODY, seconds=2.0, fps=30.0)
    made = retarget(walk, other(), prior)
    grown = float(leg_length(BODY, other()) / leg_length(BODY, walk.shape))
    before, after = (
        float((m.translation[-1] - m.translation[0])[:2].norm()) for m in (walk, made)
    )
    assert after == pytest.approx(grown * before, rel=0.05)


def test_long_clips_are_joined_from_windows_without_a_seam(prior):
    walk = a_walk(BODY, seconds=14.0, fps=20.0)
    made = retarget(walk, other(), prior)
    assert made.frames == walk.frames
    reference = with_shape(walk, BODY, other())
    step = made.translation.diff(dim=0).norm(dim=-1).max()
    assert float(step) < 2 * float(reference.translation.diff(dim=0).norm(dim=-1).max())


def test_without_a_network_feet_slide_less_than_those_of_a_copy():
    walk = a_walk(BODY, seconds=2.0, fps=30.0).replace(start_time=3.0)
    made, copy = retarget_by_physics(walk, other(), BODY), with_shape(walk, BODY, other())
    assert (made.frames, made.fps, made.start_time) == (walk.frames, 30.0, 3.0)
    torch.testing.assert_close(made.shape, other())
    assert float((made.translation - copy.translation)[:, :2].norm(dim=-1).max()) < 0.1
    touch = physics_samples(walk, BODY).soles_touch
    slips = [
        physics_metrics(physics_samples(m, BODY, touch))["slip_in_contact"] for m in (copy, made)
    ]
    assert 0 < (slips[1] or 0.0) < 0.95 * (slips[0] or 0.0)


def test_without_a_network_windows_follow_the_path_of_the_whole_clip():
    walk = a_walk(BODY, seconds=12.0, fps=20.0)
    made, copy = retarget_by_physics(walk, other(), BODY), with_shape(walk, BODY, other())
    assert made.frames == walk.frames
    assert float((made.translation - copy.translation)[:, :2].norm(dim=-1).max()) < 0.1


def test_fast_recordings_do_not_tremble(prior):
    """Between frames at 20 Hz the body rises and falls as recorded."""
    walk = a_walk(BODY, seconds=1.5, fps=120.0)

    def shake(motion):
        return float(motion.translation[:, 2].diff(n=2).square().mean().sqrt()) * 120**2

    scaled = shake(with_shape(walk, BODY, other()))
    assert shake(retarget(walk, other(), prior)) < 1.5 * scaled + 6.0


def test_feet_of_another_body_slide_less_than_those_of_a_copy(prior):
    walk = a_walk(BODY, seconds=2.0, fps=20.0)
    touch = physics_samples(walk, BODY).soles_touch
    rows = [
        physics_metrics(physics_samples(m, BODY, touch))
        for m in (with_shape(walk, BODY, other()), retarget(walk, other(), prior))
    ]
    copy, made = ({k: v or 0.0 for k, v in row.items()} for row in rows)
    assert 0 < made["slip_in_contact"] < copy["slip_in_contact"]
    assert made["penetrate"] <= copy["penetrate"] + 1e-3


def test_what_cannot_be_retargeted_is_refused(prior):
    walk = a_walk(BODY, seconds=2.0, fps=20.0)
    with pytest.raises(ValueError, match="at least 1 s"):
        retarget(walk.window(0, 15), other(), prior)
    with pytest.raises(ValueError, match="one clip"):
        retarget(walk.map(lambda tensor: tensor[None]), other(), prior)
    with pytest.raises(ValueError, match="expected shapes of 16"):
        retarget(walk, other()[:10], prior)
    with pytest.raises(ValueError, match="the shape has nan"):
        retarget(walk, other() * torch.nan, prior)
    with pytest.raises(ValueError, match="the motion has nan"):
        retarget(walk.replace(translation=walk.translation * torch.nan), other(), prior)
    padded = walk.replace(valid=torch.arange(walk.frames) < 30)
    with pytest.raises(ValueError, match="frames exist"):
        retarget(padded, other(), prior)


def test_the_bundled_weights_on_a_recorded_walk():
    """A heavy short body: the copy floats and slips, the result stands."""
    prior = Humos.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        walk = load_motion(path).motion.resample(20.0).window(0, 50)
    shape = identity("short,heavy", BODY)
    touch = physics_samples(walk, BODY).soles_touch
    pelvis = BODY.rest_joints(walk.shape)[0] - BODY.rest_joints(shape)[0]
    copy = walk.replace(shape=shape, translation=walk.translation + pelvis)
    motions = {
        "truth": walk,
        "copy": copy,
        "made": retarget(walk, shape, prior),
    }
    rows = {
        name: {k: v or 0.0 for k, v in physics_metrics(physics_samples(m, BODY, touch)).items()}
        for name, m in motions.items()
    }
    assert rows["made"]["physdiff_float"] < 0.1 * rows["copy"]["physdiff_float"]
    assert rows["made"]["slip_in_contact"] < 0.6 * rows["copy"]["slip_in_contact"]
    assert rows["made"]["penetrate"] < rows["truth"]["penetrate"] + 0.003
    turned = so3.geodesic_angle(motions["made"].rotations, walk.rotations).mean().rad2deg()
    assert 0.05 < float(turned) < 6
