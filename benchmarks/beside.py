"""Compares the errors and speed of this checkout with those of another, on the same files.

    python -m benchmarks.beside CORPUS --tree ../other --python ../other/.venv/bin/python
    python -m benchmarks.beside CORPUS --tree ../other --cases noisy slips --most 4 --out FOLDER

Inputs are written once, by this checkout, for windows of two seconds of the test and validation
people (`benchmarks.beside_cases`). Each checkout has a process of one thread that calls the public
function (`recon.fit`, `recon.complete`, ...) with these files and saves its result; they run in
turns, and which is first changes. This checkout computes the errors of both. Windows are taken
from one person after the other, all cases of a window before the next window. FOLDER/pairs.jsonl
has a line for every pair of results; the same command continues where it was stopped, as long as
both checkouts' libraries have the same commits; with `--most 0` it only prints the tables.

`ratio` is the mean over people of a person's sum of errors here divided by that there, with its 95
% interval (people and their windows are resampled); `met` says whether it is at most 1.01 and the
upper end of the interval at most 1.02. CPU seconds have the median of the ratios of pairs. Clips
that either checkout refused are counted and have no ratio.
"""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np
import torch

import recon
from benchmarks.beside_cases import CASES, Case, Values, Window, cases_of
from benchmarks.protocol import ROOT, Cell, Table, number, parser, spread, tell
from benchmarks.strangers.compare import over_people, quotient
from recon.benchmark.dataset import Part, Splits
from recon.benchmark.windows import load_windows
from scripts.frozen.__main__ import Worker

LIBRARY = ("recon", "priors", "observations")
MOST_MEAN, MOST_UPPER = 1.01, 1.02
"""Largest mean ratio of errors of a row that is met, and upper end of its interval."""
Pair = Mapping[str, Any]
"""A line of the log: `row`, `group`, `case`, `window`, `subject`, `commits`, and, for the other
checkout and this one, error `values`, CPU `seconds` and the reason why it `refused`."""


def main() -> None:
    """Run the missing cases with both checkouts, print and write the table."""
    arguments = parser(__doc__, "corpus")
    arguments.add_argument("--tree", type=Path, required=True, help="the other checkout")
    arguments.add_argument("--python", default=sys.executable, help="of its environment")
    arguments.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    arguments.add_argument("--most", type=int, default=4, help="windows of each case")
    given = arguments.parse_args()
    torch.set_num_threads(1)
    out = given.out or Path("out/beside")
    out.mkdir(parents=True, exist_ok=True)
    commits = [library_commit(given.tree), library_commit(ROOT)]
    windows = listed(given.corpus, out / "truth")
    pairs = logged(out / "pairs.jsonl", commits)
    done = {(pair["case"], pair["window"]) for pair in pairs}
    with Worker(given.tree.resolve(), given.python) as there, Worker(ROOT) as here:
        runner = Runner((there, here), out)
        for window in windows[: given.most]:
            for case in cases_of(window, given.cases):
                if (case.name, window.name) in done:
                    continue
                pair = {**runner.pair(case, window), "commits": commits}
                pairs.append(pair)
                with (out / "pairs.jsonl").open("a", encoding="utf-8") as log:
                    print(json.dumps(pair), file=log)
    asked = [pair for pair in pairs if pair["row"] in given.cases]
    names = {pair["window"] for pair in asked}
    read = [w.source for w in windows if w.name in names]
    tell(out, 0, {"CORPUS": (given.corpus, read)}, {"beside": table(asked, commits)})


def library_commit(tree: Path) -> str:
    """Return the last commit that changed the library, with `+` if files differ from it."""
    asked = (["log", "-1", "--format=%H"], ["status", "--porcelain", "-uno"])
    last, changed = (
        subprocess.run(["git", *words, "--", *LIBRARY], cwd=tree, capture_output=True, text=True,
                       check=True).stdout.strip()
        for words in asked
    )  # fmt: skip
    return last + "+" * bool(changed)


def logged(path: Path, commits: Sequence[str]) -> list[Pair]:
    """Read the pairs of an earlier run of the same commits."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [pair for pair in map(json.loads, lines) if pair["commits"] == list(commits)]


def listed(corpus: Path, folder: Path) -> list[Window]:
    """Return all listed windows, one of each person in turn, and write their true motions."""
    folder.mkdir(exist_ok=True)
    body, splits = recon.BodyModel.load(), Splits.load()
    by_person: dict[str, list[Window]] = {}
    parts: tuple[Part, ...] = ("test", "validation")
    for part in parts:
        windows = load_windows(corpus, splits, part, body)
        files = {path.stem: path for path in windows.files}
        for k, name in enumerate(windows.names):
            who = windows.subjects[k]
            path = folder / f"{name}.npz"
            window = Window(name, who, windows, k, path, files[windows.clips[k]], body)
            if not path.exists():
                window.save(window.truth, path)
            by_person.setdefault(who, []).append(window)
    spread_out = [_spread(own) for who, own in by_person.items() if who not in splits.apart]
    turns = range(max(map(len, spread_out)))
    return [own[turn] for turn in turns for own in spread_out if turn < len(own)]


def _spread(windows: Sequence[Window]) -> list[Window]:
    """Reorder windows so that the first few are spread evenly over the list."""
    step = next(s for s in range(round(0.62 * len(windows)), 9**9) if np.gcd(s, len(windows)) == 1)
    return [windows[k * step % len(windows)] for k in range(len(windows))]


class Runner:
    """Runs cases with both checkouts in turns, and computes the errors."""

    def __init__(self, workers: tuple[Worker, Worker], out: Path) -> None:
        self._workers, self._out = workers, out
        self._warm: set[str] = set()
        self._turn = 0

    def pair(self, case: Case, window: Window) -> dict[str, Any]:
        """Run one case of one window with both checkouts; return a line for the log."""
        folder = self._out / "windows" / window.name / case.name
        folder.mkdir(parents=True, exist_ok=True)
        files = case.see(window, folder)
        asked = {"verb": case.verb, "files": [str(f) for f in files], "how": case.how(window)}
        ending = "" if case.verb in ("predict", "batch") else ".npz"
        results = [folder / f"{name}{ending}" for name in ("there", "here")]
        values: list[Values] = [{}, {}]
        seconds: list[float | None] = [None, None]
        refused = ["", ""]
        self._turn += 1
        # a group's first call loads modules and weights, so it is repeated: the second is timed
        for _ in range(1 if case.group in self._warm else 2):
            for own in (0, 1) if self._turn % 2 else (1, 0):
                said = self._workers[own].ask({**asked, "out": str(results[own])})
                seconds[own] = said.get("seconds")
                refused[own] = said.get("error", "").strip().rpartition("\n")[-1]
        self._warm.add(case.group)
        if not any(refused):
            values = [case.judge(window, files, result) for result in results]
        print(window.name, case.name, *values, *filter(None, seconds), *refused, flush=True)
        return {"row": case.row, "group": case.group, "case": case.name, "window": window.name,
                "subject": window.subject, "values": values, "seconds": seconds,
                "refused": refused}  # fmt: skip


def table(pairs: Sequence[Pair], commits: Sequence[str]) -> Table:
    """Build a table with a row for every case and measure."""
    rows: list[list[Cell]] = []
    for name in dict.fromkeys(pair["group"] for pair in pairs):
        own = [pair for pair in pairs if pair["group"] == name]
        measures = dict.fromkeys(key for pair in own for key in pair["values"][0])
        refused = " / ".join(str(sum(bool(pair["refused"][k]) for pair in own)) for k in (0, 1))
        times = [pair["seconds"] for pair in own if None not in pair["seconds"]]
        rows += [
            [f"{name}: {measure}", *_compared(own, measure), refused, *_times(times)]
            for measure in measures
        ]
    note = f"There: library of {commits[0][:9]}; here: {commits[1][:9]}."
    heads = (("people", 0), ("windows", 0), ("there", 4), ("here", 4), ("ratio", 4),
             ("met", None), ("refused there / here", None), ("CPU s there", 2), ("CPU s here", 2),
             ("CPU ratio", 3))  # fmt: skip
    return Table([("case: measure", None), *heads], rows, note=note)


def _compared(pairs: Sequence[Pair], measure: str) -> list[Cell]:
    """Return people, windows, means, the ratio of the means, and whether it is small enough."""
    people: dict[str, list[tuple[float, float]]] = {}
    for pair in pairs:
        there, here = (values.get(measure) for values in pair["values"])
        if there is not None and here is not None:
            people.setdefault(pair["subject"], []).append((here, there))
    sums = [np.array(own) for own in people.values()]
    count = sum(map(len, sums))
    if count == 0:
        return [0, 0, None, None, None, None]
    here, there = (number(mean(float(own[:, k].mean()) for own in sums)) for k in (0, 1))
    if any(own[:, 1].sum() == 0 for own in sums):
        return [len(sums), count, there, here, None, None]
    ratio = over_people(sums, quotient)
    met = ratio.mean <= MOST_MEAN and ratio.high <= MOST_UPPER
    return [len(sums), count, there, here, spread(ratio), "yes" if met else "no"]


def _times(times: Sequence[Sequence[float]]) -> list[Cell]:
    if not times:
        return [None, None, None]
    there, here = (number(median(own)) for own in zip(*times, strict=True))
    return [there, here, number(median(here / there for there, here in times))]


if __name__ == "__main__":
    main()
