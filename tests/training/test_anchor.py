"""Training the anchor-frame VAE: cycles are what was recorded, runs go on, losses fall."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from priors.anchor.frames import Anchors, rest_pelvis
from priors.anchor.prior import AnchorFrames
from recon.body.model import BodyModel
from recon.body.sampled import spread_vertices
from recon.formats.motions import MotionFile, save_motion
from tests.training.test_humor import SPLITS
from tests.walking import a_walk
from training.anchor.corpus import CycleCorpus, CycleVariation
from training.anchor.train import (
    AnchorRun,
    AnchorTraining,
    Reconstructed,
    export_weights,
    surface_error,
    train,
)
from training.descent import LEAST, GradNorm

RECORDED = CycleVariation(mirror=0.0, shift=0, shape=0.0, speed=0.0, exchange=0.0, mix=0.0)
"""No variation."""


BODY = BodyModel.load()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus of made-up walks; one on a playground, one under another licence."""
    root = tmp_path_factory.mktemp("anchor")
    (root / "splits.toml").write_text(SPLITS)
    corpus = root / "corpus"
    corpus.mkdir()
    names = ("08_01", "08_02", "09_01", "10_01", "dataset-1_walk", "06_01", "07_01")
    for k, name in enumerate(names):
        period = 0.8 + 0.1 * k
        walk = a_walk(BODY, seconds=3 * period, period=period, speed=0.8 + 0.1 * k, pause=0.2)
        save_motion(corpus / f"{name}.npz", MotionFile(walk))
    (corpus / "10_01.json").write_text('{"flat": false}')
    return root


def corpus_of(folder: Path, licence="open", part="train") -> CycleCorpus:
    settings = replace(settings_of(folder, folder / "run"), data=licence)
    return CycleCorpus.load(settings, part, BODY)


def _nearest(rows, others):
    """Distance of every cycle from the nearest of the others."""
    apart = {"compute_mode": "donot_use_mm_for_euclid_dist"}
    return torch.cdist(rows.flatten(1), others.flatten(1), **apart).amin(-1)


def settings_of(folder: Path, out: Path) -> AnchorTraining:
    return AnchorTraining(
        corpus=folder / "corpus",
        out=out,
        splits=folder / "splits.toml",
        latent=4,
        basis=8,
        basis_from=64,
        width=16,
        steps=6,
        surface_steps=6,
        cycles=8,
        surface_cycles=4,
        validate_every=3,
        save_every=0.0,
    )


def test_only_cycles_of_the_part_and_licence_on_flat_ground(folder):
    assert set(corpus_of(folder).clips) == {"08_01", "08_02", "09_01"}
    assert set(corpus_of(folder, "nc").clips) == {"08_01", "08_02", "09_01", "dataset-1_walk"}
    assert set(corpus_of(folder, part="validation").clips) == {"06_01"}


def test_cycles_are_what_was_recorded(folder):
    corpus = corpus_of(folder)
    batch = corpus.every()
    for row, (clip, cycle) in enumerate(zip(corpus.clips, corpus.cycles, strict=True)):
        period = {"08_01": 0.8, "08_02": 0.9, "09_01": 1.0}[clip]
        k = round((period - 0.8) / 0.1)
        walk = a_walk(BODY, seconds=3 * period, period=period, speed=0.8 + 0.1 * k, pause=0.2)
        expected = Anchors.of(cycle.of(walk, 100))
        aligned, _ = expected.aligned(rest_pelvis(BODY, walk.shape))
        torch.testing.assert_close(batch.anchors[row].pack(), aligned.pack(), atol=2e-4, rtol=0)


def test_nothing_varied_is_nothing_changed(folder):
    corpus = corpus_of(folder)
    random = torch.Generator().manual_seed(0)
    drawn = corpus.draw(16, RECORDED, random).anchors.pack()
    every = corpus.every().anchors.pack()
    away = _nearest(drawn, every)
    assert float(away.max()) < 1e-3


def test_varied_cycles_stay_cycles(folder):
    corpus = corpus_of(folder)
    random = torch.Generator().manual_seed(0)
    batch = corpus.draw(64, CycleVariation(), random)
    anchors = batch.anchors
    eye = torch.eye(3).expand_as(anchors.rotations)
    torch.testing.assert_close(anchors.rotations @ anchors.rotations.mT, eye, atol=1e-5, rtol=0)
    assert float(anchors.translation[:, 0, :2].abs().max()) < 1e-5
    assert bool((anchors.duration > 0.5).all())
    assert bool((anchors.times.diff(dim=-1) > 0).all())
    assert float(batch.shape.std()) > 0.3


def test_a_mirrored_walk_begins_with_the_other_foot(folder):
    corpus = corpus_of(folder)
    always = replace(RECORDED, mirror=1.0)
    random = torch.Generator().manual_seed(0)
    drawn = corpus.draw(32, always, random).anchors.pack()
    every = corpus.every()
    flip = torch.tensor([-1.0, 1.0, 1.0])
    mirrored = (flip[:, None] * every.anchors.rotations * flip)[..., [0, 2, 1], :, :]
    rotations = torch.cat((mirrored, every.anchors.rotations[..., 3:, :, :]), -3)
    expected = every.anchors.replace(rotations=rotations).pack()
    away = _nearest(drawn[..., :18], expected[..., :18])
    assert float(away.max()) < 1e-3


def test_gradnorm_balances_the_same_loss_scaled_differently():
    """The toy problem: two tasks, one a hundred times the other."""
    torch.manual_seed(0)
    shared = torch.randn(6, requires_grad=True)
    targets = torch.randn(2, 6)
    balance = GradNorm(("small", "large"), alpha=0.12)
    for _ in range(200):
        losses = {
            "small": (shared - targets[0]).square().sum(),
            "large": 3 * (shared - targets[1]).square().sum(),
        }
        balance.update(losses, shared)
        (step,) = torch.autograd.grad(balance.total(losses), shared)
        with torch.no_grad():
            shared -= 0.01 * step
    assert sum(balance.weights.values()) == pytest.approx(2.0)
    assert balance.weights["small"] > 1.3
    assert min(balance.weights.values()) >= LEAST * 0.9
    # equal pull: the shared parameters end in the middle, not at the louder task
    middle = targets.mean(0)
    assert float((shared - middle).detach().norm()) < 0.25 * float(
        (targets[0] - targets[1]).norm()
    )


def test_the_surface_error_of_what_it_was_made_of_is_zero(folder, tmp_path):
    corpus = corpus_of(folder)
    batch = corpus.every()
    run_settings = settings_of(folder, tmp_path)
    run = AnchorRun(run_settings, corpus, batch)
    vertices, anchors = spread_vertices(BODY, 20), torch.arange(0, 100, 10)
    rows = batch.anchors.pack()
    normalised = run.networks.basis.normalised(rows)
    nothing = torch.zeros(len(rows), 4)
    exact = Reconstructed(nothing, nothing, nothing, normalised)
    error = surface_error(run.networks, exact, batch, BODY, vertices, anchors)
    assert float(error.max()) < 1e-9
    risen = normalised.clone()
    risen[..., -2] += 2 / (run.networks.basis.high[2] - run.networks.basis.low[2]) * 0.1
    moved = replace(exact, normalised=risen)
    error = surface_error(run.networks, moved, batch, BODY, vertices, anchors)
    torch.testing.assert_close(error, torch.full_like(error, 0.01), atol=1e-5, rtol=0)


def test_a_run_trains_exports_and_loads(folder, tmp_path):
    settings = settings_of(folder, tmp_path / "run")
    # the validation subject has few cycles; they are enough to be measured
    train(settings)
    table = (tmp_path / "run" / "losses.csv").read_text()
    rows = list(csv.DictReader(table.splitlines()))
    assert [row["step"] for row in rows] == ["3", "6", "9", "12"]
    assert all(float(row["vertex_cm"]) < 50 for row in rows)
    path = export_weights(settings, tmp_path / "w.safetensors")
    prior = AnchorFrames.load(str(path), BODY)
    walk = a_walk(BODY, seconds=0.9, period=0.9)[None]
    decoded = prior.decode(prior.encode(walk)).motion
    error = BODY.pose(decoded).joints - BODY.pose(walk).joints
    assert float(error[..., :10, :].norm(dim=-1).mean()) < 0.15


def test_a_cut_run_goes_on_where_it_was(folder, tmp_path, monkeypatch):
    corpus = corpus_of(folder)
    checked = corpus_of(folder, part="validation").every()
    whole, cut = (settings_of(folder, tmp_path / name) for name in ("whole", "cut"))
    for settings in (whole, cut):
        settings.out.mkdir()
    AnchorRun(whole, corpus, checked).go()

    class Cut(Exception):
        pass

    run = AnchorRun(cut, corpus, checked)
    losses = run.losses

    def stopping():
        if run.step == 8:
            raise Cut
        return losses()

    monkeypatch.setattr(run, "losses", stopping)
    with pytest.raises(Cut):
        run.go()
    assert AnchorRun(cut, corpus, checked).step == 8
    AnchorRun(cut, corpus, checked).go()
    one, other = (
        torch.load(settings.out / "checkpoint.pt", weights_only=True)["networks"]
        for settings in (whole, cut)
    )
    for name, tensor in one.items():
        torch.testing.assert_close(tensor, other[name], atol=1e-5, rtol=1e-4)


def test_the_weight_decay_of_the_settings_is_taken(folder, tmp_path):
    """It was a setting that nothing read: torch's own default decayed the weights."""
    settings = replace(settings_of(folder, tmp_path), decay=0.5)
    (group,) = AnchorRun(
        settings, corpus_of(folder), corpus_of(folder).every()
    ).optimiser.param_groups
    assert group["weight_decay"] == 0.5


def test_another_run_in_the_folder_is_refused(folder, tmp_path):
    settings = settings_of(folder, tmp_path)
    corpus = corpus_of(folder)
    AnchorRun(settings, corpus, corpus.every()).save()
    with pytest.raises(ValueError, match="latent"):
        AnchorRun(replace(settings, latent=5), corpus, corpus.every())


def test_exporting_before_training_says_so(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match="train first"):
        export_weights(settings_of(folder, tmp_path), tmp_path / "w")
