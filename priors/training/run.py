"""A training run on disk: what it goes on from, its losses, and the loop over its steps."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import nn

from priors.training.curves import write_losses
from priors.training.run_settings import identity, plain, same_run
from recon.formats.files.opening import replacing

CHECKPOINT = "checkpoint.pt"
"""File in the folder of a run from which the run goes on."""

N = TypeVar("N", bound=nn.Module)


@dataclass
class Run(Generic[N]):
    """All that a training run needs to go on exactly where it was."""

    settings: Any
    """The prior's settings; they name the folder of the run as `out`."""
    networks: N
    averaged: N
    """The average of the networks' weights over time, which is the result of the run."""
    optimiser: torch.optim.Optimizer
    random: torch.Generator
    """Generator that draws the batches; dropout and blur draw from torch's own."""
    identity: dict[str, Any]
    """What the run learns and from which contents; a checkpoint of another is refused."""
    step: int = 0
    rows: list[dict[str, float]] = field(default_factory=list)
    """Losses, one row for every validation."""
    sums: dict[str, float] = field(default_factory=dict)
    """Sums of the training losses since the last row."""

    @classmethod
    def of(cls, settings: Any, networks: N, random: torch.Generator, **optimiser: Any) -> "Run[N]":
        """A run before its first step, with AdamW at the rate of the settings."""
        return cls(
            settings=settings,
            networks=networks,
            averaged=deepcopy(networks).requires_grad_(False).eval(),
            optimiser=torch.optim.AdamW(
                networks.parameters(), lr=settings.rate, fused=True, **optimiser
            ),
            random=random,
            identity=identity(settings),
        )

    def resume(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint.

        Raises:
            ValueError: when another run wrote it.
        """
        same_run(self.settings.out / CHECKPOINT, self.identity, state.get("identity"))
        self.networks.load_state_dict(state["networks"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.random.set_state(state["random"])
        torch.set_rng_state(state["torch_random"])
        self.step, self.rows, self.sums = state["step"], state["rows"], state["sums"]

    def save(self, **more: Any) -> None:
        """Write the checkpoint in one step, with what else the prior's run goes on from."""
        state = {
            "settings": plain(self.settings),
            "identity": self.identity,
            "networks": self.networks.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": self.random.get_state(),
            "torch_random": torch.get_rng_state(),
            "step": self.step,
            "rows": self.rows,
            "sums": self.sums,
        }
        self.keep(CHECKPOINT, **state, **more)

    def keep(self, name: str, **state: Any) -> None:
        """Write a file of the run in one step."""
        with replacing(self.settings.out / name) as beside:
            torch.save(state, beside)

    def note(self, row: Mapping[str, float], panels: Sequence[Sequence[str]]) -> None:
        """Remember losses, and write all of them as a table and as curves."""
        self.rows.append({"step": float(self.step), **row})
        write_losses(self.settings.out, self.rows, panels)

    @property
    def best(self) -> bool:
        """Whether no row has a lower score than the last one."""
        return self.rows[-1]["score"] == min(row["score"] for row in self.rows)


def read_state(path: Path) -> dict[str, Any] | None:
    """A file of a run, or None where there is none."""
    if not path.is_file():
        return None
    return torch.load(path, weights_only=True, map_location="cpu")


def trained_state(path: Path) -> dict[str, Any]:
    """A file that a run must have written before its networks can be exported.

    Raises:
        FileNotFoundError: when it has not.
    """
    found = read_state(path)
    if found is None:
        raise FileNotFoundError(f"{path}: no networks there yet; train first")
    return found


def run_steps(
    run: Run[Any],
    steps: int,
    one_step: Callable[[], Mapping[str, float]],
    check: Callable[[], Mapping[str, float]],
    note: Callable[[dict[str, float]], None],
    save: Callable[[], None],
    log: logging.Logger,
) -> Path:
    """Train up to a number of steps; the checkpoint's path.

    Args:
        run: whose settings say how often to validate and to save.
        steps: of the whole run.
        one_step: makes a step and returns its losses by name.
        check: errors of the averaged networks on held-out data, by name.
        note: remembers a row of training losses (`train_...`) and errors.
        save: writes the checkpoint.
        log: is told every row.
    """
    settings = run.settings
    saved = began = time.monotonic()
    first = run.step
    while run.step < steps:
        for name, value in one_step().items():
            run.sums[name] = run.sums.get(name, 0.0) + value
        last = run.step == steps
        if run.step % settings.validate_every == 0 or last:
            count = (run.step - 1) % settings.validate_every + 1
            row = {f"train_{name}": value / count for name, value in run.sums.items()}
            row |= check()
            note(row)
            shown = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
            pace = (run.step - first) / (time.monotonic() - began)
            log.info("step %d, %.1f steps/s: %s", run.step, pace, shown)
            run.sums, first, began = {}, run.step, time.monotonic()
        if time.monotonic() - saved > settings.save_every or last:
            save()
            saved = time.monotonic()
    return settings.out / CHECKPOINT
