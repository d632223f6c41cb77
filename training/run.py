"""A training run: one loop for all priors, with a folder from which it can be resumed.

A prior's own run (`training.humor.train`, `training.anchor.train`, ...) says which networks learn,
what they lose on a batch, and how wrong they are about held-out people.
"""

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, TypeVar

import torch
from torch import Tensor, nn

from recon.formats.replacing import replacing, write_text
from training.settings import LOG as LOG
from training.settings import TrainingSettings, identity_of_run, plain_settings, refuse_other_run


@contextmanager
def logged_to(path: Path, mode: Literal["a", "w"]) -> Iterator[None]:
    """Context manager that also writes log messages to a file, each line with its time."""
    log = logging.FileHandler(path, mode=mode)
    log.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    before = LOG.level
    LOG.addHandler(log)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(log)
        LOG.setLevel(before)
        log.close()


@contextmanager
def logged_in_folder(settings: TrainingSettings) -> Iterator[None]:
    """Make the folder of a run, and write its log there, which begins with its settings."""
    settings.out.mkdir(parents=True, exist_ok=True)
    with logged_to(settings.out / "train.log", "a"):
        LOG.info("settings: %s", settings)
        yield


def write_losses(
    folder: Path, rows: Sequence[dict[str, float]], panels: Sequence[Sequence[str]]
) -> None:
    """Write `losses.csv` (one line per row) and `losses.png` (one panel per group of columns).

    Args:
        folder: of the run.
        rows: with equal columns, among them `step`.
        panels: columns drawn together, on a logarithmic scale.
    """
    columns = list(rows[0])
    lines = [",".join(columns)]
    lines += [",".join(f"{row[column]:.6g}" for column in columns) for row in rows]
    write_text(folder / "losses.csv", "\n".join(lines) + "\n")
    _plot_losses(rows, panels, folder / "losses.png")


def _plot_losses(
    rows: Sequence[dict[str, float]], panels: Sequence[Sequence[str]], path: Path
) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, names in zip(figure.subplots(1, len(panels)), panels, strict=True):
        for name in names:
            axes.plot([row["step"] for row in rows], [row[name] for row in rows], label=name)
        axes.set_yscale("log")
        axes.set_xlabel("step")
        axes.legend()
    with replacing(path) as beside:
        figure.savefig(beside, format="png", dpi=100)


CHECKPOINT, BEST = "checkpoint.pt", "best.pt"
"""Files in the folder of a run: from which it goes on, and the networks of the lowest score."""

S = TypeVar("S", bound=TrainingSettings)
N = TypeVar("N", bound=nn.Module)


class Run(Generic[S, N]):
    """A training run: networks, optimiser and random state, resumable exactly."""

    panels: ClassVar[Sequence[Sequence[str]]]
    """Losses that are drawn together."""
    keeps_best: ClassVar[bool] = False
    """Whether the networks of the lowest `score` are kept; else the last ones are the result."""
    betas: ClassVar[tuple[float, float]] = (0.9, 0.999)
    """Shares of gradients and of their squares that AdamW keeps in every step."""
    warm_up_steps: ClassVar[int] = 1
    """Steps over which the learning rate rises at the beginning of every part of a run."""

    def __init__(self, settings: S) -> None:
        """Prepare a new run, or load the checkpoint if the folder has one.

        Raises:
            ValueError: when another run wrote it.
        """
        torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        self.settings, self.identity = settings, identity_of_run(settings)
        self.random = torch.Generator().manual_seed(settings.seed)
        """Draws the batches; dropout and blur draw from torch's own generator."""
        self.step = 0
        self.rows: list[dict[str, float]] = []
        """Losses, one row for every validation."""
        self.sums: dict[str, Tensor | float] = {}
        """Sums of the training losses since the last row."""
        path = settings.out / CHECKPOINT
        state = read_state(path)
        if state is not None:
            refuse_other_run(path, self.identity, state.get("identity"))
        self.networks = self.untrained_networks(state)
        self.averaged = deepcopy(self.networks).requires_grad_(False).eval()
        """The average of the networks' weights over time, which is the result of the run."""
        self.optimiser = self.optimiser_of(self.networks)
        if state is not None:
            self.resume(state)

    def untrained_networks(self, state: Mapping[str, Any] | None) -> N:
        """Make the networks as before the first step; a checkpoint's weights are loaded later."""
        raise NotImplementedError

    def losses(self) -> dict[str, Tensor]:
        """Compute the losses of a random batch by name; `total` is minimised."""
        raise NotImplementedError

    def errors(self) -> dict[str, float]:
        """Errors of the averaged networks on held-out data by name, among them `score`, if any."""
        raise NotImplementedError

    def optimiser_of(self, networks: N) -> torch.optim.Optimizer:
        """The optimiser."""
        rate, decay = self.settings.rate, self.settings.decay
        return torch.optim.AdamW(
            networks.parameters(), rate, self.betas, weight_decay=decay, fused=True
        )

    @property
    def steps_and_rates(self) -> tuple[tuple[int, float], ...]:
        """Steps and learning rate of every part of the run, one after the other."""
        return ((self.settings.steps, self.settings.rate),)

    def further_state(self) -> dict[str, Any]:
        """Entries that a prior adds to a run's checkpoint, besides weights and losses."""
        return {}

    def resume(self, state: Mapping[str, Any]) -> None:
        """Load the networks, optimiser and random state of a checkpoint of this run."""
        self.networks.load_state_dict(state["networks"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.random.set_state(state["random"])
        torch.set_rng_state(state["torch_random"])
        self.step, self.rows, self.sums = state["step"], state["rows"], state["sums"]

    def save(self) -> None:
        """Write the checkpoint atomically: a killed run leaves the old file or the new one."""
        self._write_state(
            CHECKPOINT,
            settings=plain_settings(self.settings),
            identity=self.identity,
            networks=self.networks.state_dict(),
            optimiser=self.optimiser.state_dict(),
            random=self.random.get_state(),
            torch_random=torch.get_rng_state(),
            rows=self.rows,
            sums={name: float(value) for name, value in self.sums.items()},
        )

    def _write_state(self, name: str, **state: Any) -> None:
        state |= {
            "averaged": self.averaged.state_dict(),
            "step": self.step,
            **self.further_state(),
        }
        with replacing(self.settings.out / name) as beside:
            torch.save(state, beside)

    def train_to_end(self) -> Path:
        """Train to the end; returns the path of the checkpoint."""
        settings, steps = self.settings, sum(length for length, _ in self.steps_and_rates)
        LOG.info("from step %d of %d", self.step, steps)
        saved = began = time.monotonic()
        first = self.step
        while self.step < steps:
            losses = self.losses()
            self.descend(losses["total"], self.rate())
            for name, value in losses.items():
                self.sums[name] = self.sums.get(name, 0.0) + value.detach()
            last = self.step == steps
            if self.step % settings.validate_every == 0 or last:
                self._log_and_validate((self.step - first) / (time.monotonic() - began))
                first, began = self.step, time.monotonic()
            if time.monotonic() - saved > settings.save_every or last:
                self.save()
                saved = time.monotonic()
        return settings.out / CHECKPOINT

    def rate(self) -> float:
        """The learning rate of the next step: each part warms up and falls along a cosine."""
        here = self.step
        for length, most in self.steps_and_rates:
            if here < length:
                return (
                    most * cosine_decay(here / length) * min(1.0, (here + 1) / self.warm_up_steps)
                )
            here -= length
        return 0.0

    def descend(self, loss: Tensor, rate: float) -> None:
        """Take an optimiser step on a loss; skip it where the gradient is not finite."""
        self.optimiser.zero_grad()
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.networks.parameters(), self.settings.clip)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        if bool(norm.isfinite()):
            self.optimiser.step()
        self.step += 1
        keep = min(self.settings.average, self.step / (self.step + 10))
        pairs = zip(self.averaged.parameters(), self.networks.parameters(), strict=True)
        with torch.no_grad():
            for mean, now in pairs:
                mean.lerp_(now, 1 - keep)

    def _log_and_validate(self, pace: float) -> None:
        """Log, save and plot a row of mean training losses and validation errors."""
        count = (self.step - 1) % self.settings.validate_every + 1
        row = {f"train_{name}": float(value) / count for name, value in self.sums.items()}
        row |= self.errors()
        self.sums = {}
        self.rows.append({"step": float(self.step), **row})
        shown = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
        LOG.info("step %d, %.1f steps/s: %s", self.step, pace, shown)
        write_losses(self.settings.out, self.rows, self.panels)
        if self.keeps_best and row["score"] == min(row["score"] for row in self.rows):
            self._write_state(BEST)


def cosine_decay(progress: float) -> float:
    """Factor of a learning rate that falls from 1 to a hundredth as progress goes from 0 to 1."""
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress))


def read_state(path: Path) -> dict[str, Any] | None:
    """Read the state stored in a file of a run; None if there is no such file."""
    if not path.is_file():
        return None
    return torch.load(path, weights_only=True, map_location="cpu")


def trained_state(path: Path) -> dict[str, Any]:
    """Read the state that a run has written, from which its networks are exported.

    Raises:
        FileNotFoundError: when it has not.
    """
    found = read_state(path)
    if found is None:
        raise FileNotFoundError(f"{path}: no networks there yet; train first")
    return found


def run_by_options(
    kind: type[S], train: Callable[[S], Path], export_weights: Callable[[S, Path], Path]
) -> None:
    """Train with settings from the command line, or with `--export` write the best weights so far.

    Args:
        kind: class of the settings, each of whose fields is an option.
        train: trains, or resumes training.
        export_weights: writes the best networks of a run to a file.
    """
    import tyro

    def main(settings: Any, export: Path | None = None) -> None:
        """Train; or write the best weights so far.

        Args:
            settings: of the run.
            export: weights to write (.safetensors) instead of training.
        """
        if export is None:
            train(settings)
        else:
            export_weights(settings, export)

    main.__annotations__["settings"] = kind
    logging.basicConfig(level=logging.INFO)
    tyro.cli(main, config=(tyro.conf.OmitArgPrefixes,))
