"""Training of the HUMOS prior: an auto-encoder first, then from one body to another and back."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from priors.humos.frames import BodyFrames, LappedBasis, cut_windows
from priors.humos.networks import CodeDensity, HumosWeights, WindowNetworks
from recon.body.model import BodyModel
from training.humos.corpus import BodyBatch, BodyCorpus, BodyVariation
from training.humos.losses import (
    clearance_error,
    code_divergence,
    encoded_motions,
    feature_error,
    mean_joint_distance_cm,
    physics_losses,
    reconstruction_error,
)
from training.run import CHECKPOINT, LOG, Run, logged_in_folder, trained_state
from training.settings import TrainingSettings, settings_to_store
from training.weights import save_humos

_HELD_OUT = 48
"""Windows that validation looks at."""
_GROUND, _SLIDE, _BALANCE, _BOUNCE = 0.002, 0.0007, 0.05, 0.002
"""Metres of penetration and float, of a sole's step, of imbalance, and of a second difference of
the pelvis' height, that cost ½."""
_BASIS_FRAMES, _BASIS_WINDOWS = 64, 256
"""Frames of the windows from which the directions are taken, and windows drawn at once."""
_DENSITY_WINDOWS, _DENSITY_DRAWS = 64, 32
"""Windows drawn at once, and draws, of the codes whose density is exported."""
_SPREAD = BodyVariation(shape=0.2)
"""Random variations of these windows."""


@dataclass(frozen=True)
class HumosTraining(TrainingSettings):
    """Settings of a training run of HUMOS."""

    warm_steps: int = 1500
    """Steps of the auto-encoder before there is another body."""
    steps: int = 1200
    """Steps from one body to another and back."""
    cycle_rate: float = 3e-4
    """Learning rate of the second part."""
    clips: int = 16
    """Windows per step."""
    frames: int = 128
    """Frames of a window; the networks know distances in time only, and work on any length."""
    physics_frames: int = 40
    """Consecutive frames of each window on which the physics losses are computed."""
    validate_every: int = 100
    latent: int = 96
    """Numbers of the code of a window; 320 are published for a whole clip."""
    basis: int = 256
    """Principal directions of windows that the networks see and make motions of."""
    basis_from: int = 3072
    """Varied stretches from which the directions are taken."""
    width: int = 256
    """Numbers per window inside the transformers."""
    layers: int = 3
    """Layers of each transformer."""
    dropout: float = 0.05
    """Share of hidden numbers left out."""
    kl: float = 0.02
    """Weight of the mean divergence per number of a code."""
    same_code: float = 0.1
    """Weight of the squared distance of the codes of a motion and of its copy (L_E)."""
    variation: BodyVariation = field(default_factory=BodyVariation)
    """Random variations of the windows."""
    speeds: tuple[float, ...] = (0.87, 1.0, 1.15)
    """Every clip is learned at each."""

    def __post_init__(self) -> None:
        """Check the settings before a corpus is read."""
        if self.latent > self.basis:
            raise ValueError(
                f"latent: expected at most basis, {self.basis} principal directions, got "
                f"{self.latent}; give a smaller latent or a larger basis"
            )
        for name in ("latent", "basis", "width", "layers", "clips", "frames", "physics_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")


class HumosRun(Run[HumosTraining, WindowNetworks]):
    """A training run."""

    panels = (
        ("train_total",),
        ("joint_cm", "cycle_joint_cm", "clearance_cm"),
        ("slide", "ground", "balance", "bounce"),
    )
    warm_up_steps = 100

    def __init__(self, settings: HumosTraining, learned: BodyCorpus, checked: BodyCorpus) -> None:
        self.learned = learned
        random = torch.Generator().manual_seed(0)
        self.checked = checked.all_windows(settings.frames, _HELD_OUT, random)
        super().__init__(settings)

    @property
    def steps_and_rates(self) -> tuple[tuple[int, float], ...]:
        """Steps and learning rate of the run's two parts: auto-encoder, then transfer and back."""
        settings = self.settings
        return ((settings.warm_steps, settings.rate), (settings.steps, settings.cycle_rate))

    def untrained_networks(self, state: Mapping[str, Any] | None) -> WindowNetworks:
        """Networks initialised by principal directions of windows, or for loading a checkpoint."""
        basis = self._basis() if state is None else LappedBasis(**state["basis"])
        return networks_of(self.settings, basis, self.learned)

    def _basis(self) -> LappedBasis:
        settings = self.settings
        rows = [
            self.learned.draw(
                _BASIS_WINDOWS, _BASIS_FRAMES, settings.variation, self.random
            ).frames.pack()
            for _ in range(-(-settings.basis_from // _BASIS_WINDOWS))
        ]
        return fitted_basis(torch.cat(rows), settings.basis)

    def further_state(self) -> dict[str, Any]:
        """Entries of a checkpoint for the principal directions, which are not trained."""
        return {"basis": self.networks.basis.tensors()}

    def losses(self) -> dict[str, Tensor]:
        """Reconstruction and divergence; in part two also transfer to a body and back."""
        settings, networks, body = self.settings, self.networks.train(), self.learned.body
        frames = settings.frames
        batch = self.learned.draw(settings.clips, frames, settings.variation, self.random)
        exists = batch.windows_exist
        codes = encoded_motions(networks, batch.frames.pack(), batch.shape, exists, self.random)
        same = networks.decode(codes.drawn, batch.shape, exists, frames)
        total = reconstruction_error(same, batch, body) + settings.kl * code_divergence(
            codes, exists
        )
        if self.step < settings.warm_steps:
            return {"total": total}
        made = networks.decode(codes.drawn, batch.other, exists, frames)
        again = encoded_motions(networks, made, batch.other, exists, self.random)
        back = networks.decode(again.drawn, batch.shape, exists, frames)
        apart = (codes.mean - again.mean).square().mean()
        total = total + feature_error(back, batch) + settings.same_code * apart
        total = total + settings.kl * code_divergence(again, exists)
        room = frames - settings.physics_frames
        first = int(torch.randint(room + 1, (1,), generator=self.random))
        some = slice(first, first + settings.physics_frames)
        found = physics_losses(made[:, some], _cut_frames(batch, some), body)
        physics = found.ground / _GROUND**2 + found.slide / _SLIDE**2 + found.bounce / _BOUNCE**2
        return {"total": total + physics + found.balance / _BALANCE**2}

    @torch.no_grad()
    def errors(self) -> dict[str, float]:
        """Errors on held-out people, also after transfer and back; physics on other bodies."""
        networks, checked, body = self.averaged, self.checked, self.learned.body
        frames, exists = self.settings.frames, checked.windows_exist
        codes = encoded_motions(networks, checked.frames.pack(), checked.shape, exists, None)
        same = networks.decode(codes.mean, checked.shape, exists, frames)
        made = networks.decode(codes.mean, checked.other, exists, frames)
        again = encoded_motions(networks, made, checked.other, exists, None)
        back = networks.decode(again.mean, checked.shape, exists, frames)
        physics = physics_losses(made, checked, body)
        here, there, ours = (BodyFrames.unpack(rows) for rows in (same, made, back))
        return {
            "reconstruction": float(reconstruction_error(same, checked, body)),
            "joint_cm": mean_joint_distance_cm(here, checked.frames, checked, body),
            "cycle_joint_cm": mean_joint_distance_cm(ours, checked.frames, checked, body),
            "clearance_cm": clearance_error(same, checked),
            "changed_cm": mean_joint_distance_cm(there, here, checked, body),
            "ground": float(physics.ground) * 1e4,
            "slide": float(physics.slide) * 1e4,
            "balance": float(physics.balance) * 1e4,
            "bounce": float(physics.bounce) * 1e4,
            "kl": float(code_divergence(codes, exists)),
        }


def train(settings: HumosTraining) -> Path:
    """Train, or resume training; returns the path of the checkpoint.

    Raises:
        FileNotFoundError: when there is no corpus or splits file.
        ValueError: when there is no clip to learn from, or the folder holds another run.
    """
    with logged_in_folder(settings):
        body = BodyModel.load()
        learned = BodyCorpus.load(settings, "train", body, settings.speeds)
        return HumosRun(
            settings, learned, BodyCorpus.load(settings, "validation", body)
        ).train_to_end()


def export_weights(settings: HumosTraining, path: Path) -> Path:
    """Write the networks of a run, with the density of their codes on the training clips.

    Raises:
        FileNotFoundError: when the run has no checkpoint yet, or there is no corpus.
    """
    found = trained_state(settings.out / CHECKPOINT)
    learned = BodyCorpus.load(settings, "train", BodyModel.load())
    networks = networks_of(settings, LappedBasis(**found["basis"]), learned)
    networks.load_state_dict(found["averaged"])
    networks.eval().requires_grad_(False)
    weights = HumosWeights(
        networks, _density_of_codes(settings, networks, learned), settings.frames
    )
    about = settings_to_store(settings) | {"shape": weights.shape, "step": found["step"]}
    save_humos(path, weights, about)
    LOG.info("wrote the networks of step %d as %s", found["step"], path)
    return path


def networks_of(
    settings: HumosTraining, basis: LappedBasis, learned: BodyCorpus
) -> WindowNetworks:
    """Build untrained networks of the settings' sizes, for the bodies of a corpus."""
    return WindowNetworks(
        basis, settings.latent, learned.shape.shape[1], settings.width, settings.layers,
        settings.dropout,
    )  # fmt: skip


def _density_of_codes(
    settings: HumosTraining, networks: WindowNetworks, learned: BodyCorpus
) -> CodeDensity:
    """Fit the density of the training clips' codes, each conditioned on the previous one."""
    random = torch.Generator().manual_seed(settings.seed)
    codes, variances, before, after = [], [], [], []
    for _ in range(_DENSITY_DRAWS):
        batch = learned.draw(_DENSITY_WINDOWS, settings.frames, _SPREAD, random)
        exists = batch.windows_exist
        found = encoded_motions(networks, batch.frames.pack(), batch.shape, exists, None)
        codes.append(found.mean[exists])
        variances.append(found.log_variance.exp()[exists])
        both = exists[:, 1:] & exists[:, :-1]
        before.append(found.mean[:, :-1][both])
        after.append(found.mean[:, 1:][both])
    return fitted_codes(
        torch.cat(codes), torch.cat(variances).mean(0), (torch.cat(before), torch.cat(after))
    )


def _cut_frames(batch: BodyBatch, some: slice) -> BodyBatch:
    frames = batch.frames.map(lambda rows: rows[:, some])
    return batch.replace(frames=frames, height=batch.height[:, some], valid=batch.valid[:, some])


_MEMORY = 0.98
"""Most that any direction of a code keeps to the next."""


def fitted_basis(rows: Float[Tensor, "clips time numbers"], basis: int) -> LappedBasis:
    """Fit the linear basis of windows to stretches of motion (principal components).

    Raises:
        ValueError: when there are fewer windows than directions asked for.
    """
    windows = cut_windows(rows)[:, 1:-1].flatten(0, 1)
    if len(windows) <= basis:
        raise ValueError(
            f"expected more windows than the {basis} principal directions, got {len(windows)}"
        )
    mean = windows.mean(0)
    away = (windows - mean).double()
    values, vectors = torch.linalg.eigh(away.mT @ away / (len(windows) - 1))
    deviation = values.flip(0)[:basis].clamp(min=0).sqrt().float()
    return LappedBasis(mean, vectors.flip(1).mT[:basis].float().contiguous(), deviation)


def fitted_codes(
    codes: Float[Tensor, "codes latent"], variance: Float[Tensor, " latent"],
    pairs: tuple[Float[Tensor, "pairs latent"], Float[Tensor, "pairs latent"]],
) -> CodeDensity:  # fmt: skip
    """Fit the density of code sequences to posteriors of recorded motions.

    Stationary: rest restᵀ = I - follow followᵀ, so that u has unit variance at any time.

    Args:
        codes: means of posteriors.
        variance: their mean variances.
        pairs: neighbouring codes, earlier and later.
    """
    mean = codes.double().mean(0)
    away = codes.double() - mean
    noise = variance.double().diag()
    root = torch.linalg.cholesky(away.mT @ away / (len(codes) - 1) + noise)
    size = len(mean)
    follow, rest = torch.zeros(size, size), torch.eye(size)
    if len(pairs[0]) > size:
        before, after = (
            torch.linalg.solve_triangular(root, (p.double() - mean).mT, upper=False).mT
            for p in pairs
        )
        # regression of whitened codes on the previous ones; no singular value may be 1 or more
        left, lengths, right = torch.linalg.svd(after.mT @ before / len(before))
        follow = (left * lengths.clamp(max=_MEMORY)) @ right
        rest = torch.linalg.cholesky(torch.eye(size, dtype=torch.float64) - follow @ follow.mT)
    return CodeDensity(mean.float(), root.float(), follow.float(), rest.float())
