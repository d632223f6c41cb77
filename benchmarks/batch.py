"""Throughput of `recon batch` beside version 0.1.0 and beside clips fitted one by one.

    python -m benchmarks.batch CORPUS BASELINE --json batch.json
    python -m benchmarks.batch CORPUS BASELINE --clips 16 --priors pose

BASELINE is a source checkout of 0.1.0, for example `git worktree add BASELINE 0ce0517`. Clips are
the 60 frames of the listed windows (of validation people unless said), 22 joints with 4 cm of
noise per coordinate, several draws of it where there are more clips than windows. All variants
fit the same files with as many processes of one thread. They take turns, part by part of the
clips, so that the ratios say little of what else the machine does. Seconds are of whole commands,
CPU seconds those of all their processes, memory is that of the largest process.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.arguments import over_windows
from benchmarks.results import ROOT, corpus_source, write
from benchmarks.windows import FRAMES, load_windows
from priors.training.dataset import Splits
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.formats.motions import load_motion
from recon.formats.observations import PositionsFile, save_observation
from recon.simulation import points as simulate
from recon.simulation.points import Corruption

SEED, NOISE = 0, 0.04
BEFORE, ALONE, TOGETHER = "0.1.0", "one by one", "together"


@dataclass
class Cost:
    """What commands took, and what they gave."""

    clips: int = 0
    ok: int = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    largest_mb: float = 0.0
    error: float = 0.0
    """Mean distance of joints to the truth, metres."""


def main() -> None:
    parser = over_windows(__doc__)
    parser.set_defaults(part="validation")
    parser.add_argument("baseline", type=Path)
    parser.add_argument("--clips", type=int, default=64)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--parts", type=int, default=2)
    parser.add_argument("--priors", nargs="+", default=["humor", "pose"])
    given = parser.parse_args()
    windows = load_windows(
        given.corpus, Splits.load(given.splits), given.part, BodyModel.load(), SEED
    )
    rows: dict[str, dict[str, object]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = manifests(folder, windows.truth, given.clips, given.parts)
        for prior in given.priors:
            rows[prior] = compared(folder, parts, prior, given, windows.truth)
    if given.json is not None:
        write(
            given.json, SEED, corpus_source(given.corpus, windows.files), part=given.part,
            frames=FRAMES, processes=given.processes, clips=given.clips, rows=rows,
        )  # fmt: skip


def manifests(folder: Path, truth: Motion, count: int, parts: int) -> list[Path]:
    """Observation files of noisy joints, and the manifests that list them."""
    body, windows = BodyModel.load(), len(truth.translation)
    for k in range(count):
        motion = truth[k % windows]
        seen = simulate.joints3d(motion, body, Corruption(noise=NOISE), SEED + k)
        file = PositionsFile(
            "joints3d", seen.positions.double().numpy(), seen.visible.numpy(), JOINTS, seen.fps
        )
        save_observation(folder / f"{k}.npz", file)
    line = json.dumps({"id": "0", "observations": "0.npz"})
    (folder / "one.jsonl").write_text(line + "\n", encoding="utf-8")
    found = [folder / f"part{part}.jsonl" for part in range(parts)]
    for part, path in enumerate(found):
        lines = [
            json.dumps({"id": str(k), "observations": f"{k}.npz"})
            for k in range(part, count, parts)
        ]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return found


def compared(
    folder: Path, parts: Sequence[Path], prior: str, given: argparse.Namespace, truth: Motion
) -> dict[str, object]:
    """Costs of all variants with one prior, and how far their joints are from each other."""
    variants: dict[str, tuple[Path, tuple[str, ...]]] = {
        BEFORE: (given.baseline.resolve(), ()),
        ALONE: (ROOT, ("--together", "1")),
        TOGETHER: (ROOT, ()),
    }
    costs = {name: Cost() for name in variants}
    for name in (BEFORE, TOGETHER):  # compiles modules and brings files into memory
        tree, _ = variants[name]
        words = ("batch", str(folder / "one.jsonl"), "--out", str(folder / prior / f"{name}-warm"))
        run((*words, "--prior", prior), tree, folder, Cost())
    for number, part in enumerate(parts):
        names = list(variants)
        for name in names[number % len(names) :] + names[: number % len(names)]:
            tree, options = variants[name]
            words = ("batch", str(part), "--out", str(folder / prior / name), "--prior", prior,
                     "--processes", str(given.processes), *options)  # fmt: skip
            run(words, tree, folder, costs[name])
            print(prior, part.stem, name, f"{costs[name].seconds:.1f} s", flush=True)
    joints = {name: fitted_joints(folder / prior / name, given.clips) for name in variants}
    true = BodyModel.load().pose(truth).joints.double().numpy()
    for name, cost in costs.items():
        known = true[np.arange(given.clips) % len(true)]
        cost.error = float(np.linalg.norm(joints[name] - known, axis=-1).mean())
    apart = np.linalg.norm(joints[TOGETHER] - joints[ALONE], axis=-1)
    Console().print(shown(prior, costs))
    before, now = costs[BEFORE], costs[TOGETHER]
    found: dict[str, object] = {name: asdict(cost) for name, cost in costs.items()}
    return found | {
        "throughput": before.seconds / now.seconds,
        "cpu_ratio": before.cpu_seconds / now.cpu_seconds,
        "apart_mean": float(apart.mean()),
        "apart_worst_clip": float(apart.mean((1, 2)).max()),
    }


def run(words: Sequence[str], tree: Path, folder: Path, cost: Cost) -> None:
    """One command with the packages of a source tree; what it took is added to a cost.

    Raises:
        RuntimeError: when a clip was not fitted.
    """
    environment = {**os.environ, "PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"}
    environment["PYTHONPYCACHEPREFIX"] = str(folder / "compiled")
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    began = time.perf_counter()
    with (folder / "said").open("w+", encoding="utf-8") as said:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "recon", *words], cwd=folder, env=environment,
            stdout=said, stderr=said,
        )  # fmt: skip
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        answer = said.read()
    if process.returncode != 0:
        raise RuntimeError(f"recon {' '.join(words)} of {tree} failed: {answer}")
    count = len(Path(words[1]).read_text(encoding="utf-8").splitlines())
    cost.clips += count
    cost.ok += count
    cost.seconds += time.perf_counter() - began
    cost.cpu_seconds += used.ru_utime + used.ru_stime
    cost.largest_mb = max(cost.largest_mb, used.ru_maxrss / 1024)


def fitted_joints(folder: Path, count: int) -> np.ndarray:
    """Joints of all results, axes (clips, time, joints, 3), metres."""
    body = BodyModel.load()
    motions = [load_motion(folder / f"{k}.npz").motion for k in range(count)]
    return np.stack([body.pose(motion).joints.double().numpy() for motion in motions])


def shown(title: str, costs: dict[str, Cost]) -> Table:
    table = Table("", "s", "CPU s", "MB", "error cm", title=title)
    for name, cost in costs.items():
        table.add_row(
            name, f"{cost.seconds:.1f}", f"{cost.cpu_seconds:.1f}", f"{cost.largest_mb:.0f}",
            f"{100 * cost.error:.2f}",
        )  # fmt: skip
    return table


if __name__ == "__main__":
    main()
