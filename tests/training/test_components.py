"""The linear prior of cycles: principal components, loaded and fitted like the VAE."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from priors.anchor.networks import AnchorWeights, load_weights, save_weights
from priors.anchor.prior import AnchorFrames
from recon.body.model import BodyModel
from recon.formats.motions import MotionFile, save_motion
from tests.training.test_humor import SPLITS
from tests.walking import a_walk
from training.anchor.components import linear
from training.anchor.corpus import CycleCorpus
from training.anchor.train import AnchorTraining
from training.settings import told_settings

BODY = BodyModel.load()


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> CycleCorpus:
    """Cycles of made-up walks."""
    root = tmp_path_factory.mktemp("cycles")
    (root / "splits.toml").write_text(SPLITS)
    for k in range(3):
        period = 0.8 + 0.15 * k
        walk = a_walk(BODY, seconds=3 * period, period=period, speed=0.8 + 0.2 * k, pause=0.2)
        save_motion(root / f"08_0{k}.npz", MotionFile(walk))
    settings = AnchorTraining(root, root / "run", splits=root / "splits.toml")
    return CycleCorpus.load(settings, "train", BODY)


@pytest.fixture(scope="module")
def settings() -> AnchorTraining:
    own = AnchorTraining(corpus=Path(), out=Path(), latent=24, basis=24, width=0)
    return replace(own, basis_from=256, steps=0, surface_steps=0)


@pytest.fixture(scope="module")
def weights(learned: CycleCorpus, settings: AnchorTraining) -> AnchorWeights:
    return linear(settings, learned)


def test_cycles_are_their_components(learned, weights):
    rows = learned.every().anchors.pack()
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


def test_codes_are_spread_as_training_cycles_are(learned, settings, weights):
    random = torch.Generator().manual_seed(1)
    rows = learned.draw(512, settings.variation, random).anchors.pack()
    mean, _ = weights.networks.posterior(rows)
    spread = weights.spread
    whitened = torch.linalg.solve_triangular(spread.root, (mean - spread.mean).mT, upper=False)
    assert float(whitened.square().mean()) < 3  # one for those that it was taken from


def test_the_file_is_loaded_like_the_networks(weights, settings, tmp_path):
    """Weights without hidden layers were refused: all sizes had to be above zero."""
    path = tmp_path / "components.safetensors"
    save_weights(path, weights, told_settings(settings))
    found = load_weights(path)
    code = weights.spread.typical[:1]
    expected = weights.networks.decode(code, torch.zeros(1, BODY.shape_size))
    made = found.networks.decode(code, torch.zeros(1, BODY.shape_size))
    assert torch.allclose(made, expected, atol=0.02)  # directions are kept in half precision
    assert AnchorFrames.load(str(path), BODY).code_size == 24
