"""Settings of a training run in its files, and whether a folder holds that same run."""

import dataclasses
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import torch
from torch import nn

from recon.benchmark.dataset import clip_files
from recon.formats.opening import replacing
from recon.formats.replacing import file_checksum, files_checksum

FREE = ("out", "threads", "save_every", "device")
"""Settings that may change while a run goes on: where it is written, and how fast it goes."""
_CONTENTS = "sha256:"


def plain(settings: Any) -> dict[str, Any]:
    """A dataclass of settings as JSON holds it."""
    return {name: _plain(value) for name, value in dataclasses.asdict(settings).items()}


def told_settings(settings: Any) -> dict[str, Any]:
    """The settings of a run that a weights file tells: all but places on the trainer's disk."""
    return {
        k: v for k, v in plain(settings).items() if k not in ("corpus", "out", "splits", "warm")
    }


def identity(settings: Any) -> dict[str, Any]:
    """All that decides what a run learns: its settings, and the contents of the files they name.

    A folder counts by the motions and notes of its corpus, another file by its bytes, wherever
    they lie. Where a run is written and how fast it goes (`FREE`) is no part of it.

    Raises:
        FileNotFoundError: when a file that is named is not there.
        ValueError: when a folder holds no corpus.
    """
    found = plain(settings)
    for one in dataclasses.fields(settings):
        value = getattr(settings, one.name)
        if isinstance(value, Path) and one.name not in FREE:
            found[one.name] = _contents(value)
    return {name: value for name, value in found.items() if name not in FREE}


def same_run(path: Path, own: dict[str, Any], found: dict[str, Any] | None) -> None:
    """Refuse to go on with a checkpoint of a run that learns something else.

    Args:
        path: of the checkpoint, for the message.
        own: `identity` of the run that is asked for.
        found: the one in the checkpoint; None where an older version wrote none.

    Raises:
        ValueError: when they differ; the message says in what.
    """
    if found is None:
        raise ValueError(
            f"{path}: an older version wrote this checkpoint without saying what it learned "
            "from, so it cannot be continued; take another folder"
        )
    names = [name for name in (own | found) if not _same(own.get(name), found.get(name))]
    if len(names) > 0:
        said = [_difference(name, found.get(name), own.get(name)) for name in names]
        raise ValueError(
            f"{path}: a run with other {', '.join(said)}; take another folder, or the settings "
            "and files of that run"
        )


def _same(here: Any, there: Any) -> bool:
    """Whether a setting is the same; a part that is zero counts as one that is not there.

    Parts that are added to a group of settings, such as a new variation, are zero where nothing
    changes, and checkpoints from before them hold the same run.
    """
    if isinstance(here, dict) and isinstance(there, dict):
        return all(here.get(name, 0) == there.get(name, 0) for name in here | there)
    return here == there


def _difference(name: str, there: Any, here: Any) -> str:
    if any(isinstance(value, str) and value.startswith(_CONTENTS) for value in (there, here)):
        return f"{name} (its contents differ)"
    return f"{name} ({there} there, {here} here)"


def _contents(path: Path) -> str:
    if not path.is_dir():
        return _CONTENTS + file_checksum(path)
    motions = clip_files(path).values()
    notes = [motion.with_suffix(".json") for motion in motions]
    return _CONTENTS + files_checksum([*motions, *(n for n in notes if n.is_file())], path)


def _plain(value: Any) -> Any:
    match value:
        case Path():
            return str(value)
        case Enum():
            return value.value
        case tuple():
            return list(value)
        case _:
            return value


@contextmanager
def logged_to(path: Path, mode: Literal["a", "w"]) -> Iterator[None]:
    """A context in which messages of `training` also go to a file, each line with its time."""
    log = logging.FileHandler(path, mode=mode)
    log.setFormatter(logging.Formatter("%(asctime)s %(message)s"))
    package = logging.getLogger("training")
    before = package.level
    package.addHandler(log)
    package.setLevel(logging.INFO)
    try:
        yield
    finally:
        package.removeHandler(log)
        package.setLevel(before)
        log.close()


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
    with replacing(folder / "losses.csv") as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8")
    _draw(rows, panels, folder / "losses.png")


def _draw(rows: Sequence[dict[str, float]], panels: Sequence[Sequence[str]], path: Path) -> None:
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
