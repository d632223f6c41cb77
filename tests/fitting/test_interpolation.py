import math

import pytest
import torch

from priors.anchor.frames import ANCHORS, Anchors, rest_pelvis
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import joint_index
from recon.fitting.interpolation import (
    curve_correlation,
    cycles_of,
    foot_above_other,
    interpolated_cycle,
    motion_of_cycle,
)
from recon.formats.motions import load_motion, save_motion
from tests.priors.tiny_anchor import tiny_prior
from tests.verbs import report_of
from training.weights import save_anchor

pytestmark = pytest.mark.numerics


@pytest.fixture(scope="module")
def body():
    return BodyModel.load()


@pytest.fixture(scope="module")
def prior(body):
    return tiny_prior(body)


@pytest.fixture(scope="module")
def weights(prior, tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "anchor.safetensors"
    save_anchor(path, prior.weights, {})
    return str(path)


def gait(body, seconds=4.0, period=1.0, phase=0.0, side=1.0, turn=0.0, fps=50.0):
    """Legs that swing in opposite phases; the knee bends as its leg swings forward."""
    frames = round(seconds * fps) + 1
    t = torch.arange(frames) / fps * (math.tau / period) + phase
    bend = torch.zeros(frames, 22, 3)
    for name, sign in (("left", 1.0), ("right", -1.0)):
        bend[:, joint_index(f"{name}_hip"), 0] = -0.5 * sign * t.cos()
        bend[:, joint_index(f"{name}_knee"), 0] = 0.6 * (-sign * side * t.sin()).clamp(min=0)
    rotations = so3.exp(bend)
    upright = so3.exp(torch.tensor([math.pi / 2, 0.0, 0.0]))
    facing = so3.about_z(torch.tensor(math.pi + turn))
    rotations[:, 0] = facing @ upright
    place = torch.zeros(frames, 3)
    place[:, 1] = 1.2 * torch.arange(frames) / fps
    place[:, 2] = 0.95 - body.joint_template[0, 2]
    return Motion.create(place, rotations, torch.zeros(body.shape_size), fps)


def encoded(prior, motion):
    return prior.encode(motion.map(lambda tensor: tensor[None]))


def cycle(body, **about):
    return gait(body, seconds=1.0, **about)


def test_the_ends_are_the_decoded_ends(prior, body):
    a = encoded(prior, cycle(body))
    b = encoded(prior, cycle(body, turn=1.0, side=0.5))
    for share, end in ((0.0, a), (1.0, b)):
        mixed = interpolated_cycle(prior, a, b, share)
        torch.testing.assert_close(mixed.latent, end.latent)
        torch.testing.assert_close(mixed.base, end.base, atol=1e-5, rtol=1e-5)


def test_codes_shapes_headings_and_places_are_halfway(prior, body):
    a = encoded(prior, cycle(body))
    other = cycle(body, turn=1.0)
    tall = torch.full((body.shape_size,), 0.5)
    b = encoded(prior, other.replace(shape=tall, translation=other.translation + 2.0))
    mixed = interpolated_cycle(prior, a, b, 0.5)
    torch.testing.assert_close(mixed.latent, (a.latent + b.latent) / 2)
    torch.testing.assert_close(mixed.shape, (a.shape + b.shape) / 2)
    relative = [float(so3.log(a.base[:, :3, :3].mT @ x.base[:, :3, :3])[0, 2]) for x in (mixed, b)]
    assert relative[0] == pytest.approx(relative[1] / 2, abs=1e-4)
    starts = []
    for x in (a, mixed, b):
        pelvis = rest_pelvis(body, x.shape)
        starts.append((x.base[:, :3, :3] @ pelvis[..., None])[..., 0] + x.base[:, :3, 3])
    torch.testing.assert_close(starts[1], (starts[0] + starts[2]) / 2)


def test_a_played_cycle_lasts_as_long_as_its_anchors(prior, body):
    x = encoded(prior, cycle(body))
    motion = motion_of_cycle(prior, x, 60.0)
    duration = float(prior.anchors(x).duration[0])
    assert (motion.frames - 1) / 60 == pytest.approx(duration, abs=1 / 60)
    torch.testing.assert_close(
        motion.translation[:, 0], prior.anchors(x).translation[:, 0], atol=1e-4, rtol=0
    )


def test_a_file_of_one_cycle_is_taken_whole(body):
    (whole,) = cycles_of(cycle(body))
    assert (whole.start, whole.stop, whole.side) == (0.0, 1.0, "left")
    assert cycles_of(cycle(body, phase=math.pi))[0].side == "right"
    assert all(part.duration < 1.5 for part in cycles_of(gait(body)))
    still = cycle(body)
    assert cycles_of(still.replace(rotations=still.rotations[:1].expand(51, -1, -1, -1))) == ()


def test_feet_agree_with_themselves_and_not_with_the_other_side(body):
    lifts = torch.stack([
        foot_above_other(body.pose(Anchors.of(cycle(body, **about)).motion(
            torch.zeros(body.shape_size), ANCHORS - 1.0)).joints)
        for about in ({}, {"phase": math.pi})
    ])  # fmt: skip
    agree = curve_correlation(lifts, lifts)
    torch.testing.assert_close(agree.diagonal(), torch.ones(2))
    assert agree[0, 1] < -0.8


def test_files_are_mixed_and_described(weights, body, tmp_path):
    paths = [tmp_path / name for name in ("a.npz", "b.npz")]
    save_motion(paths[0], MotionFile(gait(body), body.name, body.checksum))
    save_motion(paths[1], MotionFile(gait(body, period=1.4, turn=0.5), body.name, body.checksum))
    out = tmp_path / "between.npz"
    pair = {"a": paths[0], "b": paths[1]}
    report = report_of("interpolate", out, **pair, weights=weights, fps=60.0)
    made = load_motion(out)
    assert made.checksum == body.checksum
    assert made.motion.fps == 60
    d = report["durations"]
    assert min(d["A"], d["B"]) - 0.05 < d["result"] < max(d["A"], d["B"]) + 0.05
    assert report["feet agree"] > 0.5
    assert out.with_name("between.npz.json").is_file()


def test_bad_input_is_named(weights, body, tmp_path):
    good, bad = tmp_path / "good.npz", tmp_path / "standing.npz"
    motion = gait(body)
    save_motion(good, motion)
    still = motion.replace(rotations=motion.rotations[:1].expand(motion.frames, -1, -1, -1))
    save_motion(bad, still)
    out = tmp_path / "out.npz"
    with pytest.raises(ValueError, match=r"standing\.npz: found no cycle"):
        report_of("interpolate", out, a=good, b=bad, weights=weights)
    with pytest.raises(ValueError, match="at: expected a number from 0"):
        report_of("interpolate", out, a=good, b=good, at=1.5, weights=weights)
    with pytest.raises(ValueError, match="fps: expected"):
        report_of("interpolate", out, a=good, b=good, weights=weights, fps=0.0)
    save_motion(bad, MotionFile(motion, "other", "0" * 16))
    with pytest.raises(ValueError, match=r"standing\.npz: made with the body other"):
        report_of("interpolate", out, a=good, b=bad, weights=weights)
    assert not out.exists()


def test_cycles_on_different_feet_are_refused(weights, body, tmp_path):
    paths = [tmp_path / name for name in ("left.npz", "right.npz")]
    save_motion(paths[0], cycle(body))
    save_motion(paths[1], cycle(body, phase=math.pi))
    with pytest.raises(ValueError, match="stands on the right"):
        report_of("interpolate", tmp_path / "out.npz", a=paths[0], b=paths[1], weights=weights)
