"""Throughput of `recon batch` beside version 0.1.0.

    python -m benchmarks.batch CORPUS BASELINE --json batch.json
    python -m benchmarks.batch CORPUS BASELINE --clips 32 --priors pose

BASELINE is a source checkout of 0.1.0, for example `git worktree add BASELINE 0ce0517`. Clips are
the 60 frames of the listed windows (of validation people unless said), 22 joints with 4 cm of
noise per coordinate, several draws of it where there are more clips than windows. Both versions
fit the same files with as many processes of one thread. They run at the same time, so that all
meet the same machine, and what counts is the CPU seconds of all their processes: on a machine with
a core for each process, throughput is as many times higher as CPU seconds are lower. Variants that
end later have the machine more to themselves, which flatters the slower ones. Memory is that of
the largest process.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.arguments import over_windows
from benchmarks.results import ROOT, corpus_source, write
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import FRAMES, load_windows
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.motions import load_motion
from recon.formats.observations import PositionsFile, save_observation
from recon.simulation import points as simulate
from recon.simulation.points import Corruption

SEED, NOISE = 0, 0.04
BEFORE, NOW = "0.1.0", "one by one"


@dataclass(frozen=True)
class Cost:
    """What a command took, and what it gave."""

    cpu_seconds: float
    """User and system seconds of all processes."""
    largest_mb: float
    """Memory of the largest process."""
    error: float = 0.0
    """Mean distance of joints to the truth, metres."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.set_defaults(part="validation")
    parser.add_argument("baseline", type=Path)
    parser.add_argument("--clips", type=int, default=64)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--priors", nargs="+", default=["humor", "pose"])
    given = parser.parse_args()
    windows = load_windows(
        given.corpus, Splits.load(given.splits), given.part, BodyModel.load(), SEED
    )
    rows: dict[str, dict[str, object]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        manifest(folder, windows.truth, given.clips)
        for prior in given.priors:
            rows[prior] = compared(folder, prior, given, windows.truth)
    if given.json is not None:
        write(
            given.json, SEED, corpus_source(given.corpus, windows.files), part=given.part,
            frames=FRAMES, processes=given.processes, clips=given.clips, rows=rows,
        )  # fmt: skip


def manifest(folder: Path, truth: Motion, count: int) -> None:
    """Observation files of noisy joints, the list of them, and a list of the first alone."""
    body, windows = BodyModel.load(), len(truth.translation)
    lines: list[str] = []
    for k in range(count):
        motion = truth[k % windows]
        seen = simulate.joints3d(motion, body, Corruption(noise=NOISE), SEED + k)
        file = PositionsFile(
            "joints3d", seen.positions.double().numpy(), seen.visible.numpy(), JOINTS, seen.fps
        )
        save_observation(folder / f"{k}.npz", file)
        lines.append(json.dumps({"id": str(k), "observations": f"{k}.npz"}) + "\n")
    (folder / "all.jsonl").write_text("".join(lines), encoding="utf-8")
    (folder / "one.jsonl").write_text(lines[0], encoding="utf-8")


def compared(
    folder: Path, prior: str, given: argparse.Namespace, truth: Motion
) -> dict[str, object]:
    """Costs of all variants with one prior, and how far their joints are from each other."""
    baseline = given.baseline.resolve()
    variants = {BEFORE: baseline, NOW: ROOT}
    for tree in (baseline, ROOT):  # compiles modules and brings files into memory
        out = folder / prior / f"warm {tree.name}"
        Command.begun(("one.jsonl", "--out", str(out), "--prior", prior), tree, folder).ended()
    commands = {
        name: Command.begun(
            ("all.jsonl", "--out", str(folder / prior / name), "--prior", prior,
             "--processes", str(given.processes)), tree, folder,
        )
        for name, tree in variants.items()
    }  # fmt: skip
    costs = {name: command.ended() for name, command in commands.items()}
    joints = {name: fitted_joints(folder / prior / name, given.clips) for name in variants}
    true = BodyModel.load().pose(truth).joints.double().numpy()
    known = true[np.arange(given.clips) % len(true)]
    for name, cost in costs.items():
        error = float(np.linalg.norm(joints[name] - known, axis=-1).mean())
        costs[name] = replace(cost, error=error)
    Console().print(shown(prior, costs))
    found: dict[str, object] = {name: asdict(cost) for name, cost in costs.items()}
    return found | {"throughput": costs[BEFORE].cpu_seconds / costs[NOW].cpu_seconds}


@dataclass(frozen=True)
class Command:
    """A `recon batch` that runs."""

    process: subprocess.Popen[str]
    said: Path

    @classmethod
    def begun(cls, words: Sequence[str], tree: Path, folder: Path) -> "Command":
        """Begin one in a folder, with the packages of a source tree."""
        environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
        environment["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        handle, said = tempfile.mkstemp(dir=folder, suffix=".log")
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "recon", "batch", *words], cwd=folder, env=environment,
            stdout=handle, stderr=handle, text=True,
        )  # fmt: skip
        os.close(handle)
        return cls(process, Path(said))

    def ended(self) -> Cost:
        """Wait for its end.

        Raises:
            RuntimeError: when a clip was not fitted.
        """
        _, status, used = os.wait4(self.process.pid, 0)
        self.process.returncode = os.waitstatus_to_exitcode(status)
        if self.process.returncode != 0:
            raise RuntimeError(f"{self.process.args}: {self.said.read_text(encoding='utf-8')}")
        return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def fitted_joints(folder: Path, count: int) -> np.ndarray:
    """Joints of all results, axes (clips, time, joints, 3), metres."""
    body = BodyModel.load()
    motions = [load_motion(folder / f"{k}.npz").motion for k in range(count)]
    return np.stack([body.pose(motion).joints.double().numpy() for motion in motions])


def shown(title: str, costs: dict[str, Cost]) -> Table:
    table = Table("", "CPU s", "MB", "error cm", title=title)
    for name, cost in costs.items():
        error = f"{100 * cost.error:.2f}"
        table.add_row(name, f"{cost.cpu_seconds:.1f}", f"{cost.largest_mb:.0f}", error)
    return table


if __name__ == "__main__":
    main()
