"""Training of the network that labels points, on clouds drawn from a corpus first; its losses."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from priors.labels.looking import in_network_frame, label_probabilities
from priors.labels.networks import (
    STEPS,
    LabelNetwork,
    RawLabels,
    SeenClouds,
    direction_from_right_to_left,
)
from priors.labels.regions import MIRRORED_REGIONS, mirrored_places
from training.descent import Muon
from training.labels.clouds import (
    CloudCorpus,
    CloudVariation,
    LabelledClouds,
    augmented,
    with_half_hidden,
)
from training.labels.shards import make_training_clouds
from training.run import CHECKPOINT, Run, logged_in_folder, trained_state
from training.settings import TrainingSettings, settings_to_store
from training.weights import half_precision, save_checkpoint

_HELD_OUT, _POINTS = 48, 384
"""Windows that validation looks at, and the points of their moments."""
_TURNED_OVER = CloudVariation(tilted=1.0, hidden=0.0, lost_limb=0.0, blind=0.0)
"""Windows of which nothing is hidden and of which nothing is known of gravity."""


@dataclass(frozen=True)
class LabelTraining(TrainingSettings):
    """Settings of a run, whose folder also has the clouds that are drawn from the corpus."""

    steps: int = 12_000
    rate: float = 1.5e-3
    """Learning rate of Muon and AdamW; it falls to a hundredth along a cosine."""
    average: float = 0.998
    windows: int = 16
    """Windows per step."""
    variation: CloudVariation = field(default_factory=CloudVariation)
    """Random variations of the windows."""


class LabelRun(Run[LabelTraining, LabelNetwork]):
    """A training run."""

    panels = (
        ("train_total",),
        ("train_sides", "train_across"),
        ("wrong", "half_wrong", "tilted_wrong"),
        ("place_cm", "place_median_cm"),
    )
    warm_up_steps = 200

    def __init__(
        self, settings: LabelTraining, learned: CloudCorpus, checked: CloudCorpus
    ) -> None:
        self.learned = learned
        random = torch.Generator().manual_seed(0)
        windows = torch.arange(0, len(checked), max(1, len(checked) // _HELD_OUT))[:_HELD_OUT]
        whole = checked.windows(windows, _POINTS, None)
        self.checked = {
            "": whole,
            "half_": with_half_hidden(whole, random),
            "tilted_": augmented(whole, _TURNED_OVER, random),
        }
        super().__init__(settings)

    def untrained_networks(self, state: Mapping[str, Any] | None) -> LabelNetwork:
        """Make a network with random weights."""
        del state
        return LabelNetwork()

    def optimiser_of(self, networks: LabelNetwork) -> torch.optim.Optimizer:
        """Muon for matrices of hidden layers, AdamW for first and last layers and all else.

        It needs a third of the steps of AdamW alone to learn one batch.
        """
        inner = ("layers.", "moments.", "joined.", "learned.")
        matrices, others = [], []
        for name, parameter in networks.named_parameters():
            hidden = name.startswith(inner) and parameter.ndim == 2
            (matrices if hidden else others).append(parameter)
        return Muon(matrices, others, self.settings.rate, self.settings.decay)

    def losses(self) -> dict[str, Tensor]:
        """Losses of a random batch of training windows."""
        settings = self.settings
        clouds = self.learned.draw(settings.windows, settings.variation, self.random)
        seen = network_input(clouds)
        outputs = outputs_of(self.networks.train(), seen, clouds.points.shape[1])
        return losses(outputs, seen, clouds)

    @torch.no_grad()
    def errors(self) -> dict[str, float]:
        """Errors on other people; `score` is the mean share of wrong regions."""
        row: dict[str, float] = {}
        for name, clouds in self.checked.items():
            outputs = outputs_of(self.averaged, network_input(clouds), clouds.points.shape[1])
            row |= {name + key: value for key, value in errors(outputs, clouds).items()}
        score = (row["wrong"] + row["half_wrong"] + row["tilted_wrong"]) / 3
        return row | {"score": score}


def train(settings: LabelTraining) -> Path:
    """Draw labelled clouds, then train; resumes both; returns the path of the checkpoint.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when the folder holds another run.
    """
    with logged_in_folder(settings):
        learned, checked = make_training_clouds(settings)
        return LabelRun(
            settings, CloudCorpus.load(learned), CloudCorpus.load(checked)
        ).train_to_end()


def export_weights(settings: LabelTraining, path: Path) -> Path:
    """Write the averaged network of a run as a weights file, in half precision.

    Raises:
        FileNotFoundError: when the run has no checkpoint yet.
    """
    found = trained_state(settings.out / CHECKPOINT)
    network = LabelNetwork()
    network.load_state_dict(found["averaged"])
    about = settings_to_store(settings) | {"step": found["step"]}
    save_checkpoint(path, "labels", half_precision(network), about)
    return path


_PLACES, _ON_BODY, _SIDES, _ACROSS = 0.3, 0.5, 0.3, 0.5
"""Weights of the losses of places, on or off the body, sides, and the direction from right to
left, beside that of regions."""


def network_input(clouds: LabelledClouds) -> SeenClouds:
    """Convert windows of clouds to the network's input, with all frames in one axis."""
    moments = clouds.points.shape[1]
    return in_network_frame(
        clouds.points.flatten(0, 1),
        clouds.present.flatten(0, 1),
        clouds.eyes.repeat_interleave(moments, 0),
        clouds.has_eye.repeat_interleave(moments),
        clouds.level.repeat_interleave(moments),
    )


def outputs_of(network: LabelNetwork, seen: SeenClouds, moments: int) -> RawLabels:
    """Compute the network's outputs for windows of `moments` frames each."""
    windows = len(seen.points) // moments
    asked = torch.arange(moments)[:, None] + torch.arange(STEPS) - STEPS // 2
    inside = (asked >= 0) & (asked < moments)
    index = asked.clamp(0, moments - 1)
    neighbours = (moments * torch.arange(windows)[:, None, None] + index).flatten(0, 1)
    known = inside.repeat(windows, 1) & seen.present.any(-1)[neighbours]
    known[:, STEPS // 2] = True
    return network(seen, neighbours, known)


def losses(raw: RawLabels, seen: SeenClouds, clouds: LabelledClouds) -> dict[str, Tensor]:
    """Cross entropies and negative log-densities by name; `total` is their weighted sum.

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
        _point_losses(raw, regions, places, on_body)
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
    truth = direction_from_right_to_left(seen.points, place, on_body.to(place))[shown]
    missed = (raw.across[shown] - truth[:, None]).square().sum(-1)
    across = missed[:, 0].mean() + missed[:, 1:].mean()
    total = found + _ON_BODY * stray + _PLACES * away + _SIDES * sides + _ACROSS * across
    return {
        "total": total, "regions": found, "on_body": stray, "places": away, "sides": sides,
        "across": across,
    }  # fmt: skip


def _point_losses(
    raw: RawLabels, regions: Tensor, places: Tensor, on_body: Tensor
) -> tuple[Tensor, Tensor]:
    """Losses of the region and of the place of every point; zero for points off the body."""
    found = cross_entropy(
        raw.regions.mT, regions, ignore_index=-1, reduction="none", label_smoothing=0.01
    )
    error = (raw.places - places).abs().mean(-1)
    away = error * 2**0.5 * (-raw.log_std).exp() + raw.log_std
    return found.where(on_body, 0.0), away.where(on_body, 0.0)


def errors(raw: RawLabels, clouds: LabelledClouds) -> Mapping[str, float]:
    """Shares of points with a wrong region and of missed strays; errors of places (cm).

    `sided` is the share of points that are wrong as well with left and right of the whole moment
    exchanged where that is better.
    """
    labels = label_probabilities(raw, clouds.present.flatten(0, 1))
    region, present = clouds.regions.flatten(0, 1), clouds.present.flatten(0, 1)
    on_body = region >= 0
    predicted = labels.regions.argmax(-1)
    right = (predicted == region) & on_body
    exchanged = (torch.tensor(MIRRORED_REGIONS)[predicted] == region) & on_body
    either = torch.maximum(right.sum(-1), exchanged.sum(-1)).sum() / on_body.sum()
    away = (labels.places - clouds.places.flatten(0, 1)).norm(dim=-1)[on_body]
    strays_right = (raw.on_body > 0)[present] == on_body[present]
    return {
        "wrong": 1 - float(right.sum() / on_body.sum()),
        "sided": 1 - float(either),
        "place_cm": 100 * float(away.mean()),
        "place_median_cm": 100 * float(away.median()),
        "stray_wrong": 1 - float(strays_right.float().mean()),
    }
