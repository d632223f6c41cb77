"""Training HuMoR: transitions of the corpus, a conditional VAE, and its initial-state mixture.

    python -m training.humor.train --corpus CORPUS --out RUN [--start WEIGHTS]
    python -m training.humor.train --corpus CORPUS --out RUN --export humor.safetensors

Losses and schedules follow HuMoR's section 3 and its released settings, counted in steps of the
optimiser. What differs: an average of the weights over time as the result, and validation under
fixed weights, so that losses of all times compare.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from priors.humor.mixture import Mixture
from priors.humor.networks import HumorNetworks
from priors.humor.prior import networks_from, read_weights
from priors.humor.state import (
    State,
    canonical_state,
    independent_features,
    initial_features,
    rest_pelvis,
)
from priors.humor.steps import posterior_outputs
from recon.body.model import BodyModel
from training.humor.corpus import Corpus, StateWindows
from training.humor.losses import LossWeights, loss_terms, total_loss, unroll
from training.humor.scaling import ScaledNetworks, Scaling
from training.humor.variation import VARIED, Variation
from training.run import BEST, LOG, Run, logged_in_folder, run_by_options, trained_state
from training.settings import TrainingSettings, settings_to_store
from training.weights import save_humor

_SCALED_BY = 20_000
"""Windows from which the scales of inputs and outputs are taken."""


@dataclass(frozen=True)
class HumorTraining(TrainingSettings):
    """Settings of a training run of HuMoR."""

    decay: float = 0.1
    clip: float = 5.0
    average: float = 0.999
    save_every: float = 180.0
    width: int = 512
    """Units of the hidden layers; 1024 is published."""
    windows: int = 200
    """Windows per step (published)."""
    frames: int = 11
    """Frames per window: ten transitions (published)."""
    noise: float = 0.1
    """Standard deviation of what blurs the states that the networks see, in their own ones."""
    start: Path | None = None
    """Weights to begin with, of the same width; then `kl_until`, `own_from` and `own_until` may
    be zero."""
    kl_until: float = 0.25
    """Share of the run over which the KL weight rises from zero (published)."""
    own_from: float = 0.05
    own_until: float = 0.1
    """Shares of the run between which inputs change from true states to own predictions
    (published)."""
    losses: LossWeights = field(default_factory=LossWeights)
    """Weights of the losses."""
    variation: Variation = VARIED
    """Random variations of the windows."""
    device: str = "cpu"


class HumorRun(Run[HumorTraining, ScaledNetworks]):
    """A training run; the networks' products are in bfloat16, which takes half the time."""

    panels = (
        ("train_total", "one_total", "own_total"),
        ("train_kl", "one_kl", "own_kl"),
        ("drift_cm", "own_feet_right"),
    )
    keeps_best = True
    betas = (0.9, 0.99)

    def __init__(self, settings: HumorTraining, learned: Corpus, held_out: Corpus) -> None:
        self.learned = learned.to(device=settings.device)
        self.checked = held_out.to(device=settings.device).all_windows(settings.frames)
        super().__init__(settings)

    def untrained_networks(self, state: Mapping[str, Any] | None) -> ScaledNetworks:
        """Make untrained networks (or load those to start from), scaled by augmented windows."""
        settings = self.settings
        scaling = Scaling.identity()
        if state is None:
            windows = self.learned.draw(_SCALED_BY, 2, settings.variation, self.random)
            scaling = Scaling.of(windows.states, rest_pelvis(windows.states[:, 0]))
        core = HumorNetworks(settings.width).to(settings.device)
        if settings.start is None:
            return ScaledNetworks(core, scaling, settings.noise)
        learned = networks_from(read_weights(settings.start)).to(settings.device)
        return ScaledNetworks.wrapping(learned, scaling, settings.noise)

    def losses(self) -> dict[str, Tensor]:
        """Losses of a random batch of windows, with the weights of the run's present step."""
        settings = self.settings
        windows = self.learned.draw(
            settings.windows, settings.frames, settings.variation, self.random
        )
        progress = self.step / settings.steps
        own = (progress - settings.own_from) / max(settings.own_until - settings.own_from, 1e-9)
        chance = 1 - min(max(own, 0.0), 1.0)
        draws = torch.rand(settings.frames - 1, generator=self.random)
        found, target = unroll(self.networks, windows, draws < chance, self.random, half=True)
        losses = loss_terms(found, target, windows)
        annealed = min(1.0, progress / max(settings.kl_until, 1e-9))
        return losses | {"total": total_loss(losses, annealed, settings.losses)}

    def errors(self) -> dict[str, float]:
        """Losses of the averaged networks on held-out people."""
        return validate(self.averaged, self.checked, self.settings.losses)


@torch.no_grad()
def validate(
    networks: ScaledNetworks, windows: StateWindows, weights: LossWeights
) -> dict[str, float]:
    """Losses with mean latents and full weights, from true states and from predicted states.

    `drift_cm` is the mean error of the posed joints after the window's last own step.
    """
    row: dict[str, float] = {}
    steps = windows.contacts.shape[1] - 1
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
    return row | {"score": row["one_total"] + row["own_total"]}


def train(settings: HumorTraining) -> Path:
    """Train, or resume training; returns the path of the checkpoint.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when no clip may be learned from, or the folder holds another run.
    """
    with logged_in_folder(settings):
        body = BodyModel.load()
        learned = held_out = Corpus.load(settings, "train", body)
        if any(True for _ in settings.stretches_that_teach("validation", "steps")):
            held_out = Corpus.load(settings, "validation", body)
        else:
            LOG.warning(
                "no validation clip teaches steps: the validation losses of this run are those of "
                "its training clips"
            )
        return HumorRun(settings, learned, held_out).train_to_end()


def export_weights(settings: HumorTraining, path: Path, samples: int = 20_000) -> Path:
    """Write the best networks of a run, with the mixture of initial states of its corpus.

    Args:
        settings: of the run.
        path: weights to write (.safetensors).
        samples: windows from which the mixture and the decoder's errors are learned.

    Raises:
        FileNotFoundError: when the run has not validated yet, or there is no corpus.
    """
    found = trained_state(settings.out / BEST)
    scaled = ScaledNetworks(HumorNetworks(settings.width), Scaling.identity())
    scaled.load_state_dict(found["averaged"])
    networks = scaled.unscaled_networks()

    learned = Corpus.load(settings, "train", BodyModel.load())
    random = torch.Generator().manual_seed(settings.seed)
    varied = learned.draw(samples, 2, settings.variation, random).states
    whitening = error_whitening(networks, varied, rest_pelvis(varied[:, 0]))
    # initial states come from unedited windows only: edited ones float or stand on one leg
    states = learned.draw(samples, 2, Variation(), random).states[:, 0]
    features = initial_features(canonical_state(states, rest_pelvis(states)))
    initial = fitted_mixture(features, independent_features(), seed=settings.seed)

    about = settings_to_store(settings) | {"step": found["step"]}
    save_humor(path, networks, initial, whitening, about)
    LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path


_SHRINKAGE = 0.05
"""Share by which variances of errors are raised, so that directions of almost no variance do not
count without end."""


def fitted_mixture(
    samples: Float[Tensor, "samples numbers"],
    features: Int[Tensor, " features"],
    components: int = 12,
    regularisation: float = 1e-4,
    seed: int = 0,
) -> Mixture:
    """Fit a mixture of Gaussians by expectation maximisation, from k-means (HuMoR, section 4).

    Args:
        samples: rows of all numbers.
        features: those to model.
        components: Gaussians.
        regularisation: added to every variance; 1e-4 is a centimetre, or 1 cm/s, squared.
        seed: of the k-means start.
    """
    from sklearn.mixture import GaussianMixture

    mixture = GaussianMixture(
        components, reg_covar=regularisation, max_iter=200, random_state=seed
    )
    mixture.fit(samples[:, features].double().cpu().numpy())
    return Mixture.create(
        torch.from_numpy(mixture.weights_),
        torch.from_numpy(mixture.means_),
        torch.from_numpy(mixture.covariances_),
        features,
    )


def error_whitening(
    networks: HumorNetworks, states: State, pelvis: Float[Tensor, "clips 3"]
) -> Float[Tensor, "207 207"]:
    """Whitening matrix U of the decoder's errors: C⁻¹ = U Uᵀ for their covariance C about zero."""
    with torch.no_grad():
        errors = posterior_outputs(networks, states, pelvis).error.flatten(0, 1).double()
    covariance = errors.mT @ errors / len(errors)
    covariance = covariance + _SHRINKAGE * torch.diag(covariance.diagonal() + 1e-9)
    factor = torch.linalg.cholesky(covariance)
    identity = torch.eye(len(factor), dtype=factor.dtype)
    return torch.linalg.solve_triangular(factor, identity, upper=False).mT.contiguous()


if __name__ == "__main__":
    run_by_options(HumorTraining, train, export_weights)
