"""Training HuMoR: transitions of the corpus, a conditional VAE, and its initial-state mixture.

Losses and schedules follow HuMoR's section 3 and its released settings, counted in steps of the
optimiser. What differs: joints of the body by its kinematics only (no mesh), an average of the
weights over time as the result, and validation under fixed weights, so that losses of all times
compare.
"""

import dataclasses
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from priors.humor.state import Frame, State, canonical, compose
from priors.humor.steps import divergence
from recon.benchmark.dataset import Splits, files_on_flat_ground
from recon.body.kinematics import forward_kinematics
from recon.body.model import BodyModel
from recon.core.skeleton import CONTACT_JOINTS
from recon.core.struct import TensorStruct, stack
from training.descent import cosine, descend
from training.humor.corpus import Corpus, StateWindows
from training.humor.run import HumorRun, HumorTraining, LossWeights, export_weights, note, start
from training.humor.scaling import ScaledNetworks
from training.run import logged_to, run_steps

_LOG = logging.getLogger("training.humor.train")


@dataclass(frozen=True)
class Transition(TensorStruct):
    """Outputs of the networks for steps between states, in the frame where each step starts."""

    after: State
    contacts: Float[Tensor, "*batch 9"]
    """Logits."""
    posterior_mean: Float[Tensor, "*batch 48"]
    posterior_log_variance: Float[Tensor, "*batch 48"]
    prior_mean: Float[Tensor, "*batch 48"]
    prior_log_variance: Float[Tensor, "*batch 48"]


def train(settings: HumorTraining, kind: type[ScaledNetworks] = ScaledNetworks) -> Path:
    """Train, or go on training; the checkpoint's path.

    Args:
        settings: of the run.
        kind: what learns.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when no clip may be learned from, or the folder holds another run.
    """
    settings.out.mkdir(parents=True, exist_ok=True)
    with logged_to(settings.out / "train.log", "a"):
        return _train(settings, kind)


def _train(settings: HumorTraining, kind: type[ScaledNetworks]) -> Path:
    torch.set_num_threads(settings.threads)
    body = BodyModel.load()
    splits = Splits.load(settings.splits)
    learned = Corpus.load(settings.corpus, splits, "train", settings.data, body)
    learned = learned.to(device=settings.device)
    held_out = learned
    if files_on_flat_ground(settings.corpus, splits, "validation", settings.data):
        held_out = Corpus.load(settings.corpus, splits, "validation", settings.data, body)
        held_out = held_out.to(device=settings.device)
    else:
        _LOG.warning(
            "no validation clip is on flat ground: the validation losses of this run are those of "
            "its training clips"
        )
    checked = held_out.every(settings.frames)
    run = start(settings, learned, kind)
    _LOG.info("settings: %s", settings)
    _LOG.info("from step %d; %d validation windows", run.step, len(checked.trusted))

    def one_step() -> dict[str, float]:
        windows = learned.draw(settings.windows, settings.frames, settings.variation, run.random)
        return training_step(run, windows, settings, run.step / settings.steps)

    def check() -> dict[str, float]:
        return validate(run.averaged, checked, settings.losses)

    return run_steps(run, settings.steps, one_step, check, partial(note, run), run.save, _LOG)


def training_step(
    run: HumorRun, windows: StateWindows, settings: HumorTraining, progress: float
) -> dict[str, float]:
    """One step of the optimiser; the losses of its windows."""
    own = (progress - settings.own_from) / max(settings.own_until - settings.own_from, 1e-9)
    chance = 1 - min(max(own, 0.0), 1.0)
    draws = torch.rand(settings.frames - 1, generator=run.random)
    half = settings.precision == "bfloat16"
    found, target = unroll(run.networks, windows, draws < chance, run.random, half)
    losses = loss_terms(found, target, windows)
    annealed = min(1.0, progress / max(settings.kl_until, 1e-9))
    total = total_loss(losses, annealed, settings.losses)
    descend(run, total, settings.rate * cosine(progress), settings.clip, settings.average)
    return {name: value.item() for name, value in (losses | {"total": total}).items()}


def unroll(
    networks: ScaledNetworks,
    windows: StateWindows,
    true_input: Bool[Tensor, " steps"],
    random: torch.Generator | None,
    half: bool = False,
) -> tuple[Transition, State]:
    """All steps of the windows, from true states or from the network's own; and their targets.

    A step from an own prediction starts at that prediction, in its own frame; the state to reach
    remains the true one, in the frame of the true state before. No gradient passes from step to
    step.

    Args:
        networks: prior, encoder and decoder.
        windows: axes (windows, frames).
        true_input: for every step, whether it starts at the true state; the first always does.
        random: draws the latents; None takes their means.
        half: whether the networks multiply in bfloat16.
    """
    world = windows.states
    level = world.translation.new_tensor([1.0, 1.0, 0.0])
    pelvis = windows.rest[:, 0] * level
    past, future = world[:, :-1], world[:, 1:]
    frame = Frame.of(past)
    start, target = frame.enter(past, pelvis[:, None]), frame.enter(future, pelvis[:, None])
    if bool(true_input[1:].all()):
        return transition(networks, start, target, random, half), target
    steps: list[Transition] = []
    for k, given in enumerate(true_input.tolist()):
        state = start[:, k]
        if k > 0 and not given:
            state = canonical(steps[-1].after.detach(), pelvis)
        steps.append(transition(networks, state, target[:, k], random, half))
    return stack(steps).map(lambda tensor: tensor.transpose(0, 1)), target


def transition(
    networks: ScaledNetworks,
    state: State,
    target: State,
    random: torch.Generator | None,
    half: bool,
) -> Transition:
    """One step towards a target: encode both, draw a latent, decode."""
    packed = state.pack()
    with torch.autocast(packed.device.type, torch.bfloat16, enabled=half):
        mean, log_variance = networks.posterior(packed, target.pack())
        latent = mean.float()
        if random is not None:
            noise = torch.randn(latent.shape, generator=random).to(latent)
            latent = latent + noise * (0.5 * log_variance.float()).exp()
        raw = networks.decode(packed, latent).float()
        prior = networks.prior(packed)
    after, contacts = compose(state, raw)
    return Transition(after, contacts, *(t.float() for t in (mean, log_variance, *prior)))


def loss_terms(found: Transition, target: State, windows: StateWindows) -> dict[str, Tensor]:
    """Unweighted losses, each a mean over all transitions and entries (HuMoR, section 3.2)."""
    after = found.after
    names = [field.name for field in dataclasses.fields(State)]
    losses = {
        name: functional.mse_loss(getattr(after, name), getattr(target, name)) for name in names
    }
    rotations = torch.cat((after.root[..., None, :, :], after.pose), -3)
    posed = forward_kinematics(rotations, windows.rest)[1] + after.translation[..., None, :]
    losses["posed_joints"] = functional.mse_loss(posed, target.joints)
    losses["consistency"] = functional.mse_loss(posed, after.joints)

    losses["kl"] = divergence(
        found.posterior_mean, found.posterior_log_variance,
        found.prior_mean, found.prior_log_variance,
    ).mean()  # fmt: skip

    trusted = windows.trusted[:, None, None].expand(found.contacts.shape).to(found.contacts)
    count = trusted.sum().clamp(min=1)
    entropy = functional.binary_cross_entropy_with_logits(
        found.contacts, windows.contacts[:, 1:], reduction="none"
    )
    losses["contacts"] = (entropy * trusted).sum() / count
    speed = after.joint_velocities[..., list(CONTACT_JOINTS), :].square().sum(-1)
    losses["contact_velocity"] = (found.contacts.sigmoid() * speed * trusted).sum() / count
    return losses


def total_loss(losses: Mapping[str, Tensor], kl: float, weights: LossWeights) -> Tensor:
    """The weighted sum; `kl` is the annealed share of that term's weight."""
    given = dataclasses.asdict(weights) | {"kl": kl * weights.kl}
    return torch.stack([given.get(name, 1.0) * value for name, value in losses.items()]).sum()


def validate(
    networks: ScaledNetworks, windows: StateWindows, weights: LossWeights
) -> dict[str, float]:
    """Losses with mean latents and full weights, from true states and from own predictions.

    `drift_cm` is the mean error of the posed joints after the window's last own step.
    """
    row: dict[str, float] = {}
    steps = windows.contacts.shape[1] - 1
    with torch.no_grad():
        for name, true_input in (("one", True), ("own", False)):
            given = torch.full((steps,), true_input)
            found, target = unroll(networks, windows, given, None)
            losses = loss_terms(found, target, windows)
            row[f"{name}_total"] = total_loss(losses, 1.0, weights).item()
            row |= {f"{name}_{key}": value.item() for key, value in losses.items()}
            trusted = windows.trusted
            labels = windows.contacts[trusted, 1:, 3:7] > 0.5
            right = (found.contacts[trusted][..., 3:7] > 0) == labels
            row[f"{name}_feet_right"] = right.float().mean().item()
        error = (found.after.joints - target.joints)[:, -1].norm(dim=-1).mean()
        row["drift_cm"] = 100 * error.item()
    row["score"] = row["one_total"] + row["own_total"]
    return row


def _main(settings: HumorTraining, export: Path | None = None) -> None:
    """Train; or write the best weights so far.

    Args:
        settings: of the run.
        export: weights to write (.safetensors) instead of training.
    """
    if export is None:
        train(settings)
    else:
        export_weights(settings, export)


if __name__ == "__main__":
    import tyro

    logging.basicConfig(level=logging.INFO)
    tyro.cli(_main, config=(tyro.conf.OmitArgPrefixes,))
