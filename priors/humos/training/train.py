"""Training the HUMOS prior: first an auto-encoder, then from one body to another and back.

HUMOS, section 3.3, with the warm start of its released code. What differs: frames that hardly
depend on the body, a code every 0.4 s, losses in metres, physics on chosen points and short
stretches, and bodies out of the whole shape space, of which a small corpus shows little.
"""

import logging
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from priors.humos.frames import BodyFrames
from priors.humos.training.corpus import BodyBatch, BodyCorpus
from priors.humos.training.losses import (
    divergence,
    encoded,
    numbers_error,
    physics_losses,
    reconstruction,
)
from priors.humos.training.run import HumosRun, HumosTraining, keep_warm, note, save, start
from priors.training.dataset import Splits
from priors.training.descent import cosine, descend
from priors.training.logfile import logged_to
from priors.training.run import run_steps
from recon.body.model import BodyModel

_LOG = logging.getLogger("priors.humos.training.train")

_HELD_OUT = 48
"""Windows that validation looks at."""
_WARM = 100
"""Steps over which the learning rate rises."""
_GROUND, _SLIDE, _BALANCE, _BOUNCE = 0.002, 0.0007, 0.05, 0.002
"""Metres of penetration and float, of a sole's step, of imbalance, and of a second difference of
the pelvis' height, that cost ½."""


def train(settings: HumosTraining) -> Path:
    """Train, or go on training; the checkpoint's path.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when there is no clip to learn from, or the folder holds another run.
    """
    settings.out.mkdir(parents=True, exist_ok=True)
    with logged_to(settings.out / "train.log", "a"):
        body, splits = BodyModel.load(), Splits.load(settings.splits)
        learned = BodyCorpus.load(
            settings.corpus, splits, "train", settings.data, body, settings.speeds
        )
        checked = BodyCorpus.load(settings.corpus, splits, "validation", settings.data, body)
        return train_on(settings, learned, checked)


def train_on(settings: HumosTraining, learned: BodyCorpus, checked: BodyCorpus) -> Path:
    """Train on clips that are loaded already; the checkpoint's path."""
    torch.set_num_threads(settings.threads)
    run = start(settings, learned)
    held_out = checked.every(settings.frames, _HELD_OUT, torch.Generator().manual_seed(0))
    _LOG.info("settings: %s", settings)
    _LOG.info("from step %d; %d validation windows", run.step, len(held_out.shape))

    def one_step() -> dict[str, float]:
        total = training_step(run, learned)
        if run.step == settings.first_steps:
            keep_warm(run)
        return {"total": total}

    def check() -> dict[str, float]:
        return validate(run, held_out, learned.body)

    return run_steps(
        run, settings.all_steps, one_step, check, partial(note, run), partial(save, run), _LOG
    )


def training_step(run: HumosRun, learned: BodyCorpus) -> float:
    """One step of the optimiser; its loss."""
    settings = run.settings
    batch = learned.draw(settings.clips, settings.frames, settings.variation, run.random)
    total = _loss(run, batch, learned.body, run.step >= settings.first_steps)
    descend(run, total, _rate(settings, run.step), settings.clip, settings.average)
    return total.item()


def _loss(run: HumosRun, batch: BodyBatch, body: BodyModel, cycle: bool) -> Tensor:
    """Reconstruction and divergence; in the second part also the way to a body and back."""
    settings, networks = run.settings, run.networks.train()
    frames, exists = settings.frames, batch.windows
    codes = encoded(networks, batch.frames.pack(), batch.shape, exists, run.random)
    same = networks.decode(codes.drawn, batch.shape, exists, frames)
    total = reconstruction(same, batch, body) + settings.kl * divergence(codes, exists)
    if not cycle:
        return total
    made = networks.decode(codes.drawn, batch.other, exists, frames)
    again = encoded(networks, made, batch.other, exists, run.random)
    back = networks.decode(again.drawn, batch.shape, exists, frames)
    apart = (codes.mean - again.mean).square().mean()
    total = total + numbers_error(back, batch) + settings.same_code * apart
    total = total + settings.kl * divergence(again, exists)
    if settings.physics == 0 and settings.balance == 0:
        return total
    room = settings.frames - settings.physics_frames
    first = int(torch.randint(room + 1, (1,), generator=run.random))
    some = slice(first, first + settings.physics_frames)
    found = physics_losses(made[:, some], _between(batch, some), body)
    physics = found.ground / _GROUND**2 + found.slide / _SLIDE**2 + found.bounce / _BOUNCE**2
    return total + settings.physics * physics + settings.balance * found.balance / _BALANCE**2


def validate(run: HumosRun, held_out: BodyBatch, body: BodyModel) -> dict[str, float]:
    """Errors on other people, there and back, and physics of the motion on another body."""
    networks, frames = run.averaged, run.settings.frames
    exists = held_out.windows
    with torch.no_grad():
        codes = encoded(networks, held_out.frames.pack(), held_out.shape, exists, None)
        same = networks.decode(codes.mean, held_out.shape, exists, frames)
        made = networks.decode(codes.mean, held_out.other, exists, frames)
        again = encoded(networks, made, held_out.other, exists, None)
        back = networks.decode(again.mean, held_out.shape, exists, frames)
        physics = physics_losses(made, held_out, body)
        return {
            "reconstruction": float(reconstruction(same, held_out, body)),
            "joint_cm": _joint_error(same, held_out, body),
            "cycle_joint_cm": _joint_error(back, held_out, body),
            "clearance_cm": _clearance_error(same, held_out),
            "changed_cm": _changed(made, same, held_out, body),
            "ground": float(physics.ground) * 1e4,
            "slide": float(physics.slide) * 1e4,
            "balance": float(physics.balance) * 1e4,
            "bounce": float(physics.bounce) * 1e4,
            "kl": float(divergence(codes, exists)),
        }


def _joint_error(rows: Tensor, batch: BodyBatch, body: BodyModel) -> float:
    """Mean distance of joints about the level of the pelvis, cm."""
    made, true = (f.joints(batch.shape, body) for f in (BodyFrames.unpack(rows), batch.frames))
    return 100 * float((made - true).norm(dim=-1).mean(-1)[batch.valid].mean())


def _clearance_error(rows: Tensor, batch: BodyBatch) -> float:
    """Mean error of the lowest point's height, cm per metre of leg."""
    error = BodyFrames.unpack(rows).clearance - batch.frames.clearance
    return 100 * float(error.abs()[batch.valid].mean())


def _changed(made: Tensor, same: Tensor, batch: BodyBatch, body: BodyModel) -> float:
    """Mean distance by which another body moves the joints of one skeleton, cm."""
    a, b = (BodyFrames.unpack(rows).joints(batch.shape, body) for rows in (made, same))
    return 100 * float((a - b).norm(dim=-1).mean(-1)[batch.valid].mean())


def _between(batch: BodyBatch, some: slice) -> BodyBatch:
    frames = batch.frames.map(lambda rows: rows[:, some])
    return batch.replace(frames=frames, height=batch.height[:, some], valid=batch.valid[:, some])


def _rate(settings: HumosTraining, step: int) -> float:
    """Each part warms up and falls along a cosine."""
    first = step < settings.first_steps
    most = settings.rate if first else settings.cycle_rate
    here, length = (
        (step, settings.first_steps) if first else (step - settings.first_steps, settings.steps)
    )
    return most * cosine(here / length) * min(1.0, (here + 1) / _WARM)
