"""A training run of labels on disk: settings, checkpoint, losses, weights."""

from dataclasses import dataclass, field
from pathlib import Path

import torch

from priors.checkpoints import save_checkpoint
from priors.labels.networks import LabelNetwork
from priors.labels.training.clouds import CloudVariation
from priors.training.muon import Muon
from priors.training.run import CHECKPOINT, Run, read_state, trained_state
from priors.training.run_settings import told_settings


@dataclass(frozen=True)
class LabelTraining:
    """Settings of a run."""

    corpus: Path
    """Folder of labelled clouds of the training people, as `recon.simulation.labelled.shards`
    writes them."""
    checked: Path
    """Folder of labelled clouds of the validation people."""
    out: Path
    """Folder of the run: checkpoint.pt, losses.csv, losses.png, train.log. A run that was
    interrupted goes on from its checkpoint."""
    warm: Path | None = None
    """`checkpoint.pt` of another run to begin with."""
    steps: int = 12000
    """Steps of the optimiser."""
    windows: int = 16
    """Windows per step."""
    rate: float = 1.5e-3
    """Learning rate of Muon and AdamW; it falls to a hundredth along a cosine."""
    decay: float = 0.01
    """Weight decay."""
    clip: float = 1.0
    """Longest gradient."""
    average: float = 0.998
    """Share of the averaged weights kept in every step."""
    variation: CloudVariation = field(default_factory=CloudVariation)
    """Random variations of the windows."""
    validate_every: int = 500
    """Steps."""
    save_every: float = 120.0
    """Seconds."""
    seed: int = 0
    threads: int = 1


LabelRun = Run[LabelNetwork]
"""A training run of labels."""


def start(settings: LabelTraining) -> LabelRun:
    """A new run, or the one whose checkpoint is in the folder.

    Raises:
        FileNotFoundError: when there is no run to begin with.
        ValueError: when the folder holds a run with other settings or clouds.
    """
    random = torch.Generator().manual_seed(settings.seed)
    torch.manual_seed(settings.seed)
    networks = LabelNetwork()
    if settings.warm is not None:
        networks.load_state_dict(trained_state(settings.warm)["averaged"])
    run = Run.of(settings, networks, random)
    run.optimiser = _optimiser(networks, settings)
    state = read_state(settings.out / CHECKPOINT)
    if state is not None:
        run.resume(state)
    return run


def _optimiser(networks: LabelNetwork, settings: LabelTraining) -> Muon:
    """Muon for matrices between hidden numbers, AdamW for the first and last layers and the rest.

    It needs a third of the steps of AdamW alone to learn one batch.
    """
    inner = ("layers.", "moments.", "joined.", "learned.")
    matrices, others = [], []
    for name, parameter in networks.named_parameters():
        hidden = name.startswith(inner) and parameter.ndim == 2
        (matrices if hidden else others).append(parameter)
    return Muon(matrices, others, settings.rate, settings.decay)


def note(run: LabelRun, row: dict[str, float]) -> None:
    """Remember losses."""
    run.note(row, _PANELS)


def export_weights(settings: LabelTraining, path: Path) -> None:
    """Write the averaged network of a run as a weights file, in half precision.

    Raises:
        FileNotFoundError: when the run has no checkpoint yet.
    """
    state = trained_state(settings.out / CHECKPOINT)
    tensors = {name: tensor.half() for name, tensor in state["averaged"].items()}
    about = told_settings(settings) | {"step": state["step"]}
    about.pop("checked", None)
    save_checkpoint(path, "labels", tensors, about)


_PANELS = (
    ("train_total",),
    ("train_sides", "train_across"),
    ("wrong", "half_wrong", "tilted_wrong"),
    ("place_cm", "place_median_cm"),
)
"""Losses drawn together."""
