"""A training run of the anchor-frame VAE on disk: settings, checkpoints, losses, weights."""

import dataclasses
import logging
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from priors.anchor.basis import CycleBasis
from priors.anchor.frames import Alignment
from priors.anchor.networks import AnchorNetworks
from priors.anchor.training.corpus import CycleCorpus, CycleVariation
from priors.training.curves import write_losses
from priors.training.dataset import SPLITS, Licence
from priors.training.gradnorm import GradNorm
from priors.training.run_settings import identity, plain, same_run
from recon.formats.files.opening import replacing

_LOG = logging.getLogger("priors.anchor.training.train")


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
    """Who is held out."""
    latent: int = 256
    """Size of z: 64 in the published study, 256 in its completion table."""
    alignment: Alignment = Alignment.YAW
    """What the first anchor takes away; `FULL` is published."""
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
    """Of the first phase, on parameters."""
    surface_steps: int = 2500
    """Of the second phase, on the surface."""
    cycles: int = 128
    """Cycles per step."""
    surface_cycles: int = 48
    """Cycles per step of the second phase."""
    rate: float = 1e-3
    """Learning rate of AdamW, published; it falls to a hundredth along a cosine."""
    surface_rate: float = 3e-4
    """Of the second phase; 1e-4 is published."""
    decay: float = 0.02
    """Weight decay."""
    clip: float = 1.0
    """Longest gradient."""
    average: float = 0.995
    """Share of the averaged weights kept in every step."""
    variation: CycleVariation = field(default_factory=CycleVariation)
    """How cycles are varied."""
    validate_every: int = 250
    """Steps."""
    save_every: float = 120.0
    """Seconds."""
    seed: int = 0
    threads: int = 1


@dataclass
class AnchorRun:
    """All that a run needs to go on exactly where it was."""

    settings: AnchorTraining
    networks: AnchorNetworks
    averaged: AnchorNetworks
    optimiser: torch.optim.Optimizer
    random: torch.Generator
    identity: dict[str, Any]
    """What the run learns and from which contents; a checkpoint of another is refused."""
    weights: GradNorm
    step: int = 0
    surface_scale: float = 1.0
    """What a squared metre of the surface counts in the second phase."""
    rows: list[dict[str, float]] = field(default_factory=list)

    @classmethod
    def start(cls, settings: AnchorTraining, corpus: CycleCorpus) -> "AnchorRun":
        """A new run, or the one whose checkpoint is in the folder.

        Raises:
            ValueError: when the folder holds a run with other settings.
        """
        random = torch.Generator().manual_seed(settings.seed)
        torch.manual_seed(settings.seed)
        drawn = [
            corpus.draw(256, settings.variation, settings.alignment, random).anchors.pack()
            for _ in range(-(-settings.basis_from // 256))
        ]
        basis = CycleBasis.fit(torch.cat(drawn), settings.basis)
        networks = AnchorNetworks(
            basis, settings.latent, corpus.shape.shape[1], settings.width, settings.dropout
        )
        averaged = deepcopy(networks).requires_grad_(False).eval()
        optimiser = torch.optim.AdamW(
            networks.parameters(), lr=settings.rate, weight_decay=settings.decay, fused=True
        )
        own = identity(settings)
        run = cls(settings, networks, averaged, optimiser, random, own, GradNorm(PARAMETERS))
        path = settings.out / "checkpoint.pt"
        if path.is_file():
            run._resume(path)
        return run

    def begin_surface(self, scale: float) -> None:
        """From parameters to the surface: other losses, a scale that keeps their pull on codes.

        The networks of the first phase are kept as `parameters.pt`, for comparison.
        """
        self.keep("parameters.pt")
        self.surface_scale = scale
        self.weights = GradNorm(SURFACE)

    def _resume(self, path: Path) -> None:
        state: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
        same_run(path, self.identity, state.get("identity"))
        basis = CycleBasis(**state["basis"])
        self.networks.basis = self.averaged.basis = basis
        self.networks.load_state_dict(state["networks"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.random.set_state(state["random"])
        torch.set_rng_state(state["dropout"])
        self.weights = GradNorm(**(state["weights"] | {"names": tuple(state["weights"]["names"])}))
        self.step, self.rows = state["step"], state["rows"]
        self.surface_scale = state["surface_scale"]

    def note(self, row: dict[str, float]) -> None:
        """Remember losses, write them as a table and as curves; keep the best networks."""
        self.rows.append({"step": float(self.step), **row})
        if row["score"] == min(r["score"] for r in self.rows):
            self.keep("best.pt")
        write_losses(self.settings.out, self.rows, _PANELS)

    def keep(self, name: str) -> None:
        """Write the averaged networks as they are."""
        found = {
            "networks": self.averaged.state_dict(),
            "basis": self.averaged.basis.tensors(),
            "step": self.step,
        }
        with replacing(self.settings.out / name) as beside:
            torch.save(found, beside)

    def save(self) -> None:
        """Write the checkpoint in one step."""
        state = {
            "settings": plain(self.settings),
            "identity": self.identity,
            "basis": self.networks.basis.tensors(),
            "networks": self.networks.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": self.random.get_state(),
            "dropout": torch.get_rng_state(),
            "weights": dataclasses.asdict(self.weights) | {"names": list(self.weights.names)},
            "step": self.step,
            "surface_scale": self.surface_scale,
            "rows": self.rows,
        }
        with replacing(self.settings.out / "checkpoint.pt") as beside:
            torch.save(state, beside)


PARAMETERS = ("pose", "translation", "time")
"""Losses of the first phase that GradNorm weighs."""
SURFACE = ("surface", "time")
"""And of the second."""
_PANELS = (
    ("train_total",),
    ("vertex_cm", "sampled_vertex_cm"),
    ("kl_nats",),
)
"""Losses drawn together."""
