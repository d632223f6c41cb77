"""A stream against the offline fit: errors, seams, time per push and memory.

    python -m benchmarks.live CORPUS --json live.json
    python -m benchmarks.live CORPUS --part validation --clips 4

The longest clip of every subject, its first seconds at 30 Hz, 22 joints with 4 cm of noise per
coordinate, pushed one moment after the other; and the same moments fitted at once. Then one clip
is run there and back again for minutes. Times are CPU seconds of one thread: of a busy machine
they are an upper bound. The step is the 99th percentile of how far a joint moves from one frame to
the next, and that of the truth; a seam would make it larger.
"""

import resource
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.long import there_and_back
from benchmarks.results import corpus_source, write
from observations.joints3d import Joints3D
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.protocols import noisy_joints
from recon.benchmark.windows import FPS
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.methods import FitOptions, method_of
from recon.formats.motions import load_motion
from recon.live.stream import Stream
from recon.method.reconstruction import solve

SEED, NOISE = 0, 0.04
LAGS = (0, 5, 15)
PRIORS = ("pose", "humor")

Row = dict[str, float]


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--clips", type=int, default=8, help="so many subjects")
    parser.add_argument("--seconds", type=float, default=6.0, help="of every clip")
    parser.add_argument("--minutes", type=float, default=2.0, help="of the long stream")
    parser.add_argument("--priors", choices=PRIORS, nargs="+", default=list(PRIORS))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    splits = Splits.load(arguments.splits)
    files = clip_files(arguments.corpus)
    chosen = longest(files, splits, arguments.part, arguments.clips)
    rows: dict[str, dict[str, Row]] = {}
    for clip in chosen:
        motion = load_motion(files[clip]).motion.resample(FPS)
        truth = motion.window(0, min(motion.frames, round(arguments.seconds * FPS)))
        rows[clip] = measured(truth.replace(start_time=0.0), body, arguments.priors)
        Console().print(shown(clip, rows[clip]))
    first = load_motion(files[chosen[0]]).motion.resample(FPS)
    whole = there_and_back(first, 60 * arguments.minutes)
    minutes = {f"{prior}, lag 15": for_minutes(whole, body, prior) for prior in arguments.priors}
    Console().print(shown(f"{arguments.minutes:g} minutes", minutes))
    if arguments.json is not None:
        write(
            arguments.json, SEED, corpus_source(arguments.corpus, [files[c] for c in chosen]),
            part=arguments.part, seconds=arguments.seconds, minutes=arguments.minutes,
            rows=rows, long_stream=minutes,
        )  # fmt: skip


def longest(files: dict[str, Path], splits: Splits, part: str, count: int) -> list[str]:
    """The longest clip of every subject of a part, the longest of all first."""
    of_subject: dict[str, str] = {}
    parts = splits.parts(list(files))
    frames = {c: load_motion(files[c]).motion for c in parts if parts[c] == part}
    seconds = {c: m.frames / m.fps for c, m in frames.items()}
    for clip in sorted(seconds, key=lambda c: -seconds[c]):
        of_subject.setdefault(splits.subject(clip), clip)
    return list(of_subject.values())[:count]


def measured(truth: Motion, body: BodyModel, priors: Sequence[str]) -> dict[str, Row]:
    """One clip: every lag, and both offline fits."""
    seen = noisy_joints(truth.map(lambda tensor: tensor[None]), body, SEED, NOISE)
    true = body.pose(truth).joints
    rows = {
        f"{prior}, lag {lag}": streamed(seen, true, lag, prior) for prior in priors for lag in LAGS
    }
    for prior in priors:
        began = time.process_time()
        motion = solve([seen], method_of(FitOptions(prior=prior), NOISE, body), body).clip(0)
        spent = (time.process_time() - began) / truth.frames
        rows[f"offline, {prior}"] = {"mean_ms": 1000 * spent} | compared(
            body.pose(motion).joints, true
        )
    return rows


def streamed(seen: Joints3D, true: Tensor, lag: int, prior: str) -> Row:
    """A clip pushed moment by moment."""
    stream = Stream(prior, lag)
    found: list[Tensor] = []
    spent: list[float] = []
    for moment in range(seen.moments):
        one = seen[0].window(moment / FPS, moment / FPS)
        began = time.process_time()
        estimate = stream.push(one, moment / FPS)
        spent.append(1000 * (time.process_time() - began))
        found += [] if estimate is None else [each.joints for each in estimate.every]
    found += [each.joints for each in stream.finish()]
    return {
        "median_ms": float(np.median(spent)), "p95_ms": float(np.quantile(spent, 0.95)),
        "longest_ms": max(spent),
    } | compared(torch.stack(found), true)  # fmt: skip


def for_minutes(truth: Motion, body: BodyModel, prior: str) -> Row:
    """A long stream of lag 15, and how the memory of the process grows."""
    seen = noisy_joints(truth.map(lambda tensor: tensor[None]), body, SEED, NOISE)
    half = seen.moments // 2
    true = body.pose(truth).joints
    stream, spent, sizes = Stream(prior, lag=15), [], [0.0, 0.0]
    # its memory is there from the beginning, so that what grows is the stream's
    found, count = torch.zeros_like(true), 0
    for moment in range(seen.moments):
        one = seen[0].window(moment / FPS, moment / FPS)
        began = time.process_time()
        estimate = stream.push(one, moment / FPS)
        spent.append(1000 * (time.process_time() - began))
        for each in () if estimate is None else estimate.every:
            found[count], count = each.joints, count + 1
        if moment in (half, seen.moments - 1):
            sizes[moment != half] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "median_ms": float(np.median(spent)), "p95_ms": float(np.quantile(spent, 0.95)),
        "longest_ms": max(spent), "mb_at_half": sizes[0], "mb_at_end": sizes[1],
    } | compared(found[:count], true[:count])  # fmt: skip


def compared(joints: Tensor, true: Tensor) -> Row:
    """Errors and steps, metres."""
    return {
        "error": float((joints - true).norm(dim=-1).mean()),
        "step": float(_steps(joints).quantile(0.99)),
        "step_truth": float(_steps(true).quantile(0.99)),
    }


def _steps(joints: Tensor) -> Tensor:
    return joints.diff(dim=0).norm(dim=-1).flatten()[:4_000_000]


def shown(title: str, rows: dict[str, Row]) -> Table:
    table = Table(title=title, title_justify="left")
    names = ("error", "step", "step_truth", "median_ms", "p95_ms", "longest_ms", "mean_ms")
    for name in ("", *names):
        table.add_column(name, justify="right")
    for label, row in rows.items():
        table.add_row(label, *(f"{row[n]:.4g}" if n in row else "–" for n in names))
    return table


if __name__ == "__main__":
    main()
