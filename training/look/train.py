"""Trains the network that proposes motions, on windows seen by simulated sensors.

    python -m training look CORPUS --out look.safetensors
    python -m training.look.train --corpus CORPUS --out RUN [--start WEIGHTS] [--device cuda]
    python -m training.look.train --corpus CORPUS --out RUN --export look.safetensors

The loss is that of a mixture: every hypothesis costs its errors, the weights say how likely each
is the nearest, and the nearest learns most.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.look.looking import load_network
from priors.look.networks import LookNetwork, Proposed
from priors.look.points import SeenPoints
from recon.body.model import BodyModel, forward_kinematics
from training.humor.corpus import Corpus, StateWindows
from training.humor.variation import Variation
from training.look.seeing import CLEAR, SensorSettings
from training.run import BEST, LOG, Run, logged_in_folder, run_by_options, trained_state
from training.settings import TrainingSettings, settings_to_store
from training.weights import half_precision, save_checkpoint

_NEAREST_M = 0.004
"""Mean distance of joints, metres, that makes a hypothesis e times less likely the nearest."""
_DRAWN_AT_ONCE = 8
"""Batches of windows that are drawn at once; each is seen four times, differently."""


_VARIED = Variation(speed=0.2, shape=1.0, halves=0.3, kinds=0.5, people=0.3)


@dataclass(frozen=True)
class LookWeights:
    """Weights of the losses of the network that proposes motions."""

    joints: float = 10.0
    """Mean distance of the joints, metres."""
    rotations: float = 1.0
    """Mean |ΔR| of the joints' rotations."""
    velocities: float = 1.0
    """Mean error of the joints' velocities, m/s."""
    likelihood: float = 0.05
    """Negative log-likelihood of the joints under the standard deviations, nats a joint."""
    contacts: float = 0.2
    """Cross entropy of contacts."""
    choice: float = 0.2
    """Cross entropy of which hypothesis is the nearest."""
    coefficients: float = 0.003
    """Squared coefficients of the body."""
    others: float = 0.05
    """Share of the loss that all hypotheses learn from, so that none stays unused."""


@dataclass(frozen=True)
class LookTraining(TrainingSettings):
    """Settings of a training run of the network that proposes motions."""

    steps: int = 20_000
    rate: float = 6e-4
    decay: float = 0.05
    average: float = 0.999
    width: int = 224
    """Units of the transformer."""
    hypotheses: int = 4
    start: Path | None = None
    """Weights to begin with, of the same width and as many hypotheses."""
    windows: int = 128
    """Windows per step."""
    frames: int = 90
    """Frames of the longest windows, at 30 Hz."""
    losses: LookWeights = field(default_factory=LookWeights)
    variation: Variation = _VARIED
    """Random variations of the motions."""
    seeing: SensorSettings = field(default_factory=SensorSettings)
    """What is seen of them."""
    device: str = "cpu"


class LookRun(Run[LookTraining, LookNetwork]):
    """A training run."""

    panels = (("train_total",), ("seen_cm", "below_cm", "gap_cm", "noisy_cm"))
    keeps_best = True
    betas = (0.9, 0.98)
    warm_up_steps = 500

    def __init__(self, settings: LookTraining, learned: Corpus, held_out: Corpus) -> None:
        self.learned = learned.to(device=settings.device)
        self.checked = held_out.to(device=settings.device).all_windows(min(60, settings.frames))
        self.drawn: StateWindows | None = None
        self.noise = torch.Generator(settings.device)
        super().__init__(settings)

    def untrained_networks(self, state: Mapping[str, Any] | None) -> LookNetwork:
        """A random network, or the one to start from; a checkpoint's weights are loaded later."""
        del state
        settings = self.settings
        if settings.start is not None:
            learned = deepcopy(load_network(settings.start)).requires_grad_(True)
            return learned.train().to(settings.device)
        found = LookNetwork(
            self.learned.body.shape_size, settings.width, hypotheses=settings.hypotheses
        )
        return found.to(settings.device)

    def losses(self) -> dict[str, Tensor]:
        """Losses of a random batch of training windows."""
        settings, body = self.settings, self.learned.body
        pool, place = divmod(self.step, 4 * _DRAWN_AT_ONCE)
        # random numbers are seeded by the step, so that a resumed run continues exactly
        if place == 0 or self.drawn is None:
            self.random.manual_seed(settings.seed + pool)
            count = _DRAWN_AT_ONCE * settings.windows
            self.drawn = self.learned.draw(count, settings.frames, settings.variation, self.random)
        self.noise.manual_seed(settings.seed + self.step)
        first = place % _DRAWN_AT_ONCE * settings.windows
        windows = self.drawn[slice(first, first + settings.windows)]
        seen = points_seen(windows, settings.seeing, body, self.noise)
        return losses_of(self.networks, seen, windows, body, settings.losses)

    @torch.no_grad()
    def errors(self) -> dict[str, float]:
        """Errors of the averaged network on held-out people, centimetres."""
        return validate(self.averaged, self.checked, self.learned.body)


def points_seen(
    windows: StateWindows, seeing: SensorSettings, body: BodyModel, random: torch.Generator
) -> SeenPoints:
    """Simulate which points sensors see of windows of motion."""
    orientations, _ = forward_kinematics(windows.states.rotations, windows.rest)
    return seeing.points_of(windows.states.joints, orientations, body, random)


def losses_of(
    network: LookNetwork,
    seen: SeenPoints,
    windows: StateWindows,
    body: BodyModel,
    weights: LookWeights,
) -> dict[str, Tensor]:
    """Losses of a batch by name, each for the hypothesis likely to be nearest; and `total`."""
    found = network(seen, body, half=True)
    true = windows.states.rotations[:, None]
    target = windows.states.joints[:, None]
    exists = seen.exists.to(target)
    joints = found.joints(body)
    parts = {
        "joints": _mean_over_time(_smooth_norm(joints - target).mean(-1), exists),
        "rotations": _mean_over_time(
            _smooth_norm((found.rotations - true).flatten(-2)).mean(-1), exists
        ),
        "velocities": 30
        * _mean_over_time(_smooth_norm((joints - target).diff(dim=2)).mean(-1), exists[:, 1:]),
        "likelihood": _mean_over_time(
            _negative_log_density(joints - target, found.log_std).mean(-1), exists
        ),
        "contacts": windows.trusted[:, None]
        * _mean_over_time(
            _contact_cross_entropy(found, windows.contacts[:, None]).mean(-1), exists
        ),
    }
    near = (found.log_weight - parts["joints"] / _NEAREST_M).detach().softmax(-1)
    cost = sum(getattr(weights, name) * value for name, value in parts.items())
    assert isinstance(cost, Tensor)
    total = (near * cost).sum(-1) + weights.others * cost.mean(-1)
    choice = -(near * found.log_weight).sum(-1)
    shape = found.shape.square().sum(-1)
    total = (total + weights.choice * choice + weights.coefficients * shape).mean()
    rows = {name: (near * value).sum(-1).mean() for name, value in parts.items()}
    return rows | {"choice": choice.mean(), "total": total}


def _smooth_norm(vectors: Tensor) -> Tensor:
    return (vectors.square().sum(-1) + 1e-8).sqrt()


def _mean_over_time(values: Tensor, exists: Float[Tensor, "clips time"]) -> Tensor:
    """Mean of values (clips, hypotheses, time) over the frames that exist."""
    return (values * exists[:, None]).sum(-1) / exists.sum(-1).clamp(min=1)[:, None]


def _negative_log_density(away: Tensor, log_std: Tensor) -> Tensor:
    """-log of a Gaussian density; it has a gradient by the standard deviations only."""
    squared = away.detach().square().sum(-1).clamp(max=4.0)
    return 3 * log_std + 0.5 * squared * (-2 * log_std).exp()


def _contact_cross_entropy(found: Proposed, contacts: Tensor) -> Tensor:
    return torch.nn.functional.binary_cross_entropy_with_logits(
        found.contacts, contacts.expand_as(found.contacts), reduction="none"
    )


_CHECKS: Mapping[str, SensorSettings] = {
    "noisy": replace(CLEAR, noise=(0.03, 0.0301)),
    "below": replace(CLEAR, below=1.0),
    "gap": replace(CLEAR, gap=1.0),
    "seen": SensorSettings(),
}
"""What is seen of held-out windows in each kind of check."""


def validate(network: LookNetwork, windows: StateWindows, body: BodyModel) -> dict[str, float]:
    """Mean errors over held-out windows, the same in every call.

    For every kind of check: the mean distance of all joints (cm) of the heaviest hypothesis and of
    the best one, and the share of coordinates within 1.645 standard deviations of the mixture.
    """
    row: dict[str, float] = {}
    score = 0.0
    for kind, seeing in _CHECKS.items():
        random = torch.Generator(windows.contacts.device).manual_seed(0)
        sums = torch.zeros(3, device=windows.contacts.device)
        total = 0.0
        for first in range(0, len(windows.contacts), 128):
            own = windows[slice(first, first + 128)]
            seen = points_seen(own, seeing, body, random)
            found = network(seen, body)
            joints, target = found.joints(body), own.states.joints
            away = (joints - target[:, None]).norm(dim=-1).mean(-1)
            away = _mean_over_time(away, seen.exists.to(away))
            heaviest = away.gather(1, found.log_weight.argmax(-1, keepdim=True))[:, 0]
            middle, std = joint_mean_and_std(found, joints)
            within = (middle - target).abs() < 1.645 * std[..., None]
            right = within.float()[seen.exists].mean()
            sums += torch.stack((heaviest.sum(), away.amin(-1).sum(), right * len(away)))
            total += len(away)
        mean = (sums / total).tolist()
        row |= {
            f"{kind}_cm": 100 * mean[0], f"{kind}_best_cm": 100 * mean[1],
            f"{kind}_within": mean[2],
        }  # fmt: skip
        score += (mean[0] + mean[1]) / 2
    return row | {"score": score}


def joint_mean_and_std(
    found: Proposed, joints: Float[Tensor, "clips hypotheses time 22 3"]
) -> tuple[Float[Tensor, "clips time 22 3"], Float[Tensor, "clips time 22"]]:
    """Mean of every joint over the hypotheses, and standard deviation of a coordinate, metres."""
    weight = found.log_weight.exp()
    mean = torch.einsum("ch,chtjd->ctjd", weight, joints)
    apart = (joints - mean[:, None]).square().mean(-1)
    variance = (2 * found.log_std).exp() + apart
    return mean, torch.einsum("ch,chtj->ctj", weight, variance).sqrt()


def train(settings: LookTraining) -> Path:
    """Train, or resume training; returns the path of the checkpoint.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when no clip may be learned from, or the folder holds another run.
    """
    with logged_in_folder(settings):
        body = BodyModel.load()
        # also learn poses of people who lie or sit, whose steps are left out of HuMoR's training
        learned = Corpus.load(settings, "train", body, "poses")
        held_out = Corpus.load(settings, "validation", body)
        return LookRun(settings, learned, held_out).train_to_end()


def export_weights(settings: LookTraining, path: Path) -> Path:
    """Write the best network of a run.

    Raises:
        FileNotFoundError: when the run has not validated yet.
    """
    found = trained_state(settings.out / BEST)
    shape = BodyModel.load().shape_size
    network = LookNetwork(shape, settings.width, hypotheses=settings.hypotheses)
    network.load_state_dict(found["averaged"])
    about = settings_to_store(settings) | {"shape": shape, "step": found["step"]}
    save_checkpoint(path, "look", half_precision(network), about)
    LOG.info("wrote the network of step %d as %s", found["step"], path)
    return path


if __name__ == "__main__":
    run_by_options(LookTraining, train, export_weights)
