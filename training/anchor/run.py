"""A training run of the anchor-frame VAE on disk: settings, checkpoints, losses, weights."""

import dataclasses
import logging
from dataclasses import dataclass, field
from pathlib import Path

import torch

from priors.anchor.frames import Alignment, CycleBasis
from priors.anchor.networks import AnchorNetworks, AnchorWeights, CodeSpread, save_weights
from recon.benchmark.dataset import SPLITS, Licence, Splits
from recon.body.model import BodyModel
from training.anchor.corpus import CycleCorpus, CycleVariation
from training.descent import GradNorm
from training.run import CHECKPOINT, Run, read_state, told_settings, trained_state


@dataclass(frozen=True)
class AnchorTraining:
    """Settings of a run."""

    corpus: Path
    """Folder of converted motions (`recon convert --all`)."""
    out: Path
    """Folder of the run: checkpoint.pt, best.pt, parameters.pt, losses.csv, losses.png, train.log.
    A run that was interrupted goes on from its checkpoint."""
    data: Licence = "open"
    """`open`: clips whose weights may be shipped; `nc`: the non-commercial ones too."""
    splits: Path = SPLITS
    """Table of the subjects that are held out."""
    latent: int = 256
    """Size of z: 64 in the published study, 256 in its completion table."""
    alignment: Alignment = Alignment.YAW
    """What aligning the first anchor removes; the published choice is `FULL`."""
    kl: float = 0.001
    """Weight of the mean divergence per dimension; 0.01 is published, for layers and reductions
    that are not."""
    basis: int = 512
    """Principal directions that the networks see and make cycles of."""
    basis_from: int = 8192
    """Varied cycles from which the directions are taken."""
    width: int = 512
    """Units of the hidden layers."""
    dropout: float = 0.1
    """Share of hidden units left out."""
    steps: int = 1000
    """Steps of the first phase, whose losses compare parameters."""
    surface_steps: int = 2500
    """Steps of the second phase, whose losses compare points of the surface."""
    cycles: int = 128
    """Cycles per step."""
    surface_cycles: int = 48
    """Cycles per step of the second phase."""
    rate: float = 1e-3
    """Learning rate of AdamW, published; it falls to a hundredth along a cosine."""
    surface_rate: float = 3e-4
    """Learning rate of the second phase; 1e-4 is published."""
    decay: float = 0.01
    """Weight decay."""
    clip: float = 1.0
    """Longest gradient."""
    average: float = 0.995
    """Share of the averaged weights kept in every step."""
    variation: CycleVariation = field(default_factory=CycleVariation)
    """Random variations of the cycles."""
    validate_every: int = 250
    """Steps."""
    save_every: float = 120.0
    """Seconds."""
    seed: int = 0
    threads: int = 1


@dataclass
class AnchorRun(Run[AnchorNetworks]):
    """A training run, with the balance of its losses."""

    weights: GradNorm = field(default_factory=lambda: GradNorm(PARAMETERS))
    surface_scale: float = 1.0
    """Weight of a squared metre of the surface in the second phase."""

    @classmethod
    def start(cls, settings: AnchorTraining, corpus: CycleCorpus) -> "AnchorRun":
        """A new run, or the one whose checkpoint is in the folder.

        Raises:
            ValueError: when the folder holds a run with other settings.
        """
        random = torch.Generator().manual_seed(settings.seed)
        torch.manual_seed(settings.seed)
        state = read_state(settings.out / CHECKPOINT)
        basis = (
            basis_of(settings, corpus, random) if state is None else CycleBasis(**state["basis"])
        )
        networks = AnchorNetworks(
            basis, settings.latent, corpus.shape.shape[1], settings.width, settings.dropout
        )
        run = cls.of(settings, networks, random, weight_decay=settings.decay)
        assert isinstance(run, cls)
        if state is not None:
            run.resume(state)
            names = tuple(state["weights"]["names"])
            run.weights = GradNorm(**(state["weights"] | {"names": names}))
            run.surface_scale = state["surface_scale"]
        return run

    def begin_surface(self, scale: float) -> None:
        """Change from the losses of parameters to those of the surface.

        The networks of the first phase are kept as `parameters.pt`, for comparison.

        Args:
            scale: weight of a squared metre at which the losses pull on codes as before.
        """
        self.keep_networks("parameters.pt")
        self.surface_scale = scale
        self.weights = GradNorm(SURFACE)

    def note_row(self, row: dict[str, float]) -> None:
        """Remember losses, and keep the networks when they are the best so far."""
        self.note(row, _PANELS)
        if self.best:
            self.keep_networks("best.pt")

    def keep_networks(self, name: str) -> None:
        """Write the averaged networks as they are."""
        self.keep(
            name,
            networks=self.averaged.state_dict(),
            basis=self.averaged.basis.tensors(),
            step=self.step,
        )

    def save_all(self) -> None:
        """Write the checkpoint in one step."""
        self.save(
            basis=self.networks.basis.tensors(),
            weights=dataclasses.asdict(self.weights) | {"names": list(self.weights.names)},
            surface_scale=self.surface_scale,
        )


def basis_of(settings: AnchorTraining, corpus: CycleCorpus, random: torch.Generator) -> CycleBasis:
    """Principal directions of varied training cycles."""
    rows = [
        corpus.draw(256, settings.variation, settings.alignment, random).anchors.pack()
        for _ in range(-(-settings.basis_from // 256))
    ]
    return CycleBasis.fit(torch.cat(rows), settings.basis)


PARAMETERS = ("pose", "translation", "time")
"""Losses of the first phase that GradNorm weighs."""
SURFACE = ("surface", "time")
"""Losses of the second phase that GradNorm weighs."""
_PANELS = (
    ("train_total",),
    ("vertex_cm", "sampled_vertex_cm"),
    ("kl_nats",),
)
"""Losses drawn together."""


_LOG = logging.getLogger("training.anchor.train")

TYPICAL = 8
"""Codes kept to begin searches with, where there are as many cycles."""
_SPREAD = CycleVariation(exchange=0.0, mix=0.0)
"""Cycles whose codes tell how codes are spread."""


def export_weights(settings: AnchorTraining, path: Path, networks: str = "best.pt") -> Path:
    """Write the best networks of a run, with the spread of the codes of its corpus.

    Args:
        settings: of the run.
        path: weights to write (.safetensors).
        networks: file in the run's folder; `parameters.pt` are those after the first phase.

    Raises:
        FileNotFoundError: when the run has not validated yet, or there is no corpus.
    """
    body, splits = BodyModel.load(), Splits.load(settings.splits)
    learned = CycleCorpus.load(settings.corpus, splits, "train", settings.data, body)
    return export_learned(settings, path, learned, networks)


def export_learned(
    settings: AnchorTraining, path: Path, learned: CycleCorpus, networks: str = "best.pt"
) -> Path:
    """Write weights as `export_weights` does, from cycles that are loaded already."""
    found = trained_state(settings.out / networks)
    basis = CycleBasis(**found["basis"])
    shape = learned.shape.shape[1]
    model = AnchorNetworks(basis, settings.latent, shape, settings.width)
    model.load_state_dict(found["networks"])
    model.eval().requires_grad_(False)
    spread = spread_of(settings, model, learned)
    weights = AnchorWeights(model, spread, settings.alignment)
    save_weights(path, weights, told_settings(settings) | {"step": found["step"]})
    _LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path


def spread_of(settings: AnchorTraining, model: AnchorNetworks, learned: CycleCorpus) -> CodeSpread:
    """How codes of varied training cycles are spread, and which are typical."""
    random = torch.Generator().manual_seed(settings.seed)
    drawn = learned.draw(settings.basis_from // 2, _SPREAD, settings.alignment, random)
    mean, log_variance = model.posterior(drawn.anchors.pack())
    typical = min(TYPICAL, len(learned.shape))
    return CodeSpread.fit(mean, log_variance.exp(), typical, settings.seed)
