"""Previews: what a network proposes for points of any rate and length, ours or somebody else's."""

from dataclasses import replace

import pytest
import torch

import recon
from recon import cli
from recon.core import rotations as so3
from recon.core.errors import ObservationError, ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, LEGS
from recon.formats.observations import PositionsFile, save_observation
from recon.simulation.points import Corruption, joints3d, markers3d
from tests.filmed import bundled, cameras, joint_error, view, walk
from tests.own_look import Standing

pytestmark = pytest.mark.numerics


LENGTH = 60
"""Frames of the walk at 30 Hz."""


def there_and_back(frames: int) -> Motion:
    """The walk forwards and backwards in turn, for as long as is asked for."""
    once = list(range(LENGTH))
    turns = torch.tensor((once + once[::-1]) * (frames // (2 * LENGTH) + 1))[:frames]
    motion = walk(LENGTH)
    return Motion.create(
        motion.translation[turns], motion.rotations[turns], motion.shape, motion.fps
    )


def seen(motion: Motion, noise: float = 0.02):
    return joints3d(motion, bundled(), Corruption(noise=noise), 0)


def previewed(given, truth: Motion, **how) -> tuple[recon.Result, float]:
    """The preview, checked to say that it is one, and its mean error, metres."""
    result = recon.fit(given, method=how.pop("method", "look"), **how)
    assert result.motion.frames == truth.frames
    assert result.warnings[0].code == "preview"
    report = result.report()
    assert report["stages"] == []
    assert all(bool(torch.isfinite(one).all()) for one in result.motion.tensors().values())
    return result, joint_error(result.motion, truth)


@pytest.mark.parametrize(("frames", "fps"), [(1, 30.0), (30, 15.0), (60, 30.0), (240, 120.0)])
def test_points_of_any_rate_give_a_motion_of_that_rate(frames, fps):
    truth = walk(LENGTH + 1).resample(fps).window(0, frames)
    result, error = previewed(seen(truth), truth)
    assert result.motion.fps == fps
    assert error < 0.06
    assert result.joint_std is not None
    assert 0.003 < float(result.joint_std.median()) < 0.08


def test_long_recordings_have_no_seams():
    truth = there_and_back(400)
    result, error = previewed(seen(truth), truth)
    assert error < 0.06
    step, usual = (one.diff(dim=0).norm(dim=-1).amax() for one in
                   (result.joints, bundled().pose(truth).joints))  # fmt: skip
    assert step < 2 * usual


def test_nine_of_ten_errors_lie_within_the_standard_deviations():
    truth = there_and_back(200)
    given = seen(truth, 0.04)
    hidden = given.visible.clone()
    hidden[..., list(LEGS)] = False
    for one in (given, given.replace(visible=hidden)):
        result, _ = previewed(one, truth)
        assert result.joint_std is not None
        away = (result.joints - bundled().pose(truth).joints).abs()
        assert (away < 1.645 * result.joint_std[..., None]).float().mean() > 0.75


def test_long_gaps_are_bridged_and_are_told_to_be_uncertain():
    """The network has seen gaps of two seconds; beyond, it put the person into the origin."""
    truth = there_and_back(260)
    given = seen(truth)
    visible = given.visible.clone()
    visible[60:220] = False
    result, _ = previewed(given.replace(visible=visible), truth)
    speed = 30 * result.joints.diff(dim=0).norm(dim=-1).amax()
    assert speed < 8.0  # metres per second
    assert result.joint_std is not None
    assert result.joint_std[140].min() > 0.3
    assert result.joint_std[20].max() < 0.2
    assert "guessed" in [one.code for one in result.diagnosis]


def test_an_unknown_height_of_the_ground_is_found():
    truth = walk(LENGTH)
    lifted = truth.replace(translation=truth.translation + torch.tensor([0.0, 0.0, 0.7]))
    given = seen(lifted).replace(ground_known=False)
    result, error = previewed(given, lifted)
    assert error < 0.06
    assert result.ground is not None
    assert float(result.ground[3]) == pytest.approx(0.7, abs=0.04)


def test_markers_and_several_sensors_are_seen_together():
    truth = walk(LENGTH)
    markers = markers3d(truth, bundled(), Corruption(noise=0.01), seed=0)
    _, alone = previewed(markers, truth)
    _, both = previewed([markers, seen(truth, 0.01)], truth)
    assert max(alone, both) < 0.06


def test_views_of_calibrated_cameras_are_triangulated():
    truth = walk(LENGTH)
    views = [view(truth, one) for one in cameras(truth, 3)]
    _, error = previewed(views, truth)
    assert error < 0.06
    with pytest.raises(ObservationError, match="points in space"):
        recon.fit(views[:1], method="look")


def test_a_known_shape_is_held():
    truth = walk(LENGTH)
    result, error = previewed(seen(truth), truth, shape=truth.shape)
    torch.testing.assert_close(result.motion.shape, truth.shape)
    assert error < 0.06


@pytest.mark.parametrize(
    "how",
    [{"prior": "pose"}, {"physics": 1.0}, {"start": walk(12)}, {"method": "lok"},
     {"method": "tests.own_look:Nobody"}, {"method": "recon.core.skeleton:JOINTS"}],
)  # fmt: skip
def test_what_a_preview_does_not_heed_is_refused(how):
    with pytest.raises(ReconError, match="method"):
        recon.fit(seen(walk(12)), **{"method": "look", **how})


@pytest.mark.parametrize("method", ["tests.own_look:Standing", Standing()])
def test_a_network_of_somebody_else_gives_previews(method):
    truth = walk(LENGTH)
    result, error = previewed(seen(truth), truth, method=method)
    assert error < 0.2  # the second, likelier motion walks
    assert result.joint_std is None
    assert result.motion.rotations.diff(dim=0).abs().max() > 0.01


@pytest.mark.parametrize(
    ("wrong", "said"),
    [(lambda _: None, "ProposedMotions"),
     (lambda found: replace(found, log_weight=torch.zeros(3)), "weight for each"),
     (lambda found: replace(found, log_weight=torch.full((2,), torch.nan)), "NaN"),
     (lambda found: replace(found, joint_std=torch.ones(2, 5, 22)), "joint_std"),
     (lambda found: replace(found, motions=found.motions.window(0, 5)), "frames")],
)  # fmt: skip
def test_what_is_no_proposal_is_refused(wrong, said):
    def look(observations, body):
        return wrong(Standing()(observations, body))

    with pytest.raises(ReconError, match=said):
        recon.fit(seen(walk(12)), method=look)


def test_the_command_line_gives_previews(tmp_path):
    given, out = tmp_path / "seen.npz", tmp_path / "motion.npz"
    points = seen(walk(LENGTH))
    file = PositionsFile(
        "joints3d", points.positions.numpy(), points.visible.numpy(), JOINTS, points.fps
    )
    save_observation(given, file)
    assert cli.run(f"fit {given} --method look --out {out}".split()) == cli.OK
    assert joint_error(recon.load_motion(out).motion, walk(LENGTH)) < 0.06


def test_points_far_from_what_the_network_knows_are_told():
    truth = walk(LENGTH)
    result, _ = previewed(seen(truth), truth)
    assert "unfamiliar" not in [one.code for one in result.warnings]
    down = truth.rotations.clone()
    down[:, 0] = so3.exp(torch.tensor([2.6, 0.0, 0.0])) @ down[:, 0]
    result, _ = previewed(seen(truth.replace(rotations=down)), truth)
    assert "unfamiliar" in [one.code for one in result.warnings]
