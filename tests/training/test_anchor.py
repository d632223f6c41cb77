"""Learning cycles of gait: cycles are what was recorded, and their components are a prior."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from priors.anchor.frames import Anchors, rest_pelvis
from priors.anchor.networks import AnchorWeights
from priors.anchor.prior import AnchorFrames
from recon.benchmark.dataset import Part
from recon.body.model import BodyModel
from recon.core.motion import MotionFile
from recon.formats.motions import save_motion
from tests.training.test_humor import SPLITS
from tests.walking import a_walk
from training.anchor.corpus import CycleCorpus, CycleVariation
from training.anchor.train import AnchorTraining, export_weights, principal_components

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


def corpus_of(folder: Path, part: Part = "train") -> CycleCorpus:
    return CycleCorpus.load(settings_of(folder, folder / "run"), part, BODY)


def _nearest(rows, others):
    """Distance of every cycle from the nearest of the others."""
    apart = {"compute_mode": "donot_use_mm_for_euclid_dist"}
    return torch.cdist(rows.flatten(1), others.flatten(1), **apart).amin(-1)


def settings_of(folder: Path, out: Path) -> AnchorTraining:
    splits = folder / "splits.toml"
    return AnchorTraining(folder / "corpus", out, splits=splits, latent=24, basis_from=512)


def test_only_cycles_of_the_part_and_licence_on_flat_ground(folder):
    assert set(corpus_of(folder).clips) == {"08_01", "08_02", "09_01"}
    assert set(corpus_of(folder, part="validation").clips) == {"06_01"}


def test_cycles_are_what_was_recorded(folder):
    corpus = corpus_of(folder)
    batch = corpus.all_cycles()
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
    every = corpus.all_cycles().anchors.pack()
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
    every = corpus.all_cycles()
    flip = torch.tensor([-1.0, 1.0, 1.0])
    mirrored = (flip[:, None] * every.anchors.rotations * flip)[..., [0, 2, 1], :, :]
    rotations = torch.cat((mirrored, every.anchors.rotations[..., 3:, :, :]), -3)
    expected = every.anchors.replace(rotations=rotations).pack()
    away = _nearest(drawn[..., :18], expected[..., :18])
    assert float(away.max()) < 1e-3


@pytest.fixture(scope="module")
def weights(folder: Path) -> AnchorWeights:
    return principal_components(settings_of(folder, folder / "run"), corpus_of(folder))


def test_cycles_are_their_components(folder, weights):
    learned = corpus_of(folder)
    rows = learned.all_cycles().anchors.pack()
    mean, log_variance = weights.networks.posterior(rows)
    made = weights.networks.decode(mean, learned.shape)
    assert float((made - rows).abs().max()) < 0.05  # the training cycles, nearly
    assert bool((log_variance <= -10).all())


def test_the_decoder_is_linear_and_does_not_see_the_body(weights):
    a, b = torch.randn(2, weights.networks.latent, generator=torch.Generator().manual_seed(0))
    none, other = torch.zeros(BODY.shape_size), torch.ones(BODY.shape_size)
    one, two, half = (weights.networks.decode(z, none) for z in (a, b, (a + b) / 2))
    assert torch.allclose((one + two) / 2, half, atol=1e-4)
    assert torch.equal(weights.networks.decode(a, other), one)


def test_codes_are_spread_as_training_cycles_are(folder, weights):
    random = torch.Generator().manual_seed(1)
    rows = corpus_of(folder).draw(512, CycleVariation(), random).anchors.pack()
    mean, _ = weights.networks.posterior(rows)
    spread = weights.spread
    whitened = torch.linalg.solve_triangular(spread.root, (mean - spread.mean).mT, upper=False)
    assert float(whitened.square().mean()) < 3  # one for those that it was taken from


def test_the_file_is_a_prior(folder, weights, tmp_path):
    """Weights without hidden layers were refused: all sizes had to be above zero."""
    path = tmp_path / "components.safetensors"
    export_weights(settings_of(folder, path), path)
    prior = AnchorFrames.load(str(path), BODY)
    assert prior.code_size == 24
    walk = a_walk(BODY, seconds=0.9, period=0.9)[None]
    decoded = prior.decode(prior.encode(walk)).motion
    error = BODY.pose(decoded).joints - BODY.pose(walk).joints
    assert float(error[..., :10, :].norm(dim=-1).mean()) < 0.15
