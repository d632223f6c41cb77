"""Training the network of labels on simulated clouds."""

import logging
from functools import partial
from pathlib import Path

import torch

from priors.labels.training.clouds import (
    CloudCorpus,
    CloudVariation,
    LabelledClouds,
    half_hidden,
    varied,
)
from priors.labels.training.losses import errors, losses, said_of, seen_of
from priors.labels.training.run import LabelRun, LabelTraining, note, start
from priors.training.descent import cosine, descend
from priors.training.logfile import logged_to
from priors.training.run import run_steps

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
