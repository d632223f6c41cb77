"""Whole recordings from sparse scans: `recon.complete` with cycles of gait and without.

    python -m benchmarks.recordings CORPUS --json benchmarks/results/recordings.json

Clips of held-out people, at most ten seconds of each, on bodies nobody has and in clothes
(`benchmarks.scans`): gait, and whatever else they do. Cases are scans a second times points, or
the 16 landmarks. `cycles` are the weights of the cycles of gait that join where few moments are
seen; `none` does without them. Vertices are compared with the true ones at every third frame. A
jump is the change of a joint's displacement from one frame to the next, as a speed; the largest of
a clip, beside the largest of the truth at the same rate, shows seams.

What is in the JSON already, of the same commit, is not run again; with `--minutes` the command
ends after the fit that is then under way, and goes on when it is run once more.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

import recon
from benchmarks.arguments import over_windows
from benchmarks.complete import cloud_from
from benchmarks.results import corpus_source, earlier, write
from benchmarks.scans import FPS, ScannedCycle, scanned, thinned_points
from observations.kinds import InSpace
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.table import interval, paired
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.recording import WholeRecording
from recon.formats.motions import load_motion
from recon.reading.points import positions_of

LONGEST, POINTS = 10.0, 500
CLIPS = {
    "validation": ("12_02", "06_02", "10_04", "27_01", "martial_04"),
    "test": ("07_05", "07_12", "49_08", "49_21"),
}
CASES = {
    "50/s x 500": (50, POINTS),
    "5/s x 500": (5, POINTS),
    "50/s landmarks": (50, 0),
    "5/s landmarks": (5, 0),
    "2.5/s landmarks": (2.5, 0),
}
"""Scans a second, and points of each; no points are landmarks."""
_JUDGED = 3


def observed(one: ScannedCycle, rate: float, points: int, body: BodyModel) -> InSpace:
    """A recording of so many moments a second."""
    step = round(FPS / rate)
    if points == 0:
        seen = positions_of(one.landmarks, one.name, body)
        fewer = {"positions": seen.positions[:, ::step], "visible": seen.visible[:, ::step]}
        return seen.derived(fps=FPS / step, **fewer)
    thin = thinned_points(one.scans, points, 0)
    cloud = cloud_from(thin.points, thin.frame, one.truth.frames, points, body)
    fewer = {"points": cloud.points[:, ::step], "present": cloud.present[:, ::step]}
    return cloud.derived(fps=FPS / step, **fewer)


def judged(motion: Motion, truth: Motion, body: BodyModel) -> dict[str, float]:
    """Distances of vertices, mm, and the largest jumps, m/s."""
    last = min(float(motion.times[-1]), float(truth.times[-1])) + 1e-6
    times = truth.times[truth.times <= last][::_JUDGED]
    pair = [body.pose(one.at(times, FPS)).vertices for one in (motion, truth)]
    away = 1000 * (pair[0] - pair[1]).norm(dim=-1).mean(-1)
    every = motion.times[motion.times <= last]
    jumps = [
        body.pose(one.at(every, motion.fps)).joints.diff(n=2, dim=0).norm(dim=-1).max()
        for one in (motion, truth)
    ]
    return {
        "vertices": float(away.mean()),
        "worst_tenth": float(away.quantile(0.9)),
        "jump": float(jumps[0]) * motion.fps,
        "jump_truth": float(jumps[1]) * motion.fps,
    }


def means(rows: dict[str, dict[str, Any]], plain: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Means over clips, and vertices less those without cycles, with 95 % intervals."""
    clips = sorted(set(rows) & set(plain))
    if not clips:
        return {}
    # every clip is one draw of one set of people, so that there is one group
    alike = ["all"] * len(clips)
    values, others = ([every[clip]["vertices"] for clip in clips] for every in (rows, plain))
    own, less = interval(values, clips, alike), paired(values, others, clips, alike)
    told = {
        key: sum(rows[clip][key] for clip in clips) / len(clips)
        for key in ("worst_tenth", "jump", "jump_truth", "seconds")
    }
    return {
        "clips": len(clips),
        "vertices": [own.mean, own.low, own.high],
        "vertices less": [less.mean, less.low, less.high],
        **told,
    }


def main() -> None:
    parser = over_windows(__doc__)
    parser.set_defaults(part="validation")
    parser.add_argument("--clips", nargs="*", default=None)
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--cycles", nargs="*", default=["none", "open"], help="weights, or none")
    parser.add_argument("--steps", choices=("humor", "pose"), default="humor")
    parser.add_argument("--minutes", type=float, default=None)
    given = parser.parse_args()
    torch.set_num_threads(1)
    began, body = perf_counter(), BodyModel.load()
    found: dict[str, dict[str, dict[str, dict[str, Any]]]] = earlier(given.json, "rows")
    files, splits = clip_files(given.corpus), Splits.load(given.splits)
    scans: dict[str, ScannedCycle] = {}
    for case, clip, cycles in product(given.cases, given.clips or CLIPS[given.part], given.cycles):
        rows = found.setdefault(case, {}).setdefault(Path(cycles).stem, {})
        rate, points = CASES[case]
        if clip in rows or (cycles != "none" and rate > 10):
            continue
        if given.minutes is not None and perf_counter() - began > 60 * given.minutes:
            return
        if clip not in scans:
            scans[clip] = scanned(clip, splits.subject(clip), _cut(files[clip]), body,
                                  points=POINTS + 100)  # fmt: skip
        seen = observed(scans[clip], rate, points, body)
        prior = WholeRecording(
            steps=given.steps, cycles=None if cycles == "none" else "anchor",
            cycle_weights="open" if cycles == "none" else cycles,
        )  # fmt: skip
        worked = process_time()
        result = recon.complete(seen, prior, body=body)
        rows[clip] = {
            "seconds": process_time() - worked,
            **judged(result.motion, scans[clip].truth, body),
            "stretches": [one.report() for one in result.stretches],
            "warnings": [finding.message for finding in result.warnings],
        }
        _tell(given, found)


def _cut(path: Path) -> Motion:
    """The first ten seconds of a clip, or all of it."""
    motion = load_motion(path).motion
    count = min(motion.frames, round(LONGEST * motion.fps) + 1)
    return motion.window(0, count)


def _tell(given: Any, found: dict[str, dict[str, dict[str, dict[str, Any]]]]) -> None:
    tables = {
        case: {name: means(rows, every.get("none", rows)) for name, rows in every.items()}
        for case, every in found.items()
    }
    shown = Table("case", "cycles", "clips", "vertices mm", "less none's", "worst tenth",
                  "jump m/s", "true", "CPU s")  # fmt: skip
    for case, every in tables.items():
        for name, row in every.items():
            if row:
                shown.add_row(case, name, str(row["clips"]), _told(row["vertices"]),
                              _told(row["vertices less"]), f"{row['worst_tenth']:.1f}",
                              f"{row['jump']:.2f}", f"{row['jump_truth']:.2f}",
                              f"{row['seconds']:.1f}")  # fmt: skip
    Console(width=140).print(shown)
    if given.json is not None:
        write(
            given.json, 0, corpus_source(given.corpus), part=given.part, steps=given.steps,
            tables=tables, rows=found,
        )  # fmt: skip


def _told(numbers: Sequence[float]) -> str:
    return "{:.1f} ({:.1f} to {:.1f})".format(*numbers)


if __name__ == "__main__":
    main()
