"""How long commands take before they work, beside another version of recon.

    python -m benchmarks.start BASELINE --json start.json

BASELINE is a source checkout of the other version, for example `git worktree add BASELINE 0ce0517`
for 0.1.0. Times are CPU seconds, of the user and of the system, of whole processes; the two
versions take turns, so that the ratio of their medians says little of what else the machine does.
Compiled modules are kept between the runs, as they are where recon is installed, whatever
PYTHONDONTWRITEBYTECODE says: without them half of a start is Python compiling torch anew.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.results import ROOT, write

RUNS = 5
WRONG = "wrong.npz"
"""A file that is there and no observation: it is answered when all is loaded, before any work."""
COMMANDS: dict[str, tuple[str, ...]] = {
    "import recon": ("-c", "import recon"),
    "recon fit --help": ("-m", "recon", "fit", "--help"),
    "recon fit, a file that is not there": ("-m", "recon", "fit", "no.npz", "--out", "out.npz"),
    "recon fit, until work begins": ("-m", "recon", "fit", WRONG, "--out", "out.npz"),
}
TORCH = "import torch, in both"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("baseline", type=Path)
    parser.add_argument("--json", type=Path, required=True)
    options = parser.parse_args()
    rows = measured(options.baseline.resolve())
    for name, row in rows.items():
        print(f"{name:<40} {row['baseline']:6.2f} {row['ours']:6.2f} {row['ratio']:6.3f}")
    write(options.json, None, runs=RUNS, rows=rows)


def measured(baseline: Path) -> dict[str, dict[str, float]]:
    """Medians of both, CPU seconds, and the ratio of ours to the baseline's."""
    rows: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / WRONG, nothing=np.zeros(3))
        for row, words in (*COMMANDS.items(), (TORCH, ("-c", "import torch"))):
            for tree in (baseline, ROOT):  # compiles modules and brings files into memory
                cpu_seconds(words, tree, folder)
            rows[row] = in_turns(
                lambda tree, words=words: cpu_seconds(words, tree, folder), baseline, RUNS
            )
    return rows


def in_turns(seconds: Callable[[Path], float], baseline: Path, runs: int) -> dict[str, float]:
    """Medians of both versions, which take turns in both orders, and their ratio."""
    trees = (baseline, ROOT)
    times: dict[Path, list[float]] = {tree: [] for tree in trees}
    for run in range(runs):
        for tree in trees if run % 2 else trees[::-1]:
            times[tree].append(seconds(tree))
    theirs, ours = (median(times[tree]) for tree in trees)
    return {"baseline": theirs, "ours": ours, "ratio": ours / theirs}


def cpu_seconds(words: Sequence[str], tree: Path, folder: Path) -> float:
    """User and system seconds of one Python process with the packages of a source tree.

    `folder` is where it runs; compiled modules are kept there.
    """
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    environment["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-P", *words]
    subprocess.run(command, cwd=folder, capture_output=True, check=False, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


if __name__ == "__main__":
    main()
