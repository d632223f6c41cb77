"""A training run of HuMoR on disk: settings, checkpoints, losses and the weights in the end."""

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import torch

from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.state import canonical, distinct_features, initial_features, rest_pelvis
from priors.humor.steps import error_whitening
from priors.humor.weights import networks_from, read_weights, save_weights
from recon.benchmark.dataset import SPLITS, Licence, Splits
from recon.body.model import BodyModel
from training.humor.corpus import Corpus
from training.humor.scaling import ScaledNetworks
from training.humor.variation import VARIED, Variation
from training.run import CHECKPOINT, Run, read_state, told_settings, trained_state

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class LossWeights:
    """Multipliers of the losses; those of velocities, contacts and KL are the published ones.

    Published are ones for all positions and rotations too. But in m² and (m/s)² an error of 5 mm
    weighs 900 times less than the error of velocity that makes it within a step, and steps were
    then learned to 2 cm only.
    """

    translation: float = 100.0
    joints: float = 100.0
    posed_joints: float = 100.0
    consistency: float = 100.0
    root: float = 30.0
    pose: float = 30.0
    kl: float = 4e-4
    contacts: float = 0.01
    contact_velocity: float = 0.01


@dataclass(frozen=True)
class HumorTraining:
    """Settings of a run."""

    corpus: Path
    """Folder of converted motions (`recon convert --all`)."""
    out: Path
    """Folder of the run: checkpoint.pt, best.pt, losses.csv, losses.png, train.log. A run that was
    interrupted goes on from its checkpoint."""
    data: Licence = "open"
    """`open`: clips whose weights may be shipped; `nc`: the non-commercial ones too."""
    splits: Path = SPLITS
    """Table of the subjects that are held out."""
    width: int = 512
    """Units of the hidden layers; 1024 is published."""
    steps: int = 20_000
    """Steps of the optimiser."""
    windows: int = 200
    """Windows per step (published)."""
    frames: int = 11
    """Frames per window: ten transitions (published)."""
    rate: float = 1e-3
    """Learning rate of AdamW at the start; it falls to a hundredth along a cosine."""
    decay: float = 0.1
    """Weight decay."""
    noise: float = 0.1
    """Standard deviation of what blurs the states that the networks see, in their own ones."""
    start: Path | None = None
    """Weights to begin with, of the same width; then `kl_until`, `own_from` and `own_until` may
    be zero."""
    clip: float = 5.0
    """Longest gradient."""
    average: float = 0.999
    """Share of the averaged weights kept in every step."""
    kl_until: float = 0.25
    """Share of the run over which the KL weight rises from zero (published)."""
    own_from: float = 0.05
    own_until: float = 0.1
    """Shares of the run between which inputs change from true states to own predictions
    (published)."""
    losses: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""
    variation: Variation = VARIED
    """Random variations of the windows."""
    validate_every: int = 500
    """Steps."""
    save_every: float = 180.0
    """Seconds."""
    precision: Literal["float32", "bfloat16"] = "bfloat16"
    """Precision of the networks' products in training; weights and all else are in float32. The
    lower one takes half the time."""
    seed: int = 0
    threads: int = 1
    device: str = "cpu"


HumorRun = Run[ScaledNetworks]
"""A training run of HuMoR."""


def start(
    settings: HumorTraining, corpus: Corpus, kind: type[ScaledNetworks] = ScaledNetworks
) -> HumorRun:
    """A new run, or the one whose checkpoint is in the folder.

    Raises:
        ValueError: when the folder holds a run with other settings.
    """
    random = torch.Generator().manual_seed(settings.seed)
    torch.manual_seed(settings.seed)
    windows = corpus.draw(_SCALED_BY, 2, settings.variation, random)
    scaling = kind.scaling_of(windows.states, rest_pelvis(windows.states[:, 0]))
    core = HumorNetworks(settings.width).to(settings.device)
    networks = kind(core, scaling, settings.noise)
    if settings.start is not None:
        learned = networks_from(read_weights(settings.start)).to(settings.device)
        networks = kind.around(learned, scaling, settings.noise)
    run = Run.of(settings, networks, random, weight_decay=settings.decay, betas=(0.9, 0.99))
    if (state := read_state(settings.out / CHECKPOINT)) is not None:
        run.resume(state)
    return run


def note(run: HumorRun, row: dict[str, float]) -> None:
    """Remember losses, and keep the networks when they are the best so far."""
    run.note(row, _PANELS)
    if run.best:
        run.keep("best.pt", average=run.averaged.plain().state_dict(), step=run.step)


_PANELS = (
    ("train_total", "one_total", "own_total"),
    ("train_kl", "one_kl", "own_kl"),
    ("drift_cm", "own_feet_right"),
)
"""Losses drawn together."""

_SCALED_BY = 20_000
"""Windows from which the scales of inputs and outputs are taken."""


def export_weights(
    settings: HumorTraining,
    path: Path,
    samples: int = 20_000,
    kind: type[HumorNetworks] = HumorNetworks,
) -> Path:
    """Write the best networks of a run, with the mixture of initial states of its corpus.

    Args:
        settings: of the run.
        path: weights to write (.safetensors).
        samples: windows from which the mixture and the decoder's errors are learned.
        kind: what the networks are once they have learned.

    Raises:
        FileNotFoundError: when the run has not validated yet, or there is no corpus.
    """
    found = trained_state(settings.out / "best.pt")
    networks = kind(settings.width)
    networks.load_state_dict(found["average"])

    body = BodyModel.load()
    splits = Splits.load(settings.splits)
    learned = Corpus.load(settings.corpus, splits, "train", settings.data, body)
    random = torch.Generator().manual_seed(settings.seed)
    varied = learned.draw(samples, 2, settings.variation, random).states
    whitening = error_whitening(networks, varied, rest_pelvis(varied[:, 0]))
    # motions begin as people were recorded, and neither in the air nor on one leg more often
    states = learned.draw(samples, 2, Variation(), random).states[:, 0]
    features = initial_features(canonical(states, rest_pelvis(states)))
    initial = Mixture.fit(features, distinct_features(), seed=settings.seed)

    about = told_settings(settings) | {"step": found["step"]}
    save_weights(path, networks, initial, whitening, about)
    _LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path
