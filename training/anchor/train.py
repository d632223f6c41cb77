"""Losses of the anchor-frame VAE: parameters, surface, and how far codes are from a normal."""

import logging
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.anchor.frames import POSE_NUMBERS, Anchors
from priors.anchor.networks import AnchorNetworks
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.body.sampled import spread_vertices
from training.anchor.corpus import CycleBatch, CycleCorpus
from training.anchor.run import AnchorRun, AnchorTraining
from training.descent import LEAST, cosine, descend
from training.run import logged_to, run_steps


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
    latent = mean
    if random is not None:
        noise = torch.randn(mean.shape, generator=random).to(mean)
        latent = mean + noise * (0.5 * log_variance).exp()
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
    """Mean squared distance of the surface's points, metres² (eq. 4 and 6); the true shape."""
    made = Anchors.unpack(networks.basis.metric(found.normalised))
    points = [
        body.pose(some_of(cycle, anchors).motion(batch.shape, 1.0)).points(vertices)
        for cycle in (made, batch.anchors)
    ]
    return (points[0] - points[1]).square().sum(-1).mean((-1, -2))


def some_of(cycles: Anchors, anchors: Int[Tensor, " some"]) -> Anchors:
    """Some anchors of every cycle."""
    return Anchors(
        cycles.rotations[:, anchors], cycles.translation[:, anchors], cycles.times[:, anchors]
    )


def divergence(found: Reconstructed) -> Float[Tensor, "cycles latent"]:
    """KL(q(z | cycle) || N(0, I)) per dimension, nats."""
    return 0.5 * (found.mean.square() + found.log_variance.exp() - 1 - found.log_variance)


_LOG = logging.getLogger("training.anchor.train")

POINTS = 200
"""Points of the surface, evenly spread, that the second phase compares."""
_STRIDE = 4
"""Every so many anchors are compared, from a random one on."""
_WARM = 100
"""Steps over which the learning rate rises."""


def train(settings: AnchorTraining) -> Path:
    """Train, or go on training; the checkpoint's path.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when there is no cycle to learn from, or the folder holds another run.
    """
    settings.out.mkdir(parents=True, exist_ok=True)
    with logged_to(settings.out / "train.log", "a"):
        body, splits = BodyModel.load(), Splits.load(settings.splits)
        learned, held_out = (
            CycleCorpus.load(settings.corpus, splits, part, settings.data, body)
            for part in ("train", "validation")
        )
        return train_on(settings, learned, held_out.every(settings.alignment))


def train_on(settings: AnchorTraining, learned: CycleCorpus, checked: CycleBatch) -> Path:
    """Train on cycles that are loaded already; the checkpoint's path."""
    torch.set_num_threads(settings.threads)
    run = AnchorRun.start(settings, learned)
    _LOG.info("settings: %s", settings)
    _LOG.info("from step %d; %d validation cycles", run.step, len(checked.shape))
    vertices = spread_vertices(learned.body, POINTS)

    def one_step() -> dict[str, float]:
        if run.step == settings.steps:
            run.begin_surface(surface_scale(run, learned, vertices))
        return {"total": training_step(run, learned, vertices)}

    def check() -> dict[str, float]:
        weights = ", ".join(f"{k} {w:.2f}" for k, w in run.weights.weights.items())
        _LOG.info("step %d: weights of the losses %s", run.step, weights)
        return validate(run, checked, learned.body, vertices)

    steps = settings.steps + settings.surface_steps
    return run_steps(run, steps, one_step, check, run.note_row, run.save_all, _LOG)


def training_step(run: AnchorRun, learned: CycleCorpus, vertices: torch.Tensor) -> float:
    """One step of the optimiser; its loss."""
    settings = run.settings
    surface = run.step >= settings.steps
    count = settings.surface_cycles if surface else settings.cycles
    batch = learned.draw(count, settings.variation, settings.alignment, run.random)
    rows = batch.anchors.pack()
    found = reconstruct(run.networks.train(), rows, batch.shape, run.random)
    losses = parameter_losses(run.networks, found, rows)
    if surface:
        first = int(torch.randint(_STRIDE, (1,), generator=run.random))
        anchors = torch.arange(first, rows.shape[1], _STRIDE)
        error = surface_error(run.networks, found, batch, learned.body, vertices, anchors)
        losses["surface"] = run.surface_scale * error.mean()
    run.weights.update(losses, found.latent)
    total = run.weights.total(losses) + settings.kl * divergence(found).mean()
    descend(run, total, _rate(settings, run.step), settings.clip, settings.average)
    return total.item()


def surface_scale(run: AnchorRun, learned: CycleCorpus, vertices: torch.Tensor) -> float:
    """The weight of a squared metre at which the second phase keeps the codes' variance as it is.

    Codes are as blurred as the losses let them be. So the scale is what the blur costs in
    parameters over what it costs on the surface: |D(z + e) - D(z)|² in the one over the other.
    """
    settings, networks = run.settings, run.networks.eval()
    batch = learned.draw(256, settings.variation, settings.alignment, run.random)
    rows = batch.anchors.pack()
    with torch.no_grad():
        sharp = reconstruct(networks, rows, batch.shape, None)
        blurred = reconstruct(networks, rows, batch.shape, run.random)
        made = networks.basis.metric(sharp.normalised)
        parameters = run.weights.total(parameter_losses(networks, blurred, made))
        anchors = torch.arange(0, rows.shape[1], _STRIDE)
        own = batch.replace(anchors=Anchors.unpack(made))
        surface = surface_error(networks, blurred, own, learned.body, vertices, anchors).mean()
    scale = (parameters / surface).item() / LEAST  # times are learned: GradNorm gives them most
    _LOG.info("step %d: a squared metre of the surface counts %.3f", run.step, scale)
    return scale


def validate(
    run: AnchorRun, checked: CycleBatch, body: BodyModel, vertices: torch.Tensor
) -> dict[str, float]:
    """Errors on cycles of other people: with mean codes and with drawn ones; and of codes."""
    random = torch.Generator().manual_seed(0)
    rows = checked.anchors.pack()
    anchors = torch.arange(0, rows.shape[1], _STRIDE)
    row: dict[str, float] = {}
    with torch.no_grad():
        for name, generator in (("", None), ("sampled_", random)):
            found = reconstruct(run.averaged, rows, checked.shape, generator)
            error = surface_error(run.averaged, found, checked, body, vertices, anchors)
            row[f"{name}vertex_cm"] = 100 * error.sqrt().mean().item()
            losses = parameter_losses(run.averaged, found, rows)
            row |= {f"{name}{key}": value.item() for key, value in losses.items()}
        row["kl_nats"] = divergence(found).sum(-1).mean().item()
        row["active"] = float((found.mean.var(0) > 0.01).sum())
    row["score"] = row["vertex_cm"] + row["sampled_vertex_cm"]
    return row


def _rate(settings: AnchorTraining, step: int) -> float:
    """Each phase warms up and falls along a cosine."""
    first = step < settings.steps
    most = settings.rate if first else settings.surface_rate
    here, length = (
        (step, settings.steps) if first else (step - settings.steps, settings.surface_steps)
    )
    return most * cosine(here / length) * min(1.0, (here + 1) / _WARM)
