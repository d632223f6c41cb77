"""Training of the anchor-frame VAE: first on parameters of cycles, then on the surface."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.anchor.frames import POSE_NUMBERS, Anchors, CycleBasis
from priors.anchor.networks import AnchorNetworks, AnchorWeights, CodeSpread, save_weights
from recon.body.model import BodyModel
from recon.body.sampled import spread_vertices
from training.anchor.corpus import CycleBatch, CycleCorpus, CycleVariation
from training.descent import LEAST, GradNorm, divergence_from_normal, drawn_code
from training.run import BEST, LOG, Run, in_folder, trained_state
from training.settings import TrainingSettings, told_settings

PARAMETERS, SURFACE = ("pose", "translation", "time"), ("surface", "time")
"""Losses of the first and of the second phase that GradNorm weighs."""
POINTS = 200
"""Points of the surface, evenly spread, that the second phase compares."""
_STRIDE = 4
"""Every so many anchors are compared, from a random one on."""
_DRAWN_AT_ONCE = 256
"""Cycles."""
_TYPICAL = 8
"""Codes kept to begin searches with, where there are as many cycles."""
_SPREAD = CycleVariation(exchange=0.0, mix=0.0)
"""Cycles whose codes tell how codes are spread."""


@dataclass(frozen=True)
class AnchorTraining(TrainingSettings):
    """Settings of a run."""

    steps: int = 1000
    """Steps of the first phase, whose losses compare parameters."""
    surface_steps: int = 2500
    """Steps of the second phase, whose losses compare points of the surface."""
    cycles: int = 128
    """Cycles per step."""
    surface_cycles: int = 48
    """Cycles per step of the second phase."""
    surface_rate: float = 3e-4
    """Learning rate of the second phase; 1e-4 is published."""
    validate_every: int = 250
    latent: int = 256
    """Size of z: 64 in the published study, 256 in its completion table."""
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
    variation: CycleVariation = field(default_factory=CycleVariation)
    """Random variations of the cycles."""


@dataclass(frozen=True)
class Reconstructed:
    """Codes and cycles that the networks make of a batch of cycles."""

    mean: Float[Tensor, "cycles latent"]
    log_variance: Float[Tensor, "cycles latent"]
    latent: Float[Tensor, "cycles latent"]
    """The code that was decoded."""
    normalised: Float[Tensor, "cycles 100 124"]


def reconstruct(
    networks: AnchorNetworks,
    rows: Float[Tensor, "cycles 100 124"],
    shape: Float[Tensor, "cycles shape"],
    random: torch.Generator | None,
) -> Reconstructed:
    """Encode, draw a code, decode.

    Args:
        networks: to use.
        rows: chi of aligned cycles.
        shape: of their bodies.
        random: draws the codes; None takes their means.
    """
    mean, log_variance = networks.posterior(rows)
    latent = drawn_code(mean, log_variance, random)
    return Reconstructed(mean, log_variance, latent, networks.normalised(latent, shape))


def parameter_losses(
    networks: AnchorNetworks, found: Reconstructed, rows: Float[Tensor, "cycles 100 124"]
) -> dict[str, Tensor]:
    """Mean squared errors of pose, translation and time, normalised (Marsot et al., eq. 3)."""
    error = (found.normalised - networks.basis.normalised(rows)).square()
    return {
        "pose": error[..., :POSE_NUMBERS].mean(),
        "translation": error[..., POSE_NUMBERS:-1].mean(),
        "time": error[..., -1].mean(),
    }


def surface_error(
    networks: AnchorNetworks,
    found: Reconstructed,
    batch: CycleBatch,
    body: BodyModel,
    vertices: Int[Tensor, " points"],
    anchors: Int[Tensor, " some"],
) -> Float[Tensor, " cycles"]:
    """Mean squared distance of the surface's points, metres² (eq. 4 and 6); the true shape.

    Args:
        networks: that made the cycles.
        found: cycles.
        batch: what they shall be.
        body: that performs both.
        vertices: points of the surface that are compared.
        anchors: numbers of those that are compared.
    """
    made = Anchors.unpack(networks.basis.metric(found.normalised))
    points = [
        body.pose(cycle.map(lambda rows: rows[:, anchors]).motion(batch.shape, 1.0)).points(
            vertices
        )
        for cycle in (made, batch.anchors)
    ]
    return (points[0] - points[1]).square().sum(-1).mean((-1, -2))


class AnchorRun(Run[AnchorTraining, AnchorNetworks]):
    """A training run, with the balance of its losses."""

    panels = (("train_total",), ("vertex_cm", "sampled_vertex_cm"), ("kl_nats",))
    keeps_best = True
    warm_up_steps = 100

    def __init__(
        self, settings: AnchorTraining, learned: CycleCorpus, checked: CycleBatch
    ) -> None:
        self.learned, self.checked = learned, checked
        self.vertices = spread_vertices(learned.body, POINTS)
        self.weights, self.surface_scale = GradNorm(PARAMETERS), 1.0
        super().__init__(settings)

    @property
    def parts(self) -> tuple[tuple[int, float], ...]:
        """The phase of parameters, then that of the surface."""
        settings = self.settings
        return (
            (settings.steps, settings.rate),
            (settings.surface_steps, settings.surface_rate),
        )

    def untrained(self, state: Mapping[str, Any] | None) -> AnchorNetworks:
        """Networks about principal directions of varied cycles, or those of the checkpoint."""
        own, learned = self.settings, self.learned
        basis = CycleBasis(**state["basis"]) if state else basis_of(own, learned, self.random)
        return AnchorNetworks(basis, own.latent, learned.shape.shape[1], own.width, own.dropout)

    def more(self) -> dict[str, Any]:
        """The principal directions, which are not learned, and the balance of the losses."""
        basis = self.networks.basis.tensors()
        return {"basis": basis, "weights": vars(self.weights), "scale": self.surface_scale}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint of this run, with its balance of losses."""
        super().resume(state)
        self.weights, self.surface_scale = GradNorm(**state["weights"]), state["scale"]

    def losses(self) -> dict[str, Tensor]:
        """What GradNorm makes of the losses of the phase, and the divergence of the codes."""
        settings = self.settings
        surface = self.step >= settings.steps
        if self.step == settings.steps:
            self.surface_scale = self.surface_scale_now()
            self.weights = GradNorm(SURFACE)
        count = settings.surface_cycles if surface else settings.cycles
        batch = self.learned.draw(count, settings.variation, self.random)
        rows = batch.anchors.pack()
        found = reconstruct(self.networks.train(), rows, batch.shape, self.random)
        losses = parameter_losses(self.networks, found, rows)
        if surface:
            first = int(torch.randint(_STRIDE, (1,), generator=self.random))
            anchors = torch.arange(first, rows.shape[1], _STRIDE)
            error = surface_error(
                self.networks, found, batch, self.learned.body, self.vertices, anchors
            )
            losses["surface"] = self.surface_scale * error.mean()
        self.weights.update(losses, found.latent)
        kl = divergence_from_normal(found.mean, found.log_variance).mean()
        return {"total": self.weights.total(losses) + settings.kl * kl}

    def surface_scale_now(self) -> float:
        """The weight of a squared metre at which the surface keeps the codes' variance as it is.

        Codes are as blurred as the losses let them be. So the scale is what the blur costs in
        parameters over what it costs on the surface: |D(z + e) - D(z)|² in the one over the other.
        """
        networks, body = self.networks.eval(), self.learned.body
        batch = self.learned.draw(_DRAWN_AT_ONCE, self.settings.variation, self.random)
        rows = batch.anchors.pack()
        with torch.no_grad():
            sharp = reconstruct(networks, rows, batch.shape, None)
            blurred = reconstruct(networks, rows, batch.shape, self.random)
            made = networks.basis.metric(sharp.normalised)
            parameters = self.weights.total(parameter_losses(networks, blurred, made))
            anchors = torch.arange(0, rows.shape[1], _STRIDE)
            own = batch.replace(anchors=Anchors.unpack(made))
            surface = surface_error(networks, blurred, own, body, self.vertices, anchors).mean()
        # times are learned: GradNorm gives them most
        scale = (parameters / surface).item() / LEAST
        LOG.info("step %d: a squared metre of the surface counts %.3f", self.step, scale)
        return scale

    @torch.no_grad()
    def errors(self) -> dict[str, float]:
        """Errors with mean codes and with drawn ones; and of codes."""
        weights = ", ".join(f"{k} {w:.2f}" for k, w in self.weights.weights.items())
        LOG.info("step %d: weights of the losses %s", self.step, weights)
        networks, checked, body = self.averaged, self.checked, self.learned.body
        random = torch.Generator().manual_seed(0)
        rows = checked.anchors.pack()
        anchors = torch.arange(0, rows.shape[1], _STRIDE)
        row: dict[str, float] = {}
        for name, generator in (("", None), ("sampled_", random)):
            found = reconstruct(networks, rows, checked.shape, generator)
            error = surface_error(networks, found, checked, body, self.vertices, anchors)
            row[f"{name}vertex_cm"] = 100 * error.sqrt().mean().item()
            losses = parameter_losses(networks, found, rows)
            row |= {f"{name}{key}": value.item() for key, value in losses.items()}
        kl = divergence_from_normal(found.mean, found.log_variance)
        row["kl_nats"] = kl.sum(-1).mean().item()
        row["active"] = float((found.mean.var(0) > 0.01).sum())
        return row | {"score": row["vertex_cm"] + row["sampled_vertex_cm"]}


def train(settings: AnchorTraining) -> Path:
    """Train, or go on training; the checkpoint's path.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when there is no cycle to learn from, or the folder holds another run.
    """
    with in_folder(settings):
        body = BodyModel.load()
        learned, held_out = (
            CycleCorpus.load(settings, part, body) for part in ("train", "validation")
        )
        return AnchorRun(settings, learned, held_out.every()).go()


def export_weights(settings: AnchorTraining, path: Path) -> Path:
    """Write the best networks of a run, with the spread of the codes of its corpus.

    Raises:
        FileNotFoundError: when the run has not validated yet, or there is no corpus.
    """
    found = trained_state(settings.out / BEST)
    learned = CycleCorpus.load(settings, "train", BodyModel.load())
    basis, shape = CycleBasis(**found["basis"]), learned.shape.shape[1]
    model = AnchorNetworks(basis, settings.latent, shape, settings.width)
    model.load_state_dict(found["averaged"])
    model.eval().requires_grad_(False)
    weights = AnchorWeights(model, spread_of(settings, model, learned))
    save_weights(path, weights, told_settings(settings) | {"step": found["step"]})
    LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path


def basis_of(
    settings: AnchorTraining, learned: CycleCorpus, random: torch.Generator
) -> CycleBasis:
    """Principal directions of varied training cycles."""
    rows = [
        learned.draw(_DRAWN_AT_ONCE, settings.variation, random).anchors.pack()
        for _ in range(-(-settings.basis_from // _DRAWN_AT_ONCE))
    ]
    return CycleBasis.fit(torch.cat(rows), settings.basis)


def spread_of(settings: AnchorTraining, model: AnchorNetworks, learned: CycleCorpus) -> CodeSpread:
    """How codes of varied training cycles are spread, and which are typical."""
    random = torch.Generator().manual_seed(settings.seed)
    drawn = learned.draw(settings.basis_from // 2, _SPREAD, random)
    mean, log_variance = model.posterior(drawn.anchors.pack())
    typical = min(_TYPICAL, len(learned.shape))
    return CodeSpread.fit(mean, log_variance.exp(), typical, settings.seed)
