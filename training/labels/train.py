"""Losses and errors of labels whose truth is known."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from priors.checkpoints import save_checkpoint
from priors.labels.looking import believed, standard
from priors.labels.networks import STEPS, LabelNetwork, RawLabels, SeenClouds, from_right_to_left
from priors.labels.regions import MIRRORED_REGIONS, mirrored_places
from training.descent import Muon, cosine, descend
from training.labels.clouds import CloudCorpus, CloudVariation, LabelledClouds, half_hidden, varied
from training.run import (
    CHECKPOINT,
    Run,
    logged_to,
    read_state,
    run_steps,
    told_settings,
    trained_state,
)

_PLACES, _ON_BODY, _SIDES, _ACROSS = 0.3, 0.5, 0.3, 0.5
"""Weights of the losses of places, on or off the body, sides, and the direction from right to
left, beside that of regions."""


def seen_of(clouds: LabelledClouds) -> SeenClouds:
    """Windows as the network takes them, all moments in one row."""
    moments = clouds.points.shape[1]
    return standard(
        clouds.points.flatten(0, 1),
        clouds.present.flatten(0, 1),
        clouds.eyes.repeat_interleave(moments, 0),
        clouds.has_eye.repeat_interleave(moments),
        clouds.level.repeat_interleave(moments),
    )


def said_of(network: LabelNetwork, seen: SeenClouds, moments: int) -> RawLabels:
    """What a network says of windows of so many moments each."""
    windows = len(seen.points) // moments
    asked = torch.arange(moments)[:, None] + torch.arange(STEPS) - STEPS // 2
    inside = (asked >= 0) & (asked < moments)
    index = asked.clamp(0, moments - 1)
    neighbours = (moments * torch.arange(windows)[:, None, None] + index).flatten(0, 1)
    known = inside.repeat(windows, 1) & seen.present.any(-1)[neighbours]
    known[:, STEPS // 2] = True
    return network(seen, neighbours, known)


def losses(raw: RawLabels, seen: SeenClouds, clouds: LabelledClouds) -> dict[str, Tensor]:
    """Cross entropies, and the negative log-density of places; `total` is their weighted sum.

    Errors of the coordinates of a place are Laplace-distributed with standard deviation s:
    -log p = |e| √2 / s + log(√2 s). The points of a moment may have left and right exchanged, all
    of them or none, whichever costs less; which one it was, is learned apart. Otherwise a network
    that cannot tell yet calls some points of an arm left and others right. It is learned from the
    direction from right to left, whose truth does not depend on what the network says of points:
    the square of its error, of the moment and as the mean over centres.
    """
    region, present = clouds.regions.flatten(0, 1), clouds.present.flatten(0, 1)
    place, on_body = clouds.places.flatten(0, 1), region >= 0
    mirrored = torch.tensor([*MIRRORED_REGIONS, -1])[region]
    costs = [
        _costs(raw, regions, places, on_body)
        for regions, places in ((region, place), (mirrored, mirrored_places(place)))
    ]
    sums = [(found + _PLACES * away).sum(-1).detach() for found, away in costs]
    as_said = sums[0] <= sums[1]
    shown = on_body.any(-1)
    sides = binary_cross_entropy_with_logits(raw.sides[shown], as_said[shown].float())
    count = on_body.sum().clamp(min=1)
    found, away = (
        torch.where(as_said[:, None], one, other).sum() / count
        for one, other in zip(*costs, strict=True)
    )
    stray = binary_cross_entropy_with_logits(raw.on_body[present], on_body[present].float())
    truth = from_right_to_left(seen.points, place, on_body.to(place))[shown]
    missed = (raw.across[shown] - truth[:, None]).square().sum(-1)
    across = missed[:, 0].mean() + missed[:, 1:].mean()
    total = found + _ON_BODY * stray + _PLACES * away + _SIDES * sides + _ACROSS * across
    return {
        "total": total, "regions": found, "on_body": stray, "places": away, "sides": sides,
        "across": across,
    }  # fmt: skip


def _costs(
    raw: RawLabels, regions: Tensor, places: Tensor, on_body: Tensor
) -> tuple[Tensor, Tensor]:
    """What every point costs by its region and by its place; zero off the body."""
    found = cross_entropy(
        raw.regions.mT, regions, ignore_index=-1, reduction="none", label_smoothing=0.01
    )
    error = (raw.places - places).abs().mean(-1)
    away = error * 2**0.5 * (-raw.log_std).exp() + raw.log_std
    return found.where(on_body, 0.0), away.where(on_body, 0.0)


def errors(raw: RawLabels, clouds: LabelledClouds) -> Mapping[str, float]:
    """Shares of points of wrong regions and of strays not told, errors of places (cm).

    `sided` is the share of points that are wrong as well with left and right of the whole moment
    exchanged where that is better.
    """
    labels = believed(raw, clouds.present.flatten(0, 1))
    region, present = clouds.regions.flatten(0, 1), clouds.present.flatten(0, 1)
    on_body = region >= 0
    said = labels.regions.argmax(-1)
    right = (said == region) & on_body
    exchanged = (torch.tensor(MIRRORED_REGIONS)[said] == region) & on_body
    either = torch.maximum(right.sum(-1), exchanged.sum(-1)).sum() / on_body.sum()
    away = (labels.places - clouds.places.flatten(0, 1)).norm(dim=-1)[on_body]
    told = (raw.on_body > 0)[present] == on_body[present]
    return {
        "wrong": 1 - float(right.sum() / on_body.sum()),
        "sided": 1 - float(either),
        "place_cm": 100 * float(away.mean()),
        "place_median_cm": 100 * float(away.median()),
        "stray_wrong": 1 - float(told.float().mean()),
    }


@dataclass(frozen=True)
class LabelTraining:
    """Settings of a run."""

    corpus: Path
    """Folder of labelled clouds of the training people, as `training.labels.shards`
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


_LOG = logging.getLogger(__name__)

_HELD_OUT, _POINTS = 48, 384
"""Windows that validation looks at, and the points of their moments."""
_WARM = 200
"""Steps over which the learning rate rises."""


def train(settings: LabelTraining) -> Path:
    """Train, or go on training; the checkpoint's path.

    Raises:
        FileNotFoundError: when there are no clouds.
        ValueError: when the folder holds another run.
    """
    settings.out.mkdir(parents=True, exist_ok=True)
    with logged_to(settings.out / "train.log", "a"):
        learned = CloudCorpus.load(settings.corpus)
        return train_on(settings, learned, CloudCorpus.load(settings.checked))


def train_on(settings: LabelTraining, learned: CloudCorpus, checked: CloudCorpus) -> Path:
    """Train on clouds that are loaded already; the checkpoint's path."""
    torch.set_num_threads(settings.threads)
    run = start(settings)
    held_out = held_out_clouds(checked)
    _LOG.info("settings: %s", settings)
    _LOG.info("from step %d; %d windows, %d of validation", run.step, len(learned), len(checked))
    return run_steps(
        run,
        settings.steps,
        partial(training_step, run, learned),
        partial(validate, run, held_out),
        partial(note, run),
        run.save,
        _LOG,
    )


def training_step(run: LabelRun, learned: CloudCorpus) -> dict[str, float]:
    """One step of the optimiser; its losses."""
    settings = run.settings
    clouds = learned.draw(settings.windows, settings.variation, run.random)
    seen = seen_of(clouds)
    found = losses(said_of(run.networks.train(), seen, clouds.points.shape[1]), seen, clouds)
    rate = settings.rate * cosine(run.step / settings.steps) * min(1, (run.step + 1) / _WARM)
    descend(run, found["total"], rate, settings.clip, settings.average)
    return {name: value.item() for name, value in found.items()}


def held_out_clouds(checked: CloudCorpus) -> dict[str, LabelledClouds]:
    """Windows as they are, the same with half of their points hidden, and turned over."""
    random = torch.Generator().manual_seed(0)
    windows = torch.arange(0, len(checked), max(1, len(checked) // _HELD_OUT))[:_HELD_OUT]
    plain = checked.take(windows, _POINTS, None)
    turned = CloudVariation(tilted=1.0, hidden=0.0, lost_limb=0.0, blind=0.0)
    return {
        "": plain,
        "half_": half_hidden(plain, random),
        "tilted_": varied(plain, turned, random),
    }


@torch.no_grad()
def validate(run: LabelRun, held_out: dict[str, LabelledClouds]) -> dict[str, float]:
    """Errors on other people; `score` is the mean share of wrong regions."""
    row: dict[str, float] = {}
    for name, clouds in held_out.items():
        found = errors(said_of(run.averaged, seen_of(clouds), clouds.points.shape[1]), clouds)
        row |= {name + key: value for key, value in found.items()}
    row["score"] = (row["wrong"] + row["half_wrong"] + row["tilted_wrong"]) / 3
    return row
