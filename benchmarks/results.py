"""What tables share: the bundled clip, a plain table, and what a result file says about itself."""

import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

import recon
from recon import __version__
from recon.core.motion import Motion
from recon.formats.motions import load_motion
from recon.formats.opening import replacing
from recon.formats.replacing import files_checksum

ROOT = Path(__file__).parents[1]
"""The source checkout."""
RESULTS = Path(__file__).parent / "results"
"""The committed result files, from which the tables of the documents are made."""

Sources = Mapping[str, tuple[Path, Iterable[Path]]]
"""Data that a result was measured on: its name in commands, its folder, and the files read."""


def demo_clip(frames: int) -> Motion:
    """The first frames of the bundled demo, at 30 Hz."""
    demo = Path(recon.__file__).parent / "assets" / "demo.npz"
    return load_motion(demo).motion.resample(30.0).window(0, frames)


def show(title: str, rows: dict[str, float]) -> None:
    """Print one value a line."""
    table = Table("what", "value", title=title)
    for name, value in rows.items():
        table.add_row(name, f"{value:.4g}")
    Console().print(table)


def corpus_source(folder: Path, files: Iterable[Path] | None = None) -> Sources:
    """A converted corpus, of which some files were read; None is all of its motions."""
    return {"CORPUS": (folder, folder.rglob("*.npz") if files is None else files)}


def recordings_source(folder: Path, names: Iterable[str] = ()) -> Sources:
    """The folder of real recordings, of which some were read; default: all files in it.

    A name may go on with `::` and what is read inside the file, and may be that of a folder.
    """
    chosen = [folder / name.split("::")[0] for name in names] or [folder]
    files = [f for path in chosen for f in ([path] if path.is_file() else path.rglob("*"))]
    return {"OBSERVATIONS": (folder, tuple(file for file in files if file.is_file()))}


def earlier(path: Path | None, table: str) -> dict[str, Any]:
    """A table that an earlier run of this commit left in a result file; empty if none did."""
    if path is None or not path.is_file():
        return {}
    found = json.loads(path.read_text(encoding="utf-8"))
    return found[table] if found["about"]["commit"] == commit(ROOT) else {}


def write(path: Path, seed: int | None, sources: Sources | None = None, **tables: Any) -> None:
    """Write the result of the command that runs, in one step.

    Args:
        path: JSON file to write.
        seed: of everything random; None where nothing is.
        sources: the data that was read; None where a result depends on no data.
        tables: what was found.
    """
    sources = {} if sources is None else sources
    about = {
        "command": command_line(sys.argv, _module(), sources),
        "commit": commit(ROOT),
        "date": datetime.now(UTC).date().isoformat(),
        "seed": seed,
        "data": {name: _said(folder, files) for name, (folder, files) in sources.items()},
        "recon": __version__,
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "machine": machine(),
    }
    with replacing(path) as beside:
        beside.write_text(dumps({"about": about, **tables}))


def command_line(argv: list[str], module: str, sources: Sources) -> str:
    """The command that runs, with names in place of the paths of this machine.

    Folders of data are called by the names of their sources; a path inside the checkout is
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
    """The commit that is checked out, with `+` where tracked files differ; None without git."""
    try:
        head = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=folder, capture_output=True, text=True, check=True
        )
        changed = subprocess.run(
            ["git", "status", "--porcelain", "--untracked-files=no"],
            cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+" if changed.stdout.strip() else "")


def machine() -> str:
    """Architecture, model of the processor where the system tells it, and number of cores."""
    info = Path("/proc/cpuinfo")
    found = (
        re.search(r"^model name\s*:\s*(.+)$", info.read_text(), re.M) if info.exists() else None
    )
    names = [platform.machine(), *([found.group(1)] if found else []), f"{os.cpu_count()} cores"]
    return ", ".join(names)


def dumps(value: Any) -> str:
    """JSON of one entry a line, but with lists of numbers and of short texts on one line."""
    text = json.dumps(value, indent=1)
    return re.sub(r"\[[^\[\]{}]*\]", lambda m: " ".join(m.group().split()), text) + "\n"


def _module() -> str:
    """The module that runs as a command."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    name = Path(sys.argv[0]).stem if spec is None else spec.name
    return name.removesuffix(".__main__")


def _said(folder: Path, files: Iterable[Path]) -> dict[str, object]:
    """How many files were read, and the checksum of their names and contents."""
    unique = sorted(set(files))
    return {"files": len(unique), "checksum": files_checksum(unique, folder)}
