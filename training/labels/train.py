"""Training of the network that labels points, on clouds that are drawn from a corpus first."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from priors.labels.networks import LabelNetwork
from training.descent import Muon
from training.labels.clouds import CloudCorpus, CloudVariation, half_hidden, varied
from training.labels.losses import errors, losses, said_of, seen_of
from training.labels.shards import make_training_clouds
from training.run import CHECKPOINT, Run, in_folder, trained_state
from training.settings import TrainingSettings, told_settings
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
        whole = checked.take(windows, _POINTS, None)
        self.checked = {
            "": whole,
            "half_": half_hidden(whole, random),
            "tilted_": varied(whole, _TURNED_OVER, random),
        }
        super().__init__(settings)

    def untrained(self, state: Mapping[str, Any] | None) -> LabelNetwork:
        """A network with random weights."""
        del state
        return LabelNetwork()

    def optimiser_of(self, networks: LabelNetwork) -> torch.optim.Optimizer:
        """Muon for matrices between hidden numbers, AdamW for the first and last layers and rest.

        It needs a third of the steps of AdamW alone to learn one batch.
        """
        inner = ("layers.", "moments.", "joined.", "learned.")
        matrices, others = [], []
        for name, parameter in networks.named_parameters():
            hidden = name.startswith(inner) and parameter.ndim == 2
            (matrices if hidden else others).append(parameter)
        return Muon(matrices, others, self.settings.rate, self.settings.decay)

    def losses(self) -> dict[str, Tensor]:
        """Losses of drawn windows."""
        settings = self.settings
        clouds = self.learned.draw(settings.windows, settings.variation, self.random)
        seen = seen_of(clouds)
        said = said_of(self.networks.train(), seen, clouds.points.shape[1])
        return losses(said, seen, clouds)

    @torch.no_grad()
    def errors(self) -> dict[str, float]:
        """Errors on other people; `score` is the mean share of wrong regions."""
        row: dict[str, float] = {}
        for name, clouds in self.checked.items():
            said = said_of(self.averaged, seen_of(clouds), clouds.points.shape[1])
            row |= {name + key: value for key, value in errors(said, clouds).items()}
        score = (row["wrong"] + row["half_wrong"] + row["tilted_wrong"]) / 3
        return row | {"score": score}


def train(settings: LabelTraining) -> Path:
    """Draw labelled clouds, then train, or go on with either; the checkpoint's path.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when the folder holds another run.
    """
    with in_folder(settings):
        learned, checked = make_training_clouds(settings)
        return LabelRun(settings, CloudCorpus.load(learned), CloudCorpus.load(checked)).go()


def export_weights(settings: LabelTraining, path: Path) -> Path:
    """Write the averaged network of a run as a weights file, in half precision.

    Raises:
        FileNotFoundError: when the run has no checkpoint yet.
    """
    found = trained_state(settings.out / CHECKPOINT)
    network = LabelNetwork()
    network.load_state_dict(found["averaged"])
    about = told_settings(settings) | {"step": found["step"]}
    save_checkpoint(path, "labels", half_precision(network), about)
    return path
