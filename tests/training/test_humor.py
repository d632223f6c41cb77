"""Training HuMoR: windows are what was recorded, runs go on where they were, losses fall."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from priors.humor.networks import HumorNetworks
from priors.humor.prior import Humor
from priors.humor.state import rest_pelvis, states_of
from recon.body.contacts import rest_heights
from recon.body.model import BodyModel, forward_kinematics
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import CONTACT_JOINTS, MIRROR
from recon.formats.motions import save_motion
from tests.priors.test_pose import swinging
from training.humor.corpus import Corpus, StateWindows, Variation, kind_of_motion
from training.humor.losses import LossWeights, loss_terms, total_loss, unroll
from training.humor.scaling import ScaledNetworks, Scaling
from training.humor.train import HumorRun, HumorTraining, export_weights, train
from training.run import CHECKPOINT, Run, read_state

SPLITS = """
[subjects]
[test]
subjects = ["07"]
[validation]
subjects = ["06"]
every_tenth = []
[licence]
non_commercial = ["dataset-*"]
[excluded]
clips = []
"""

AS_RECORDED = Variation(mirror=0.0, reverse=0.0, speed=0.0, shape=0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus of made-up clips, at several rates, one on a playground, one without contacts."""
    root = tmp_path_factory.mktemp("humor")
    (root / "splits.toml").write_text(SPLITS)
    corpus = root / "corpus"
    corpus.mkdir()
    rates = {"08_01": 120.0, "09_01": 30.0, "10_01": 120.0, "11_01": 120.0}
    rates |= {"06_01": 120.0, "07_01": 120.0}
    for seed, (name, fps) in enumerate(rates.items()):
        motion = swinging(int(2 * fps), seed, fps)
        contacts = torch.zeros(motion.frames, 22, dtype=torch.float64)
        contacts[:, 7] = 1.0  # the left ankle
        save_motion(
            corpus / f"{name}.npz",
            MotionFile(motion, contacts=None if name == "11_01" else contacts),
        )
        (corpus / f"{name}.json").write_text(json.dumps({"flat": name != "10_01"}))
    return root


def corpus_of(folder: Path, body: BodyModel) -> Corpus:
    return Corpus.load(settings_of(folder, folder / "run"), "train", body)


def settings_of(folder: Path, out: Path, steps: int = 6) -> HumorTraining:
    return HumorTraining(
        corpus=folder / "corpus",
        out=out,
        splits=folder / "splits.toml",
        width=64,
        steps=steps,
        windows=4,
        own_from=0.3,
        own_until=0.6,
        validate_every=3,
        save_every=0.0,
    )


def drawn(corpus: Corpus, variation: Variation, windows: int = 6, frames: int = 5) -> StateWindows:
    return corpus.draw(windows, frames, variation, torch.Generator().manual_seed(0))


def test_uneven_ground_and_other_parts_are_left_out(folder: Path) -> None:
    corpus = corpus_of(folder, BodyModel.load())
    assert corpus.names == ("08_01", "09_01", "11_01")
    assert corpus.trusted.tolist() == [True, True, False]
    assert corpus.count.tolist() == [240, 237, 240]  # all at 120 Hz


def test_windows_are_what_was_recorded(folder: Path) -> None:
    body = BodyModel.load()
    windows = corpus_of(folder, body).all_windows(11)
    clip = swinging(240, 0, 120.0).to(dtype=torch.float32)  # 08_01
    expected = states_of(clip[None], body)[0]
    for name, value in windows.states[0].tensors().items():
        target = expected.tensors()[name][1:42:4]
        torch.testing.assert_close(value, target, rtol=0, atol=2e-3)  # m/s, of float32 / 120 Hz
    between = corpus_of(folder, body).all_windows(11).states[5]  # 09_01, recorded at 30 Hz
    known = swinging(240, 1, 120.0)  # the same function of time
    torch.testing.assert_close(between.pose[3], known.rotations[13, 1:].float(), rtol=0, atol=2e-3)


@pytest.mark.parametrize("variation", [AS_RECORDED, Variation(0.5, 0.5, 0.15, 1.0)])
def test_whatever_is_drawn_agrees_with_itself(folder: Path, variation: Variation) -> None:
    """Joints are those of the pose, and velocities those of the joints."""
    windows = drawn(corpus_of(folder, BodyModel.load()), variation)
    states = windows.states
    rotations = torch.cat((states.root[..., None, :, :], states.pose), -3)
    joints = forward_kinematics(rotations, windows.rest)[1] + states.translation[..., None, :]
    torch.testing.assert_close(joints, states.joints, rtol=0, atol=1e-5)  # metres
    moved = states.joints[:, 2:] - states.joints[:, :-2]
    torch.testing.assert_close(
        states.joint_velocities[:, 1:-1], moved * 15, rtol=0, atol=0.02
    )  # m/s; the made-up motions bend little in 1/15 s
    torch.testing.assert_close(states.velocity, states.joint_velocities[:, :, 0])
    identity = torch.eye(3).expand_as(states.pose)
    torch.testing.assert_close(states.pose @ states.pose.mT, identity, rtol=0, atol=1e-5)


def test_mirrored_windows_are_the_mirror_image(folder: Path) -> None:
    corpus = corpus_of(folder, BodyModel.load())
    plain, mirrored = drawn(corpus, AS_RECORDED), drawn(corpus, Variation(1.0, 0.0, 0.0, 0.0))
    flip = torch.tensor([-1.0, 1.0, 1.0])
    expected = (plain.states.joints * flip)[..., list(MIRROR), :]
    torch.testing.assert_close(mirrored.states.joints, expected, rtol=0, atol=2e-3)  # metres
    trusted = plain.trusted
    assert (plain.contacts[trusted][..., CONTACT_JOINTS.index(7)] == 1).all()
    assert (mirrored.contacts[trusted][..., CONTACT_JOINTS.index(8)] == 1).all()
    assert mirrored.contacts.sum() == plain.contacts.sum()


def test_backwards_is_the_same_in_another_order(folder: Path) -> None:
    corpus = corpus_of(folder, BodyModel.load())
    plain, back = drawn(corpus, AS_RECORDED), drawn(corpus, Variation(0.0, 1.0, 0.0, 0.0))
    torch.testing.assert_close(back.states.joints.flip(1), plain.states.joints)
    velocity = -plain.states.joint_velocities
    torch.testing.assert_close(back.states.joint_velocities.flip(1), velocity)
    spin = -plain.states.angular_velocity
    torch.testing.assert_close(back.states.angular_velocity.flip(1), spin, rtol=0, atol=1e-3)


def test_other_bodies_stand_on_the_ground_too(tmp_path: Path) -> None:
    """A body that stands on its soles still does with another shape."""
    body = BodyModel.load()
    upright = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    rotations = torch.eye(3).repeat(240, 22, 1, 1)
    rotations[:, 0] = upright
    rest = body.rest_joints(torch.zeros(16))
    translation = rest_heights(body, torch.zeros(16))[0] * torch.tensor([0.0, 0, 1]) - rest[0]
    motion = Motion.create(translation.repeat(240, 1), rotations, torch.zeros(16), 120.0)
    (tmp_path / "splits.toml").write_text(SPLITS)
    save_motion(tmp_path / "08_01.npz", motion)
    settings = HumorTraining(tmp_path, tmp_path / "run", splits=tmp_path / "splits.toml")
    corpus = Corpus.load(settings, "train", body)
    windows = drawn(corpus, Variation(0.0, 0.0, 0.0, 1.0))
    # a standing body's joints are as high above its soles as at rest
    above = windows.states.joints[:, 0, :, 2] - windows.rest[..., 1]
    torch.testing.assert_close(above, above[:, :1].expand_as(above), rtol=0, atol=1e-5)  # metres
    assert above.std(0)[0] > 1e-3  # bodies differ
    for number in range(len(above)):
        seen = windows.rest[number] - body.joint_template
        shape = torch.linalg.lstsq(body.joint_directions.flatten(0, 1), seen.flatten()).solution
        sole = -body.rest_vertices(shape)[:, 1].min()
        assert abs(above[number, 0] - sole) < 2e-3  # metres; joints tell a shape not exactly


def test_losses_are_zero_at_the_truth(folder: Path) -> None:
    windows = drawn(corpus_of(folder, BodyModel.load()), AS_RECORDED)
    networks = ScaledNetworks(HumorNetworks(64), Scaling.identity())
    with torch.no_grad():
        found, target = unroll(networks, windows, torch.ones(4, dtype=torch.bool), None)
    certain = (2 * windows.contacts[:, 1:] - 1) * 100
    perfect = found.replace(
        after=target,
        contacts=certain,
        posterior_mean=found.prior_mean,
        posterior_log_variance=found.prior_log_variance,
    )
    losses = loss_terms(perfect, target, windows)
    for name, value in losses.items():
        if name != "contact_velocity":
            assert value.item() == pytest.approx(0.0, abs=1e-9), name
    assert target.translation.shape == (6, 4, 3)
    two = {"kl": torch.tensor(2.0), "velocity": torch.tensor(3.0), "contacts": torch.tensor(5.0)}
    assert total_loss(two, 0.5, LossWeights(kl=4.0, contacts=0.0)).item() == pytest.approx(7.0)


def test_own_predictions_are_fed_back_without_gradient(folder: Path) -> None:
    windows = drawn(corpus_of(folder, BodyModel.load()), AS_RECORDED)
    networks = ScaledNetworks(HumorNetworks(64), Scaling.identity())
    truth, target = unroll(networks, windows, torch.tensor([True] * 4), None)
    own, same = unroll(networks, windows, torch.tensor([True, False, True, False]), None)
    torch.testing.assert_close(own.after.joints[:, 0], truth.after.joints[:, 0])
    torch.testing.assert_close(own.after.joints[:, 2], truth.after.joints[:, 2])
    assert not torch.allclose(own.after.joints[:, 1], truth.after.joints[:, 1])
    torch.testing.assert_close(same.joints, target.joints)
    level = torch.tensor([1.0, 1.0, 0.0])
    pelvis = (windows.rest[:, None, 0] * level).expand(-1, 4, 3)
    torch.testing.assert_close(rest_pelvis(target), pelvis, rtol=0, atol=1e-5)  # metres


@pytest.mark.slow
def test_a_run_that_was_interrupted_goes_on_exactly(folder: Path, tmp_path: Path) -> None:
    whole = replace(settings_of(folder, tmp_path / "whole"), validate_every=6)
    train(whole)
    parts = replace(whole, out=tmp_path / "parts")

    class Interrupted(Exception):
        pass

    save, saved = Run.save, []

    def once(run: Run) -> None:
        save(run)
        saved.append(run.step)
        if len(saved) == 4:
            raise Interrupted

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Run, "save", once)
        with pytest.raises(Interrupted):
            train(parts)
    train(parts)
    a, b = (torch.load(s.out / "checkpoint.pt", weights_only=True) for s in (whole, parts))
    assert a["step"] == b["step"] == 6
    for name, value in a["averaged"].items():
        assert torch.equal(value, b["averaged"][name]), name
    assert (whole.out / "losses.csv").read_text() == (parts.out / "losses.csv").read_text()
    assert (whole.out / "losses.png").stat().st_size > 1000
    assert "step 6" in (whole.out / "train.log").read_text()
    with pytest.raises(ValueError, match="other width"):
        train(replace(whole, width=96))

    path = export_weights(whole, tmp_path / "humor.safetensors", samples=300)
    prior = Humor.load(path)
    decoded = prior.decode(prior.encode(swinging(5, 0)[None]))
    assert all(energy.isfinite().all() for energy in decoded.energies.values())
    with pytest.raises(FileNotFoundError, match="train first"):
        export_weights(replace(whole, out=tmp_path / "absent"), path)


def test_scales_change_nothing_but_the_numbers_that_are_learned(folder: Path) -> None:
    """Around plain networks and plain again: the same functions."""
    windows = drawn(corpus_of(folder, BodyModel.load()), AS_RECORDED, windows=20)
    scaling = Scaling.of(windows.states, rest_pelvis(windows.states[:, 0]))
    plain = HumorNetworks(64)
    scaled = ScaledNetworks.wrapping(plain, scaling)
    assert not torch.equal(scaled.core.prior_net.net[0].weight, plain.prior_net.net[0].weight)
    x = windows.states.pack()[:, 0]
    after, latent = x + 0.01 * torch.randn_like(x), torch.randn(len(x), 48)
    for other in (scaled, scaled.unscaled_networks()):
        pairs = (
            (plain.prior(x)[0], other.prior(x)[0]),
            (plain.posterior(x, after)[1], other.posterior(x, after)[1]),
            (plain.decode(x, latent), other.decode(x, latent)),
        )
        for expected, found in pairs:
            torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)


def test_a_run_can_begin_with_weights(folder: Path, tmp_path: Path) -> None:
    first = settings_of(folder, tmp_path / "first", steps=3)
    train(first)
    path = export_weights(first, tmp_path / "humor.safetensors", samples=300)
    corpus = corpus_of(folder, BodyModel.load())
    again = HumorRun(replace(first, out=tmp_path / "second", start=path), corpus, corpus)
    x = drawn(corpus, AS_RECORDED).states.pack()[:, 0]
    expected = Humor.load(path).networks.prior(x)[0]
    torch.testing.assert_close(again.averaged.prior(x)[0], expected, rtol=1e-3, atol=1e-3)


def test_people_on_uneven_ground_only_can_be_held_out(folder: Path, tmp_path: Path) -> None:
    """A training whose validation part had no clip on flat ground ended with an error, so nobody
    could be held out who was recorded on a playground only."""
    splits = tmp_path / "splits.toml"
    splits.write_text(SPLITS.replace('subjects = ["06"]', 'subjects = ["10"]'))
    settings = replace(settings_of(folder, tmp_path / "run", steps=3), splits=splits)
    train(settings)
    assert "no validation clip teaches steps" in (settings.out / "train.log").read_text()
    state = read_state(settings.out / CHECKPOINT)
    assert state is not None
    assert state["step"] == 3


def test_every_setting_of_a_training_has_an_option_of_its_own() -> None:
    """The steps of a run and the steps aside had one option, so that the command did not start."""
    command = [sys.executable, "-m", "training.humor.train", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "--sidesteps" in done.stdout


def test_kinds_of_motion_are_recognised_by_words() -> None:
    assert kind_of_motion("walk on uneven terrain") == "uneven ground"
    assert kind_of_motion("run/jog") == "run"
    assert kind_of_motion("salsa dance") == "dance"
    assert kind_of_motion("wash self") == "other"
