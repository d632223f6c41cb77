"""Frozen results: run every case, keep what it gave, and compare.

    python -m scripts.frozen --out out/frozen          # keep what this checkout gives
    python -m scripts.frozen --against out/frozen      # compare this checkout with that
    python -m scripts.frozen --tree ../old --repeats 3 # compare with another checkout, in turns

Cases read simulated observations that the reference (the folder, or the other checkout) has
written, so that a change of the simulator shows in the case `simulate` alone. Another checkout
runs its own scripts/frozen where it has one, else this. CPU seconds are those of one thread; a
case's first run in a process also loads modules and weights, which the median of three repeats
leaves out. Ratios are medians over repeats, this checkout to the reference.

A move of code keeps joints to 1e-4 m on one machine, where the reference must be made, too; what
changes the order of sums keeps them to 1e-3 m (--tolerance 1e-3). No objective rises by more than
0.1 %. The exit code is 1 where something differs.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from statistics import median
from typing import Any

import numpy as np

RISE = 1e-3
"""Largest relative rise of an objective that counts as unchanged."""
LABELS = 0.01
"""Largest share of labels (contacts, visibility) that may change."""
OTHERS = 10.0
"""Tolerance of other numbers as a multiple of that of joints; relative for those above one."""


@dataclass(frozen=True)
class Difference:
    """How two results of one case differ, as texts."""

    joints: str
    """Largest distance along an axis, millimetres; empty where the case has no joints."""
    objective: str
    """Relative change of the objective, per cent; empty where the case has none."""
    words: tuple[str, ...]
    """What differs by more than its tolerance; empty where nothing does."""


def differences(old: Path, new: Path, tolerance: float) -> Difference:
    """Compare two files of arrays.

    Args:
        old: the reference.
        new: the result to compare with it.
        tolerance: of coordinates of joints, metres.
    """
    with np.load(old) as a, np.load(new) as b:
        was, now = dict(a), dict(b)
    words: list[str] = []
    joints = objective = ""
    for name in sorted({*was, *now}):
        if name not in was or name not in now:
            words.append(f"{name} is {'new' if name in now else 'gone'}")
        elif was[name].shape != now[name].shape:
            words.append(f"{name}: shape {was[name].shape} became {now[name].shape}")
        elif was[name].dtype.kind in "US":
            words += _lines(was[name], now[name])
        elif name == "objective":
            change = float(now[name] / was[name] - 1)
            objective = f"{100 * change:+.4f} %"
            # NaN counts as a rise, too
            words += [] if change <= RISE else ["the objective rose"]
        else:
            apart = np.abs(now[name].astype(float) - was[name].astype(float))
            apart = np.where(np.isnan(now[name]) & np.isnan(was[name]), 0.0, apart)
            if name == "joints":
                joints = f"{1000 * apart.max():.4f}"
                words += [] if apart.max() <= tolerance else ["joints moved"]
            elif name == "contacts" or was[name].dtype == bool:
                share = (apart > 0.5).mean()
                words += [] if share <= LABELS else [f"{share:.1%} of {name} changed"]
            else:
                most = OTHERS * tolerance * np.maximum(1.0, np.nan_to_num(np.abs(was[name])))
                if not (apart <= most).all():
                    words.append(f"{name} moved by up to {apart.max():.4g}")
    return Difference(joints, objective, tuple(words))


def _lines(was: np.ndarray, now: np.ndarray) -> list[str]:
    """Describe the first difference between two arrays of texts; empty if there is none."""
    other = np.atleast_1d(was != now).nonzero()[0]
    if len(other) == 0:
        return []
    a, b = np.atleast_1d(was)[other[0]], np.atleast_1d(now)[other[0]]
    k = next((k for k, pair in enumerate(zip(a, b, strict=False)) if pair[0] != pair[1]), 0)
    k = max(k - 20, 0)
    return [f"{len(other)} texts changed, first {a[k : k + 60]!r} to {b[k : k + 60]!r}"]


ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    mode = parser.add_mutually_exclusive_group(required=True)
    mode.add_argument("--out", type=Path, help="folder to keep the results of this checkout in")
    mode.add_argument("--against", type=Path, help="folder of kept results to compare with")
    mode.add_argument("--tree", type=Path, help="other checkout, the reference, to run as well")
    parser.add_argument("--only", help="names of cases, with commas between")
    parser.add_argument("--tolerance", type=float, default=1e-4, help="metres, of joints")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    arguments = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as place:
        code = _run(arguments, Path(place))
    print(f"{time.monotonic() - began:.0f} s")
    return code


def _run(arguments: argparse.Namespace, place: Path) -> int:
    reference = (arguments.out or arguments.against or place / "reference").resolve()
    trees = {place / "now": ROOT}
    if arguments.out is not None:
        trees = {reference: ROOT}
    elif arguments.tree is not None:
        trees = {reference: arguments.tree.resolve()} | trees
    for folder in trees:
        folder.mkdir(parents=True, exist_ok=True)
    inputs = reference / "inputs"
    if arguments.against is None:
        with Worker(trees[reference]) as worker:
            said = worker.ask({"inputs": str(inputs)})
        if "error" in said:
            raise RuntimeError(f"the inputs could not be made: {said['error']}")
    elif not inputs.is_dir():
        print(f"{reference}: has no inputs; make it by --out {reference}", file=sys.stderr)
        return 1
    names = None if arguments.only is None else arguments.only.split(",")
    seconds = run_cases(trees, inputs, names, arguments.repeats, arguments.jobs)
    kept = reference / "seconds.json"
    if arguments.against is None:
        kept.write_text(json.dumps(seconds[reference], indent=1))
    if arguments.out is not None:
        return _failures(seconds[reference])
    before = json.loads(kept.read_text())
    if names is not None:
        before = {name: value for name, value in before.items() if name in names}
    return report(reference, place / "now", before, seconds[place / "now"], arguments.tolerance)


class Worker:
    """A process that runs cases with one checkout, by default in this environment."""

    def __init__(self, tree: Path, python: str = sys.executable) -> None:
        path = os.pathsep.join(map(str, (tree, ROOT)))
        environment = os.environ | {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        command = [python, "-P", "-m", "scripts.frozen.worker"]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, text=True, env=environment
        )
        hello = self._answer()
        self.cases: list[str] = hello["cases"]
        if Path(hello["recon"]).resolve().parents[1] != tree.resolve():
            raise RuntimeError(f"expected recon of {tree}, got {hello['recon']}")

    def ask(self, what: dict[str, Any]) -> dict[str, Any]:
        """Send a task to the process; return its answer, which has `error` if the task failed."""
        assert self._process.stdin is not None
        print(json.dumps(what), file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the worker ended with exit code {self._process.wait()}")
        return json.loads(line)

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


Seconds = dict[str, list[float] | str]
"""CPU seconds of every repeat, or the error, keyed by case."""


def run_cases(
    trees: dict[Path, Path], inputs: Path, names: list[str] | None, repeats: int, jobs: int
) -> dict[Path, Seconds]:
    """Run all cases with all checkouts, in turns; results go to OUT/CASE.npz."""
    found: dict[Path, Seconds] = {out: {} for out in trees}
    queue: SimpleQueue[str] = SimpleQueue()
    with Worker(next(reversed(trees.values()))) as one:
        unknown = sorted(set(names or ()) - set(one.cases))
        if unknown:
            raise SystemExit(f"no such cases: {', '.join(unknown)}; there are {one.cases}")
        for name in one.cases if names is None else names:
            queue.put(name)

    def work(_: int) -> None:
        workers = {out: Worker(tree) for out, tree in trees.items()}
        while not queue.empty():
            name = queue.get()
            for repeat in range(repeats):
                order: Sequence[Path] = list(trees)[:: 1 if repeat % 2 == 0 else -1]
                for out in order:
                    asked = {"case": name, "inputs": str(inputs), "out": str(_file(out, name))}
                    said = workers[out].ask(asked)
                    times = found[out].setdefault(name, [])
                    if "error" in said:
                        found[out][name] = said["error"]
                    elif isinstance(times, list):
                        times.append(said["seconds"])
        for worker in workers.values():
            worker.__exit__()

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(work, range(jobs)))
    return found


def _file(folder: Path, name: str) -> Path:
    return folder / f"{name.replace(' ', '_')}.npz"


def _failures(seconds: Seconds) -> int:
    """Print the cases that failed; return 1 if there are any."""
    failed = {name: said for name, said in seconds.items() if isinstance(said, str)}
    for name, said in failed.items():
        print(f"{name}: {said}", file=sys.stderr)
    print(f"{len(seconds) - len(failed)} cases kept, {len(failed)} failed")
    return int(len(failed) > 0)


def report(old: Path, new: Path, before: Seconds, after: Seconds, tolerance: float) -> int:
    """Print a table of all cases; return 1 if one differs."""
    print(f"{'case':24}{'joints mm':>10}{'objective':>10}{'CPU s':>8}{'now':>8}{'ratio':>7}")
    differ: list[str] = []
    ratios: list[float] = []
    sums = [0.0, 0.0]
    for name in dict.fromkeys((*before, *after)):
        was, now = before.get(name, "no reference"), after.get(name, "the case is gone")
        if isinstance(was, str) or isinstance(now, str):
            words = was if isinstance(was, str) else str(now)
            differ.append(name)
            print(f"{name:24}{words.strip().splitlines()[-1]}")
            continue
        if len(was) == len(now):
            ratio = median(b / max(a, 1e-9) for a, b in zip(was, now, strict=True))
        else:
            ratio = median(now) / max(median(was), 1e-9)
        ratios.append(ratio)
        sums = [sums[0] + median(was), sums[1] + median(now)]
        found: Difference = differences(_file(old, name), _file(new, name), tolerance)
        print(
            f"{name:24}{found.joints:>10}{found.objective:>10}{median(was):8.2f}{median(now):8.2f}"
            f"{ratio:7.2f}  {'; '.join(found.words)}"
        )
        if found.words:
            differ.append(name)
    if ratios:
        print(f"{'sum; median of ratios':44}{sums[0]:8.1f}{sums[1]:8.1f}{median(ratios):7.2f}")
    print(f"{len(differ)} differ: {', '.join(differ)}" if differ else "nothing differs")
    return int(len(differ) > 0)


if __name__ == "__main__":
    sys.exit(main())
