"""Long recordings by overlapping windows: time, memory, seams, and the error of one piece.

    python -m benchmarks.long CORPUS --json long.json
    python -m benchmarks.long CORPUS --prior pose --clips 3

The longest test clips at 30 Hz, 22 joints with 4 cm of noise per coordinate. No clip lasts 60 s,
so each is run there and back again until it does: where it turns round, every joint's velocity
changes sign at once. Every length is fitted in a process of its own, on one thread; its peak
memory is that of the whole process. Speeds are those of the 22 joints of the estimate. A border is
the first or last frame of a window inside the recording; the jump there is the change of a joint's
displacement from one frame to the next, as a speed. `in one piece` is the error of the same
recording fitted without windows.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Literal

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.arguments import over_windows
from benchmarks.results import corpus_source, write
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.protocols import noisy_joints
from recon.benchmark.windows import FPS
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.long import fit_long
from recon.fitting.methods import FitOptions, method_of
from recon.formats.motions import load_motion
from recon.method.reconstruction import solve

SEED, NOISE = 0, 0.04
SECONDS = (10, 20, 40, 60)

COLUMNS: dict[str, tuple[str, float]] = {
    "cpu_seconds": ("CPU s", 1), "peak_mb": ("peak MB", 1),
    "error": ("error cm", 100), "error_in_one_piece": ("in one piece", 100),
    "speed": ("99 % speed m/s", 1), "jump": ("largest jump", 1),
    "jump_truth": ("true one there", 1), "border_speed": ("99 % speed there", 1),
}  # fmt: skip
"""Metric: its heading, and what turns metres into centimetres."""

Row = dict[str, float]


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--prior", choices=("humor", "pose"), nargs="+", default=["humor", "pose"])
    parser.add_argument("--clips", type=int, default=1, help="so many of the longest")
    parser.add_argument("--seconds", type=int, nargs="+", default=SECONDS)
    parser.add_argument("--alone", nargs=4, default=None, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.alone is not None:
        prior, file, seconds, way = arguments.alone
        print(json.dumps(measure(prior, Path(file), int(seconds), way)))
        return

    files = clip_files(arguments.corpus)
    parts = Splits.load(arguments.splits).parts(list(files))
    lengths = {clip: duration(files[clip]) for clip in parts if parts[clip] == arguments.part}
    clips = sorted(lengths, key=lambda clip: -lengths[clip])[: arguments.clips]
    rows: dict[str, dict[str, dict[str, Row]]] = {}
    console = Console(width=None if sys.stdout.isatty() else 140)
    for prior in arguments.prior:
        rows[prior] = {
            clip: {
                f"{seconds} s": in_a_process(arguments.corpus, prior, files[clip], seconds)
                for seconds in arguments.seconds
            }
            for clip in clips
        }
        for clip, found in rows[prior].items():
            console.print(shown(f"{prior}: {clip} ({lengths[clip]:.1f} s)", found))
    if arguments.json is not None:
        write(
            arguments.json, SEED, corpus_source(arguments.corpus),
            part=arguments.part, seconds_of_clips={c: lengths[c] for c in clips}, rows=rows,
        )  # fmt: skip


def in_a_process(corpus: Path, prior: str, file: Path, seconds: int) -> Row:
    """One length, by windows and in one piece where that is short, each in a fresh process."""

    def run(way: str) -> Row:
        command = [sys.executable, "-m", "benchmarks.long", str(corpus), "--alone"]
        done = subprocess.run(
            [*command, prior, str(file), str(seconds), way],
            env={**os.environ, "OMP_NUM_THREADS": "1"}, stdout=subprocess.PIPE, check=True,
        )  # fmt: skip
        return json.loads(done.stdout)

    row = run("windows")
    if seconds <= min(SECONDS):
        row["error_in_one_piece"] = run("whole")["error"]
    return row


def measure(prior: Literal["humor", "pose"], file: Path, seconds: int, way: str) -> Row:
    """Fit one recording in this process."""
    torch.set_num_threads(1)
    body = BodyModel.load()
    truth = there_and_back(load_motion(file).motion.resample(FPS), seconds)
    seen = noisy_joints(truth.map(lambda tensor: tensor[None]), body, SEED, NOISE)
    method = method_of(FitOptions(prior=prior), NOISE, body)
    began, worked = time.perf_counter(), time.process_time()
    if way == "whole":
        motion, windows = solve([seen], method, body).clip(0), ()
    else:
        result = fit_long([seen], method, body)
        motion, windows = result.clip(0), result.windows
    row = {
        "cpu_seconds": time.process_time() - worked,
        "seconds": time.perf_counter() - began,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "windows": float(len(windows)),
    }
    truth = truth.at(motion.times, motion.fps)
    joints, true = body.pose(motion).joints, body.pose(truth).joints
    return (
        row
        | {"error": float((joints - true).norm(dim=-1).mean())}
        | seams(joints, true, borders(windows, motion))
    )


def borders(windows: tuple[tuple[float, float], ...], motion: Motion) -> list[int]:
    """Frames at which a window begins or ends inside the recording."""
    frames = {round((moment - motion.start_time) * motion.fps) for w in windows for moment in w}
    return sorted(frame for frame in frames if 0 < frame < motion.frames - 1)


def seams(joints: Tensor, true: Tensor, at: list[int]) -> Row:
    """Speeds in m/s: of the whole clip, at the borders, and the jumps there."""
    speed = joints.diff(dim=0).norm(dim=-1) * FPS
    row = {"speed": float(speed.quantile(0.99))}
    if not at:
        return row
    before = torch.tensor(at) - 1
    jump, jump_truth = (p.diff(n=2, dim=0)[before].norm(dim=-1) * FPS for p in (joints, true))
    there = torch.cat((speed[before], speed[before + 1]))
    return row | {
        "jump": float(jump.max()),
        "jump_truth": float(jump_truth.max()),
        "border_speed": float(there.quantile(0.99)),
    }


def there_and_back(motion: Motion, seconds: float) -> Motion:
    """A clip run forwards, backwards and so on until it lasts so long; its clock starts at 0."""
    period = 2 * (motion.frames - 1)
    place = torch.arange(round(seconds * motion.fps)) % period
    place = torch.minimum(place, period - place)
    return Motion.create(
        motion.translation[place], motion.rotations[place], motion.shape, motion.fps
    )


def duration(file: Path) -> float:
    motion = load_motion(file).motion
    return motion.frames / motion.fps


def shown(title: str, rows: dict[str, Row]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("recording")
    for heading, _ in COLUMNS.values():
        table.add_column(heading, justify="right")
    for name, row in rows.items():
        cells = (
            f"{row[key] * factor:.2f}" if key in row else "–"
            for key, (_, factor) in COLUMNS.items()
        )
        table.add_row(name, *cells)
    return table


if __name__ == "__main__":
    main()
