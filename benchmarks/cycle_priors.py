"""The prior of whole cycles beside what else completes them: one table, paired intervals.

    python -m benchmarks.cycle_priors CORPUS --network FILE --components FILE ...
        --json benchmarks/results/cycle_priors.json

Columns as in `benchmarks.complete`: p points of every frame, or f of 100 frames with all points,
with the 16 landmarks or without. Methods: the anchor-frame VAE (`network`, made by `python -m
training anchor`), principal components of the same cycles with their Gaussian in the same
optimiser (by `python -m training.anchor.components`), the pose prior with its smoothness
(`pose`) and HuMoR (`humor`), which are told the same noise; `recon.complete` is the library's
own choice by what was seen. Seeds draw other people, clothes, offsets of landmarks and noise for
the same cycles.

What is in the JSON already, of the same commit, is not run again; with `--minutes` the command
ends after the column that is then under way, and goes on when it is run once more.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

import recon
from benchmarks.arguments import over_windows
from benchmarks.complete import (
    COLUMNS,
    Fitter,
    called,
    completed,
    fitted,
    judged,
    observe,
    together,
)
from benchmarks.cycles import FoundCycle, chosen, found_cycles
from benchmarks.results import corpus_source, earlier, write
from benchmarks.scans import ScannedCycle, scanned_cycle
from observations.depth import PointCloud
from observations.kinds import InSpace
from priors.anchor.prior import AnchorFrames
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.table import interval, paired
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.cycles import NAMED_NOISE
from recon.fitting.methods import FitOptions

USUAL = ("p=0", "f=5+lm", "f=20+lm", "p=100+lm", "p=1000+lm")
"""Cases of table 1 of Marsot et al. that are run by default, the cheap ones first."""
_JUDGED = 9
"""Every so many frames are compared with the full scans."""
REFERENCE = "network"
"""The method from which the others are told to differ."""
Cells = dict[str, dict[str, dict[str, Any]]]
"""Columns, methods, and of each: errors of every cycle, and CPU seconds of one."""


def told_noise(prior: str, body: BodyModel) -> Fitter:
    """`recon fit` with a prior of poses or steps, told the noise that cycles are completed with.

    A noise told from the data is far too large where few frames follow each other.
    """

    def run(observations: list[InSpace]) -> list[Motion]:
        noise = tuple(None if isinstance(o, PointCloud) else NAMED_NOISE for o in observations)
        return fitted(FitOptions(prior=prior, noise=noise), body)(observations)

    return run


def chosen_by_data(body: BodyModel) -> Fitter:
    """`recon complete`, clip by clip: as one cycle, or as any motion, as the data say."""

    def run(observations: list[InSpace]) -> list[Motion]:
        clips = range(len(observations[0].present if isinstance(observations[0], PointCloud)
                          else observations[0].visible))  # fmt: skip
        return [
            recon.complete([one[k : k + 1] for one in observations], body=body).motion
            for k in clips
        ]

    return run


def compared(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Errors of every method of a column, and their differences from those of the network, mm.

    Intervals are over clips of all people together; the seeds of a cycle are of its clip.
    """
    found: dict[str, Any] = {}
    for name, row in rows.items():
        keys = sorted(set(row["cycles"]) & set(rows[REFERENCE]["cycles"]))
        clips = [key.split("@")[0] for key in keys]
        alike = ["all"] * len(keys)
        of: dict[str, Any] = {"fits": len(keys), "seconds": row["seconds"]}
        for metric in ("chamfer", "vertices"):
            values, others = (
                [one["cycles"][key][metric] for key in keys] for one in (row, rows[REFERENCE])
            )
            own, less = interval(values, clips, alike), paired(values, others, clips, alike)
            of[metric] = [own.mean, own.low, own.high]
            of[f"{metric} less"] = [less.mean, less.low, less.high]
        found[name] = of
    return found


def main() -> None:
    parser = over_windows(__doc__)
    parser.set_defaults(part="validation")
    parser.add_argument("--network", default="open", help="weights of the VAE")
    parser.add_argument("--components", type=Path, nargs="*", default=[], help="their weights")
    parser.add_argument("--columns", nargs="*", choices=COLUMNS, default=USUAL)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--each", type=int, default=2, help="cycles of every subject")
    parser.add_argument("--minutes", type=float, default=None)
    given = parser.parse_args()
    torch.set_num_threads(1)
    began = perf_counter()
    body = BodyModel.load()
    fitters = {"network": partial(completed, given.network, body)}
    for path in given.components:
        size = AnchorFrames.load(str(path), body).code_size
        fitters[f"{size} components"] = partial(completed, str(path), body)
    fitters |= {name: partial(told_noise, name, body) for name in ("pose", "humor")}
    fitters |= {"recon.complete": partial(chosen_by_data, body)}
    cells = earlier(given.json, "cells")
    cycles = _cycles(given.corpus, Splits.load(given.splits), given)
    for seed in range(given.seeds):
        scanned: list[ScannedCycle] = []
        for column, (name, fitter) in product(given.columns, fitters.items()):
            row = cells.setdefault(column, {}).setdefault(name, {"cycles": {}, "seconds": 0.0})
            if any(key.endswith(f"#{seed}") for key in row["cycles"]):
                continue
            if given.minutes is not None and perf_counter() - began > 60 * given.minutes:
                return
            if not scanned:
                scanned = [
                    scanned_cycle(called(c), c.subject, c.motion, body, seed) for c in cycles
                ]
            _run(row, fitter(), column, scanned, seed, body)
            _tell(given, column, cells)


def _run(
    row: dict[str, Any],
    fitter: Fitter,
    column: str,
    scanned: Sequence[ScannedCycle],
    seed: int,
    body: BodyModel,
) -> None:
    """Add the errors of one method in one column with one seed."""
    seen = together([observe(one, COLUMNS[column], body) for one in scanned])
    worked = process_time()
    motions = fitter(seen)
    spent = process_time() - worked
    before = len(row["cycles"])
    for one, motion in zip(scanned, motions, strict=True):
        errors = judged(motion, one, body, _JUDGED)
        row["cycles"][f"{one.name}#{seed}"] = {"subject": one.subject, **errors}
    row["seconds"] = (row["seconds"] * before + spent) / len(row["cycles"])


def _cycles(corpus: Path, splits: Splits, given: Any) -> list[FoundCycle]:
    """Cycles of people who are held out by name; other collections give only single clips."""
    files = clip_files(corpus)
    people = splits.validation if given.part == "validation" else splits.test
    clips = {clip for clip in files if splits.subject(clip) in people}
    return chosen(list(found_cycles(corpus, splits, given.part, clips)), given.each)


def _tell(given: Any, column: str, cells: Cells) -> None:
    done = {
        name: {method: row for method, row in rows.items() if row["cycles"]}
        for name, rows in cells.items()
    }
    tables = {name: compared(rows) for name, rows in done.items() if REFERENCE in rows}
    shown = Table("method", "fits", "Chamfer mm", "less the network's", "vertices mm",
                  "less the network's", "CPU s", title=column)  # fmt: skip
    for name, row in tables[column].items():
        numbers = [
            "{:.1f} ({:.1f} to {:.1f})".format(*row[key])
            for key in ("chamfer", "chamfer less", "vertices", "vertices less")
        ]
        shown.add_row(name, str(row["fits"]), *numbers, f"{row['seconds']:.1f}")
    Console(width=160).print(shown)
    if given.json is not None:
        write(
            given.json, given.seeds, corpus_source(given.corpus), part=given.part,
            tables=tables, cells=done,
        )  # fmt: skip


if __name__ == "__main__":
    main()
