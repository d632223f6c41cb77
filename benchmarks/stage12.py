"""Stages 1 and 2 on the listed test windows: a body with a pose prior against plain smoothers.

    python -m benchmarks.stage12 CORPUS --json stage12.json
    python -m benchmarks.stage12 CORPUS --part validation

Two protocols of HuMoR's Table 2: 22 joints with 4 cm of noise per coordinate, and 43 points of
the skin of which those below 0.9 m are hidden. Smoothers are tuned on the validation windows;
so are the presets `PoseWeights.tuned_*`. All windows of a protocol are fitted as one batch.
Values are means over a subject's windows, then over subjects.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from benchmarks.scores import (
    Columns,
    Rows,
    fit_windows,
    score,
    score_points,
    subject_mean,
    tables,
)
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.dataset import Splits
from recon.benchmark.methods import butterworth, whittaker
from recon.benchmark.protocols import noisy_joints, occluded_points
from recon.benchmark.windows import FPS, TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.method.protocols import Observation
from recon.method.reconstruction import solve

SEED = 0
CUTOFFS = tuple(np.arange(2.0, 6.01, 0.25).tolist())
STIFFNESSES = tuple(np.geomspace(1.0, 1000.0, 25).tolist())

JOINT_COLUMNS: Columns = {
    "joints_all": ("all", 100), "joints_legs": ("legs", 100), "vertices": ("vertices", 100),
    "accel": ("accel", 1), "accel_error": ("accel error", 1),
    "penetration_freq": ("pen. %", 100), "penetration_dist": ("pen. cm", 100),
}  # fmt: skip
POINT_COLUMNS: Columns = {
    "observed_all": ("all", 100), "observed_visible": ("visible", 100),
    "observed_hidden": ("hidden", 100),
    **{k: v for k, v in JOINT_COLUMNS.items() if k != "joints_all"},
}  # fmt: skip


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--prior", type=Path, default=None, help="weights; default: bundled")
    arguments = parser.parse_args()

    body, splits = BodyModel.load(), Splits.load(arguments.splits)
    windows = load_windows(arguments.corpus, splits, arguments.part, body, SEED)
    tuning = load_windows(arguments.corpus, splits, "validation", body, SEED)
    prior = PosePrior.load(arguments.prior)

    smoothers = tune_smoothers(tuning, body)
    found = {
        "noisy joints": noisy_rows(windows, body, prior, smoothers),
        "occluded points": occluded_rows(windows, body, prior),
    }
    speed = measure_speed(windows, body, prior)

    console = Console(width=None if sys.stdout.isatty() else 140)
    for name, columns in (("noisy joints", JOINT_COLUMNS), ("occluded points", POINT_COLUMNS)):
        for row in tables(f"{name}: {arguments.part}", columns, found[name]):
            console.print(row)
    console.print(", ".join(f"{k} {v:.3g}" for k, v in speed.items()))
    if arguments.json is not None:
        tuned = {name: value for name, (_, value) in smoothers.items()}
        about = {"part": arguments.part, "windows": windows.about, "smoothers": tuned}
        source = corpus_source(arguments.corpus, (*windows.files, *tuning.files))
        write(arguments.json, SEED, source, **about, tables=found, speed=speed)


Smoother = Callable[[Tensor], Tensor]


def tune_smoothers(tuning: TrueWindows, body: BodyModel) -> dict[str, tuple[Smoother, float]]:
    """Smoothers at their best setting on validation, and the filter at 2, 2.5 and 3 Hz."""
    seen = noisy_joints(tuning.truth, body, SEED + 1).positions
    truth = body.pose(tuning.truth).joints

    def error(points: Tensor) -> float:
        return subject_mean(tuning, (points - truth).norm(dim=-1).mean((1, 2)))

    cutoff = min(CUTOFFS, key=lambda f: error(butterworth(seen, FPS, f)))
    stiffness = min(STIFFNESSES, key=lambda s: error(whittaker(seen, s)))
    found: dict[str, tuple[Smoother, float]] = {
        f"Butterworth {f:g} Hz": (lambda x, f=f: butterworth(x, FPS, f), f)
        for f in (2.0, 2.5, 3.0)
    }
    found[f"Butterworth, tuned ({cutoff:g} Hz)"] = lambda x: butterworth(x, FPS, cutoff), cutoff
    found[f"least squares, tuned ({stiffness:.3g})"] = lambda x: whittaker(x, stiffness), stiffness
    return found


def noisy_rows(
    windows: TrueWindows,
    body: BodyModel,
    prior: PosePrior,
    smoothers: dict[str, tuple[Smoother, float]],
) -> dict[str, Rows]:
    observed = noisy_joints(windows.truth, body, SEED)
    truth = body.pose(windows.truth).joints
    rows = {"observed": score_points(windows, observed.positions, truth)}
    for name, (smooth, _) in smoothers.items():
        rows[name] = score_points(windows, smooth(observed.positions), truth)
    for name, weights in (
        ("stages 1-2, published", PoseWeights.published_joints()),
        ("stages 1-2, tuned", PoseWeights.for_noise(0.04)),
    ):
        fitted = fit_windows(observed, prior.replace(weights=weights), body, len(truth))
        rows[name] = score(windows, fitted, body)
    return rows


def occluded_rows(windows: TrueWindows, body: BodyModel, prior: PosePrior) -> dict[str, Rows]:
    observed, truth = occluded_points(windows.truth, body)
    rows: dict[str, Rows] = {}
    for name, weights in (
        ("stages 1-2, published", PoseWeights.published_points()),
        ("stages 1-2, tuned", PoseWeights.for_noise(0.0)),
    ):
        fitted = fit_windows(observed, prior.replace(weights=weights), body, len(truth))
        rows[name] = score(windows, fitted, body, truth, observed.visible)
    return rows


def measure_speed(windows: TrueWindows, body: BodyModel, prior: PosePrior) -> dict[str, float]:
    """Seconds of stages 1 and 2 (tuned weights, noisy joints): one clip, and sixteen at once."""
    method = prior.replace(weights=PoseWeights.for_noise(0.04))
    found = {"threads": float(torch.get_num_threads())}
    for count in (1, 16):
        observed: Observation = noisy_joints(windows.truth[:count], body, SEED)
        solve([observed], method, body)  # once before, to warm up
        began = time.perf_counter()
        solve([observed], method, body)
        found[f"seconds for {count}"] = time.perf_counter() - began
    found["clips per second"] = 16 / found["seconds for 16"]
    return found


if __name__ == "__main__":
    main()
