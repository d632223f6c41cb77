"""Losses of the HUMOS prior: one motion, another body, and back."""

import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.humos.frames import BodyFrames
from priors.humos.networks import WindowNetworks
from priors.humos.prior import FPS
from recon.benchmark.dataset import Splits
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.scene import Scene
from recon.method.protocols import Decoded, Estimate
from recon.physics import energies as physics
from training.descent import cosine, descend
from training.humos.corpus import BodyBatch, BodyCorpus
from training.humos.run import HumosRun, HumosTraining, keep_warm, note, save, start
from training.run import logged_to, run_steps

_NUMBER, _JOINT, _STEP = 0.02, 0.02, 0.005
"""Metres: errors of numbers, of joints, and of a joint's step to the next frame, that cost ½."""
_FLYING = 0.03
"""Lengths of leg above which the lowest point of a recorded body flies."""


@dataclass(frozen=True)
class Codes:
    """q(z | motion, body), and one draw."""

    mean: Float[Tensor, "clips memory latent"]
    log_variance: Float[Tensor, "clips memory latent"]
    drawn: Float[Tensor, "clips memory latent"]


def encoded(
    networks: WindowNetworks,
    rows: Float[Tensor, "clips time numbers"],
    shape: Float[Tensor, "clips shape"],
    exists: Bool[Tensor, "clips windows"],
    random: torch.Generator | None,
) -> Codes:
    """Codes of a motion; without random numbers their means."""
    mean, log_variance = networks.posterior(rows, shape, exists)
    if random is None:
        return Codes(mean, log_variance, mean)
    noise = torch.randn(mean.shape, generator=random)
    return Codes(mean, log_variance, mean + noise * (0.5 * log_variance).exp())


def reconstruction(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch, body: BodyModel
) -> Float[Tensor, ""]:
    """½ mean |error|² / σ² of the numbers, of the joints, and of the joints' steps.

    The first is HUMOS's loss of rotations and translation in metres, the others are what feet
    need: orientations a degree off move a foot by centimetres.
    """
    made, true = BodyFrames.unpack(rows), batch.frames
    valid = batch.valid[..., None]
    numbers = (rows - true.pack()).square()
    away = made.joints(batch.shape, body) - true.joints(batch.shape, body)
    step = away.diff(dim=1).square().sum(-1)
    both = valid[:, 1:] & valid[:, :-1]
    return 0.5 * (
        _mean(numbers, valid) / _NUMBER**2
        + _mean(away.square().sum(-1), valid) / _JOINT**2
        + _mean(step, both) / _STEP**2
    )


def numbers_error(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch
) -> Float[Tensor, ""]:
    """½ mean |error|² / σ² of the numbers alone: enough for the way there and back."""
    return 0.5 * _mean((rows - batch.frames.pack()).square(), batch.valid[..., None]) / _NUMBER**2


def divergence(codes: Codes, exists: Bool[Tensor, "clips windows"]) -> Float[Tensor, ""]:
    """Mean KL(q || N(0, 1)) per number of a code that exists, nats."""
    kl = 0.5 * (codes.log_variance.exp() + codes.mean.square() - 1 - codes.log_variance)
    if codes.mean.shape[1] == 1:
        return kl.mean()
    return _mean(kl, exists[..., None])


@dataclass(frozen=True)
class PhysicsLosses:
    """Energies of a motion that nobody recorded, per frame and in the units of the others."""

    ground: Float[Tensor, ""]
    """Penetration and float."""
    slide: Float[Tensor, ""]
    balance: Float[Tensor, ""]
    bounce: Float[Tensor, ""]
    """Second differences of the pelvis' height beside those that were recorded."""


def physics_losses(
    rows: Float[Tensor, "clips time numbers"], batch: BodyBatch, body: BodyModel
) -> PhysicsLosses:
    """Penetration, float where the recorded body does not fly, slide, dynamic stability.

    And vertical acceleration: a body whose lowest point is put on the ground in every frame may
    tremble, which no loss of poses sees.
    """
    motion = placed(rows, batch, body)
    estimate = Estimate(
        Decoded(motion), body.pose(motion), Scene.create(len(rows), like=motion.translation)
    )
    frames = batch.valid.sum() * (30 / FPS)
    flying = batch.frames.clearance > _FLYING
    ground = physics.penetration(estimate) + physics.FloatingUnlessFlying(flying)(estimate)
    return PhysicsLosses(
        ground=ground.sum() / frames,
        slide=physics.slide(estimate).sum() / frames,
        balance=physics.dynamic_stability(estimate).sum() / frames,
        bounce=0.5 * _mean(_bounce(motion, batch, body)[..., None], batch.valid[:, 2:, None]),
    )


def _bounce(motion: Motion, batch: BodyBatch, body: BodyModel) -> Float[Tensor, "clips inner"]:
    """Squared second difference of the error of the pelvis' height, metres² per metre² of leg."""
    pelvis = motion.translation[..., 2] + body.rest_joints(motion.shape)[:, :1, 2]
    height = pelvis / leg_length(body, motion.shape)[:, None]
    return (height - batch.height).diff(n=2, dim=-1).square()


def placed(rows: Float[Tensor, "clips time numbers"], batch: BodyBatch, body: BodyModel) -> Motion:
    """Rows as the motion of the other body of the batch."""
    base = so3.rigid(torch.eye(3), torch.zeros(3)).expand(len(rows), 4, 4)
    return BodyFrames.unpack(rows).motion(batch.other, body, FPS, base).replace(valid=batch.valid)


def _mean(values: Tensor, valid: Bool[Tensor, "*batch 1"]) -> Float[Tensor, ""]:
    return values.where(valid, 0.0).sum() / (valid.sum() * values.shape[-1]).clamp(min=1)


_LOG = logging.getLogger("training.humos.train")

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
