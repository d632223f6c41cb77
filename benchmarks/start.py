"""How long commands take before they work, beside another version of recon.

    python -m benchmarks.start BASELINE --json start.json

BASELINE is a source checkout of the other version, for example `git worktree add BASELINE 0ce0517`
for 0.1.0. Times are CPU seconds, of the user and of the system, of whole processes; the two
versions take turns, so that the ratio of their medians says little of what else the machine does.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
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
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / WRONG, nothing=np.zeros(3))
        for name, words in (*COMMANDS.items(), (TORCH, ("-c", "import torch"))):
            # once before, so that compiled modules and files are at hand
            pairs = [
                [cpu_seconds(words, tree, Path(folder)) for tree in (baseline, ROOT)]
                for _ in range(RUNS + 1)
            ][1:]
            theirs, ours = (median(times) for times in zip(*pairs, strict=True))
            rows[name] = {"baseline": theirs, "ours": ours, "ratio": ours / theirs}
    return rows


def cpu_seconds(words: Sequence[str], tree: Path, folder: Path) -> float:
    """User and system seconds of one Python process with the packages of a source tree."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-P", *words], cwd=folder, capture_output=True, check=False,
        env={**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


if __name__ == "__main__":
    main()
