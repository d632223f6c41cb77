"""Code that benchmarks share: listed windows, means with intervals, and tables with sources.

A table is a file of aggregates in `benchmarks/results`: the run that measured it (`about`:
command, commit, date, seed, data, versions, machine), its columns with their digits, and its rows.
A cell is a number, a mean with the ends of its 95 % interval, a text, or null. `python -m
benchmarks.tables` writes it into the documents.
"""

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch

import recon
from recon import Motion
from recon.benchmark.dataset import SPLITS, Splits
from recon.benchmark.table import MeanWithInterval, mean_with_interval
from recon.benchmark.windows import FRAMES, TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.formats.replacing import files_checksum, write_text

ROOT = Path(__file__).parents[1]
"""Folder of the source checkout."""
RESULTS = Path(__file__).parent / "results"
"""Folder of the committed tables."""
NINE_TENTHS = 1.645
"""Number of standard deviations within which 90 % of normal errors lie."""
DASH = "–"
"""Text of a cell without a value."""

Cell = float | int | str | None | list[float]
Sources = Mapping[str, tuple[Path, Iterable[Path]]]
"""Data that a table was measured on: its name in commands, its folder, and the files read."""
Metrics = Mapping[str, tuple[str, float, int]]
"""Columns by metric: heading, factor from SI units to the heading's unit, and digits."""


@dataclass(frozen=True)
class Table:
    """Aggregates of one or several runs, as documents show them."""

    columns: Sequence[tuple[str, int | None]]
    """Headings, and digits of numbers (None for text); the first column has the rows' names."""
    rows: Sequence[Sequence[Cell]]
    about: Sequence[Mapping[str, Any]] = ()
    """A record of every run that measured the table; see `about`."""
    note: str = ""
    """Text below the table."""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"a row has not {len(self.columns)} cells: {self.rows}")

    @classmethod
    def read(cls, path: Path) -> "Table":
        """Read a table file."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))

    def write(self, path: Path) -> None:
        """Write a table file, one row a line."""
        parts: dict[str, Any] = {"about": self.about, "columns": self.columns}
        parts |= {"note": self.note} if self.note else {}
        said = [
            f' "{key}": {_lines(value)}' for key, value in {**parts, "rows": self.rows}.items()
        ]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, "{\n" + ",\n".join(said) + "\n}\n")

    def markdown(self) -> str:
        """Return the table as Markdown, with its note and the source of its numbers."""
        digits = [own for _, own in self.columns]
        lines: list[list[str]] = [[heading for heading, _ in self.columns]]
        lines.append(["---", *["--:"] * (len(self.columns) - 1)])
        lines += [[shown(c, d) for c, d in zip(row, digits, strict=True)] for row in self.rows]
        parts = ["\n".join(f"| {' | '.join(line)} |" for line in lines), self.note]
        if self.about:
            parts.append(
                f"*Measured by {' and by '.join(dict.fromkeys(map(_source, self.about)))}.*"
            )
        return "\n\n".join(part for part in parts if part)


def shown(cell: Cell, digits: int | None) -> str:
    """Format a cell for the documents."""
    if cell is None:
        return DASH
    if isinstance(cell, str) or digits is None:
        return str(cell)
    if isinstance(cell, list):
        mean, low, high = (f"{value:.{digits}f}" for value in cell)
        return f"{mean} [{low}, {high}]"
    return f"{cell:.{digits}f}"


def _lines(value: Any) -> str:
    if not isinstance(value, list | tuple):
        return json.dumps(value, ensure_ascii=False)
    return "[\n" + ",\n".join(f"  {json.dumps(v, ensure_ascii=False)}" for v in value) + "\n ]"


def _source(about: Mapping[str, Any]) -> str:
    """Return benchmark, commit and date of a run; the result file has the whole command."""
    module = about["command"].split()[2].removeprefix("benchmarks.")
    if about.get("commit") is None:
        return f"`benchmarks.{module}` (version {about['recon']})"
    return f"`benchmarks.{module}` (commit {about['commit'][:9]}, {about['date']})"


def number(value: float | None, factor: float = 1.0) -> float | None:
    """Return a number with nine digits, in the unit of its column."""
    return None if value is None else float(f"{value * factor:.9g}")


def spread(found: MeanWithInterval | None, factor: float = 1.0) -> Cell:
    """Return a mean with its interval as a cell; the mean alone if the interval is empty."""
    if found is None:
        return None
    mean, low, high = (float(f"{v * factor:.9g}") for v in (found.mean, found.low, found.high))
    return mean if found.high - found.low < 1e-9 else [mean, low, high]


def cells(
    rows: Sequence[Mapping[str, float | None]], windows: TrueWindows, metrics: Metrics
) -> list[Cell]:
    """Return means over subjects with their intervals, a cell for every metric.

    Args:
        rows: metrics of every window, SI units.
        windows: the windows; subjects that are set apart count in no mean.
        metrics: columns of the table.
    """
    return [
        spread(mean_of([row.get(key) for row in rows], windows), factor)
        for key, (_, factor, _) in metrics.items()
    ]


def mean_of(values: Sequence[float | None], windows: TrueWindows) -> MeanWithInterval | None:
    """Return the mean over subjects; None where no window has a value."""
    kept = [k for k, own in enumerate(windows.subjects) if own in windows.averaged_subjects]
    clips, people = ([every[k] for k in kept] for every in (windows.clips, windows.subjects))
    own = [values[k] for k in kept]
    if all(value is None for value in own):
        return None
    return mean_with_interval(own, clips, people)


def columns_of(first: str, metrics: Metrics) -> list[tuple[str, int | None]]:
    """Return headings and digits of the columns, after a first column for the rows' names."""
    return [(first, None), *((heading, digits) for heading, _, digits in metrics.values())]


def evenly(windows: TrueWindows, most: int | None) -> list[int]:
    """Choose indices of at most so many windows, spread evenly over the list."""
    count = len(windows.names)
    if most is None or most >= count:
        return list(range(count))
    return np.linspace(0, count - 1, most).round().astype(int).tolist()


def parser(about: str | None, *folders: str) -> argparse.ArgumentParser:
    """Return the command line of a benchmark: its folders of data, and `--out` for its tables."""
    made = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for folder in folders:
        made.add_argument(folder, type=Path, help=_FOLDERS[folder])
    made.add_argument("--out", type=Path, default=None, help="folder to write the tables to")
    return made


_FOLDERS = {
    "corpus": "folder of all converted motions",
    "observations": "folder of real recordings (RECON_DATA/observations)",
    "data": "folder of all real data (RECON_DATA)",
    "folds": "folder where weights and fits of the folds are kept",
}


def over_windows(about: str | None) -> argparse.ArgumentParser:
    """Return the command line of benchmarks on listed windows: corpus, splits, part, number."""
    made = parser(about, "corpus")
    made.add_argument("--splits", type=Path, default=SPLITS)
    made.add_argument("--part", choices=("test", "validation"), default="test")
    made.add_argument("--only", type=int, default=None, help="use so many windows in all")
    return made


def listed_windows(
    given: argparse.Namespace, body: BodyModel, frames: int = FRAMES
) -> TrueWindows:
    """Load the windows that a command line of `over_windows` chooses."""
    listed = Splits.load(given.splits)
    windows = load_windows(given.corpus, listed, given.part, body, frames=frames)
    return windows.take(evenly(windows, given.only))


def tell(
    out: Path | None, seed: int | None, sources: Sources, tables: Mapping[str, Table]
) -> None:
    """Print tables, and write them to a folder with a record of this run."""
    run = [] if out is None else [about(seed, sources)]
    for name, table in tables.items():
        done = Table(table.columns, table.rows, run, table.note)
        print(f"\n{name}\n\n{done.markdown()}", flush=True)
        if out is not None:
            done.write(out / f"{name}.json")


def demo_clip(frames: int) -> Motion:
    """Return the first frames of the bundled demo, at 30 Hz."""
    demo = Path(recon.__file__).parent / "assets" / "demo.npz"
    return recon.load_motion(demo).motion.resample(30.0).window(0, frames)


def tell_of(
    given: argparse.Namespace, seed: int, tables: Mapping[str, Table], files: Iterable[Path] = ()
) -> None:
    """Call `tell` for a corpus, of which some files were read; default: all of its motions."""
    read = tuple(files) or given.corpus.rglob("*.npz")
    tell(given.out, seed, {"CORPUS": (given.corpus, read)}, tables)


def recordings_source(folder: Path, names: Iterable[str] = ()) -> Sources:
    """Describe the folder of real recordings, of which some were read; default: all.

    A name may be that of a folder, or be followed by `::` and the part that is read of a file.
    """
    chosen = [folder / name.split("::")[0] for name in names] or [folder]
    files = [f for path in chosen for f in ([path] if path.is_file() else path.rglob("*"))]
    return {"OBSERVATIONS": (folder, tuple(file for file in files if file.is_file()))}


def about(seed: int | None, sources: Sources) -> dict[str, Any]:
    """Return a record of the running command: code, data, versions and machine."""
    return {
        "command": command_line(sys.argv, _module(), sources),
        "commit": commit(ROOT),
        "date": datetime.now(UTC).date().isoformat(),
        "seed": seed,
        "data": {name: _said(folder, files) for name, (folder, files) in sources.items()},
        "recon": recon.__version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "machine": machine(),
    }


def command_line(argv: list[str], module: str, sources: Sources) -> str:
    """Return the running command, with names in place of the paths of this machine.

    Folders of data are replaced by the names of their sources; a path inside the checkout is
    relative to it, and of any other absolute path only the last part is kept.
    """
    folders = {folder.resolve(): name for name, (folder, _) in sources.items()}

    def said(argument: str) -> str:
        path = Path(argument)
        if path.resolve() in folders:
            return folders[path.resolve()]
        if not path.is_absolute():
            return argument
        return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else path.name

    return shlex.join(["python", "-m", module, *(said(argument) for argument in argv[1:])])


def commit(folder: Path) -> str | None:
    """Return the checked-out commit, with `+` where tracked files differ; None without git."""
    try:
        head, changed = (
            subprocess.run(
                ["git", *words], cwd=folder, capture_output=True, text=True, check=True
            ).stdout.strip()
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "-uno"))
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")


def machine() -> str:
    """Return architecture, processor model (if the system tells it), and number of cores."""
    info = Path("/proc/cpuinfo")
    found = (
        re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.M) if info.exists() else None
    )
    names = [platform.machine(), *([found.group(1)] if found else []), f"{os.cpu_count()} cores"]
    return ", ".join(names)


def _module() -> str:
    """Return the name of the module that runs as a command."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    name = Path(sys.argv[0]).stem if spec is None else spec.name
    return name.removesuffix(".__main__")


def _said(folder: Path, files: Iterable[Path]) -> dict[str, object]:
    """Return the number of files, and the checksum of their names and contents."""
    unique = sorted(set(files))
    return {"files": len(unique), "checksum": files_checksum(unique, folder)}
