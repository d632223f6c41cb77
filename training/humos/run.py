"""A training run of the HUMOS prior on disk: settings, checkpoint, losses."""

from dataclasses import dataclass, field
from pathlib import Path

import torch

from priors.humos.frames import LappedBasis
from priors.humos.networks import WindowNetworks
from recon.benchmark.dataset import SPLITS, Licence
from training.humos.corpus import BodyCorpus, BodyVariation
from training.run import CHECKPOINT, Run, read_state, trained_state


@dataclass(frozen=True)
class HumosTraining:
    """Settings of a run."""

    corpus: Path
    """Folder of converted motions (`recon convert --all`)."""
    out: Path
    """Folder of the run: checkpoint.pt, warm.pt, losses.csv, losses.png, train.log. A run that was
    interrupted goes on from its checkpoint."""
    data: Licence = "open"
    """`open`: clips whose weights may be shipped; `nc`: the non-commercial ones too."""
    splits: Path = SPLITS
    """Table of the subjects that are held out."""
    latent: int = 96
    """Numbers of the code of a window; 320 are published for a whole clip."""
    basis: int = 256
    """Principal directions of windows that the networks see and make motions of."""
    basis_from: int = 3072
    """Varied stretches from which the directions are taken."""
    width: int = 256
    """Numbers per window inside the transformers."""
    layers: int = 3
    """Layers of each transformer."""
    dropout: float = 0.05
    """Share of hidden numbers left out."""
    kl: float = 0.02
    """Weight of the mean divergence per number of a code."""
    same_code: float = 0.1
    """Weight of the squared distance of the codes of a motion and of its copy (L_E)."""
    physics: float = 1.0
    """Weight of penetration, float and slide of the motion on another body; 0: none."""
    balance: float = 1.0
    """Weight of its dynamic stability; 0: none."""
    warm_steps: int = 1500
    """Steps of the auto-encoder before there is another body."""
    steps: int = 1200
    """Steps from one body to another and back."""
    warm: Path | None = None
    """`warm.pt` of another run to begin the second part with; then there is no first."""
    clips: int = 16
    """Windows per step."""
    frames: int = 128
    """Frames of a window; the networks know distances in time only, and work on any length."""
    physics_frames: int = 40
    """Consecutive frames of each window on which the physics losses are computed."""
    rate: float = 1e-3
    """Learning rate of AdamW; it falls to a hundredth along a cosine."""
    cycle_rate: float = 3e-4
    """Learning rate of the second part."""
    decay: float = 0.01
    """Weight decay."""
    clip: float = 1.0
    """Longest gradient."""
    average: float = 0.995
    """Share of the averaged weights kept in every step."""
    variation: BodyVariation = field(default_factory=BodyVariation)
    """Random variations of the windows."""
    speeds: tuple[float, ...] = (0.87, 1.0, 1.15)
    """Every clip is learned at each."""
    validate_every: int = 100
    """Steps."""
    save_every: float = 120.0
    """Seconds."""
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        """Refuse what has no meaning, before a corpus is read."""
        if self.latent > self.basis:
            raise ValueError(
                f"codes of {self.latent} numbers begin as as many of {self.basis} principal "
                "directions: give a smaller latent, or a larger basis"
            )
        for name in ("latent", "basis", "width", "layers", "clips", "frames", "physics_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")

    @property
    def all_steps(self) -> int:
        """Steps of both parts."""
        return self.first_steps + self.steps

    @property
    def first_steps(self) -> int:
        """Steps of the first part: none where it was done before."""
        return 0 if self.warm is not None else self.warm_steps


HumosRun = Run[WindowNetworks]
"""A training run of the HUMOS prior."""


def start(settings: HumosTraining, corpus: BodyCorpus) -> HumosRun:
    """A new run, or the one whose checkpoint is in the folder.

    Raises:
        FileNotFoundError: when there is no run to begin with.
        ValueError: when the folder holds a run with other settings.
    """
    random = torch.Generator().manual_seed(settings.seed)
    torch.manual_seed(settings.seed)
    state = read_state(settings.out / CHECKPOINT)
    warm = None if settings.warm is None else trained_state(settings.warm)
    begun = state or warm
    basis = _basis(settings, corpus, random) if begun is None else LappedBasis(**begun["basis"])
    networks = untrained(settings, basis, corpus.shape.shape[1])
    if warm is not None:
        networks.load_state_dict(warm["networks"])
    run = Run.of(settings, networks, random, weight_decay=settings.decay)
    if state is not None:
        run.resume(state)
    return run


def note(run: HumosRun, row: dict[str, float]) -> None:
    """Remember losses."""
    run.note(row, _PANELS)


def keep_warm(run: HumosRun) -> None:
    """Write the averaged networks of the first part as `warm.pt`."""
    run.keep(
        "warm.pt",
        networks=run.averaged.state_dict(),
        basis=run.averaged.basis.tensors(),
        step=run.step,
    )


def save(run: HumosRun) -> None:
    """Write the checkpoint in one step."""
    run.save(basis=run.networks.basis.tensors())


def untrained(settings: HumosTraining, basis: LappedBasis, shape: int) -> WindowNetworks:
    """Networks of these sizes."""
    return WindowNetworks(
        basis, settings.latent, shape, settings.width, settings.layers, settings.dropout
    )


def _basis(settings: HumosTraining, corpus: BodyCorpus, random: torch.Generator) -> LappedBasis:
    rows = [
        corpus.draw(256, 64, settings.variation, random).frames.pack()
        for _ in range(-(-settings.basis_from // 256))
    ]
    return LappedBasis.fit(torch.cat(rows), settings.basis)


_PANELS = (
    ("train_total",),
    ("joint_cm", "cycle_joint_cm", "clearance_cm"),
    ("slide", "ground", "balance", "bounce"),
)
"""Losses drawn together."""
