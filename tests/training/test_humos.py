"""Training the HUMOS prior: windows are what was recorded, runs go on, physics pulls."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from priors.humos.frames import BodyFrames, existing_windows
from priors.humos.prior import Humos
from recon.benchmark.dataset import Part
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core.motion import MotionFile
from recon.formats.motions import save_motion
from tests.training.test_humor import SPLITS
from tests.walking import a_walk
from training.humos.corpus import BodyCorpus, BodyVariation
from training.humos.losses import physics_losses, reconstruction_error
from training.humos.train import HumosRun, HumosTraining, export_weights, train

BODY = BodyModel.load()
AS_RECORDED = BodyVariation(mirror=0.0, shape=0.0, unseen=0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus of made-up walks; one on a playground, one up in the air, one too short."""
    root = tmp_path_factory.mktemp("humos")
    (root / "splits.toml").write_text(SPLITS)
    corpus = root / "corpus"
    corpus.mkdir()
    for k, name in enumerate(("08_01", "08_02", "09_01", "10_01", "dataset-1_walk", "06_01")):
        walk = a_walk(BODY, seconds=3.0, period=0.8 + 0.1 * k, speed=0.8 + 0.1 * k)
        save_motion(corpus / f"{name}.npz", MotionFile(walk))
    (corpus / "10_01.json").write_text('{"flat": false}')
    walk = a_walk(BODY, seconds=3.0)
    swing = (torch.arange(walk.frames)[:, None] / 20).sin() * torch.tensor([0.0, 0.0, 1.0])
    high = walk.replace(translation=walk.translation + swing)
    save_motion(corpus / "08_03.npz", MotionFile(high))
    save_motion(corpus / "08_04.npz", MotionFile(walk.window(0, 30)))
    return root


def corpus_of(folder: Path, part: Part = "train", **more) -> BodyCorpus:
    return BodyCorpus.load(settings_of(folder, folder / "run"), part, BODY, **more)


def settings_of(folder: Path, out: Path, **more) -> HumosTraining:
    tiny = {
        "latent": 4, "basis": 12, "basis_from": 256, "width": 16, "layers": 1, "warm_steps": 4,
        "steps": 4, "clips": 3, "frames": 40, "physics_frames": 8, "validate_every": 2,
        "save_every": 0.0, "speeds": (1.0,),
    }  # fmt: skip
    plain = HumosTraining(corpus=folder / "corpus", out=out, splits=folder / "splits.toml")
    return replace(plain, **(tiny | more))


def test_clips_of_the_part_and_licence_that_stand_on_the_ground(folder):
    assert set(corpus_of(folder).names) == {"08_01", "08_02", "09_01"}
    assert len(corpus_of(folder, speeds=(0.9, 1.1)).names) == 6
    with pytest.raises(ValueError, match="no test clip"):
        corpus_of(folder, part="test")


def test_windows_are_what_was_recorded(folder):
    corpus = corpus_of(folder)
    batch = corpus.all_windows(60, 10, torch.Generator().manual_seed(0))
    walk = a_walk(BODY, seconds=3.0, period=0.8, speed=0.8).resample(20.0)
    expected, _ = BodyFrames.of(walk, BODY)
    close = {"atol": 2e-3, "rtol": 0}
    made = batch.frames.map(lambda rows: rows[0, :60])
    torch.testing.assert_close(made.place, expected.place[:60], **close)
    torch.testing.assert_close(made.orientations, expected.orientations[:60], **close)
    # put on the ground by one height for the whole clip
    drop = expected.clearance[:60] - made.clearance
    assert float(drop.std()) < 1e-5
    own = corpus.frames.clearance[: int(corpus.count[0])]
    assert float((own < 0).double().mean()) == pytest.approx(0.05, abs=0.03)
    pelvis = walk.translation[:60, 2] + BODY.rest_joints(walk.shape)[0, 2]
    fall = pelvis / leg_length(BODY, walk.shape) - batch.height[0]
    torch.testing.assert_close(fall, drop, atol=1e-4, rtol=0)
    assert batch.valid.all()


def test_drawn_windows_are_varied_and_padded(folder):
    corpus = corpus_of(folder)
    random = torch.Generator().manual_seed(0)
    plain = corpus.draw(8, 80, AS_RECORDED, random)
    assert int(plain.valid.sum(-1).max()) < 80
    same = (plain.shape[:, None] - corpus.shape).abs().sum(-1).amin(-1)
    assert float(same.max()) == 0
    varied = corpus.draw(64, 40, BodyVariation(), random)
    assert float(varied.shape.std()) > 0.3
    assert float(varied.other.std()) > 0.5
    orthonormal = varied.frames.orientations @ varied.frames.orientations.mT
    eye = torch.eye(3).expand_as(orthonormal)
    torch.testing.assert_close(orthonormal, eye, atol=1e-5, rtol=0)


def test_losses_are_zero_for_what_was_recorded_and_grow_with_errors(folder):
    corpus = corpus_of(folder)
    batch = corpus.draw(2, 40, AS_RECORDED, torch.Generator().manual_seed(0))
    rows = batch.frames.pack()
    assert float(reconstruction_error(rows, batch, BODY)) < 1e-5
    ahead = rows.clone()
    ahead[..., -3] += 0.02  # metres along x, all joints alike
    found = float(reconstruction_error(ahead, batch, BODY))
    legs = (rows[0, -1, -2] - 0).isfinite()
    assert bool(legs)
    assert 0.5 / rows.shape[-1] < found < 2.0


def test_physics_sees_sinking_hovering_and_sliding(folder):
    corpus = corpus_of(folder)
    batch = corpus.draw(2, 40, AS_RECORDED, torch.Generator().manual_seed(0))
    stands = batch.frames.replace(
        place=0 * batch.frames.place, clearance=0 * batch.frames.clearance,
        orientations=batch.frames.orientations[:, :1].expand(-1, 40, -1, -1, -1),
    )  # fmt: skip
    batch = batch.replace(frames=stands, height=batch.height[:, :1].expand(-1, 40))

    def found(frames):
        return physics_losses(frames.pack(), batch, BODY)

    still = found(stands)
    assert float(still.ground) == pytest.approx(0, abs=1e-8)
    assert float(still.slide) == pytest.approx(0, abs=1e-9)
    assert float(still.bounce) == pytest.approx(0, abs=1e-9)
    trembling = stands.clearance + 0.01 * torch.arange(40).fmod(2)
    assert float(found(stands.replace(clearance=trembling)).bounce) == pytest.approx(
        0.5 * 0.02**2, rel=0.1
    )
    for height in (0.05, -0.05):
        moved = stands.replace(clearance=stands.clearance + height)
        assert float(found(moved).ground) > 1e-4
    slid = torch.stack((torch.linspace(0, 0.5, 40), torch.zeros(40)), -1).expand(2, 40, 2)
    assert float(found(stands.replace(place=slid)).slide) > 1e-6


def test_windows_that_hold_a_frame_exist():
    count = torch.tensor([[40], [9], [1]])
    assert existing_windows(count, 40).sum(-1).tolist() == [6, 3, 2]


def test_a_run_that_was_cut_goes_on_as_if_it_had_not_been(folder, tmp_path, monkeypatch):
    corpus, checked = corpus_of(folder), corpus_of(folder, part="validation")
    whole = settings_of(folder, tmp_path / "whole")
    cut = replace(whole, out=tmp_path / "cut")
    for settings in (whole, cut):
        settings.out.mkdir()
    HumosRun(whole, corpus, checked).train_to_end()
    run = HumosRun(cut, corpus, checked)
    losses = run.losses

    def failing():
        if run.step == 5:
            raise KeyboardInterrupt
        return losses()

    monkeypatch.setattr(run, "losses", failing)
    with pytest.raises(KeyboardInterrupt):
        run.train_to_end()
    HumosRun(cut, corpus, checked).train_to_end()
    one, other = (
        torch.load(s.out / "checkpoint.pt", weights_only=True)["averaged"] for s in (whole, cut)
    )
    for name, tensor in one.items():
        torch.testing.assert_close(tensor, other[name], atol=1e-5, rtol=1e-4)
    with pytest.raises(ValueError, match="a run with other latent"):
        HumosRun(replace(cut, latent=5), corpus, checked)


def test_a_run_of_an_older_version_is_exported(folder, tmp_path):
    """Exporting began the run anew, which a checkpoint of 0.1.0, without identity, refused."""
    settings = settings_of(folder, tmp_path / "run", warm_steps=1, steps=1)
    train(settings)
    state = torch.load(settings.out / "checkpoint.pt", weights_only=True)
    older = {k: v for k, v in state.items() if k not in ("identity", "torch_random", "sums")}
    torch.save(older | {"dropout": state["torch_random"]}, settings.out / "checkpoint.pt")
    path = export_weights(settings, tmp_path / "humos.safetensors")
    networks = Humos.load(str(path), BODY).weights.networks
    for name, tensor in networks.state_dict().items():
        torch.testing.assert_close(tensor, older["averaged"][name], atol=1e-3, rtol=1e-3)
    with pytest.raises(ValueError, match="older version"):
        train(settings)


def test_the_weight_decay_of_the_settings_is_taken(folder, tmp_path):
    """It was a setting that nothing read: torch's own default decayed the weights."""
    settings = settings_of(folder, tmp_path, decay=0.5)
    corpus = corpus_of(folder)
    (group,) = HumosRun(settings, corpus, corpus).optimiser.param_groups
    assert group["weight_decay"] == 0.5


def test_settings_that_mean_nothing_are_refused(folder, tmp_path):
    with pytest.raises(ValueError, match="at most basis, 256 principal directions, got 320"):
        settings_of(folder, tmp_path, latent=320, basis=256)
    with pytest.raises(ValueError, match="width must be at least 1"):
        settings_of(folder, tmp_path, width=0)


def test_trained_weights_are_a_prior(folder, tmp_path):
    settings = settings_of(folder, tmp_path / "run")
    train(settings)
    rows = list(csv.DictReader((settings.out / "losses.csv").read_text().splitlines()))
    assert [float(row["step"]) for row in rows] == [2, 4, 6, 8]
    assert (settings.out / "losses.png").is_file()
    path = export_weights(settings, tmp_path / "humos.safetensors")
    prior = Humos.load(str(path), BODY)
    walk = a_walk(BODY, seconds=2.0).map(lambda tensor: tensor[None])
    assert bool(prior.decode(prior.encode(walk)).motion.translation.isfinite().all())
    with pytest.raises(FileNotFoundError, match="train first"):
        export_weights(replace(settings, out=tmp_path), path)
