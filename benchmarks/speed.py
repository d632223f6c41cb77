"""Measures CPU time and memory of fits, long recordings, streams and batches.

    python -m benchmarks.speed CORPUS --out FOLDER
    python -m benchmarks.speed CORPUS --parts batch --clips 32 --out FOLDER

All run on one thread. `speed` fits one clip of two seconds, and sixteen. `long` fits the longest
clip, played forwards and backwards for each duration, in a process of its own whose peak memory is
printed: where it turns round, every joint's velocity changes sign at once. The largest change of a
joint's velocity from one frame to the next shows seams. `live` pushes the longest clips of
subjects frame by frame, compared with fits of whole clips; `hour` pushes an hour of the longest as
fast as possible. `batch` runs `recon batch` on the listed windows, and counts CPU seconds of all
processes. Joints have 4 cm of noise per coordinate.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from argparse import SUPPRESS
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import recon
from benchmarks.protocol import Cell, Table, demo_clip, number, over_windows, tell_of
from recon import BodyModel, Motion
from recon.benchmark.dataset import Splits, clip_files
from recon.benchmark.protocols import noisy_joints
from recon.benchmark.windows import FPS, FRAMES, load_windows
from recon.core.skeleton import JOINTS
from recon.formats.observations import PositionsFile, save_observation

SEED, NOISE, PRIORS, LAGS = 0, 0.04, ("pose", "humor"), (0, 5, 15)
SECONDS = (10, 20, 40, 60)
Row = dict[str, float]


def main() -> None:
    """Measure all parts, print and write the tables."""
    arguments = over_windows(__doc__)
    parts = ("speed", "long", "live", "hour", "batch")
    arguments.add_argument("--parts", nargs="+", choices=parts, default=list(parts))
    arguments.add_argument("--clips", type=int, default=64, help="of the batch")
    arguments.add_argument("--processes", type=int, default=2, help="of the batch")
    arguments.add_argument("--alone", nargs=3, default=None, help=SUPPRESS)
    given = arguments.parse_args()
    torch.set_num_threads(1)
    if given.alone is not None:
        prior, file, seconds = given.alone
        print(json.dumps(over_long(prior, Path(file), int(seconds))))
        return
    files = clip_files(given.corpus)
    splits = Splits.load(given.splits)
    longest = longest_clips(files, splits, given.part)[: given.only]
    made: dict[str, Callable[[], Table]] = {
        "speed": fitting,
        "long": lambda: long_recordings(given.corpus, files[longest[0]], longest[0]),
        "live": lambda: streams([recon.load_motion(files[clip]).motion for clip in longest]),
        "hour": lambda: hour(recon.load_motion(files[longest[0]]).motion.resample(FPS)),
        "batch": lambda: batches(
            load_windows(given.corpus, splits, given.part, BodyModel.load(), SEED).truth,
            given.clips,
            given.processes,
        ),
    }
    tables = {name: make() for name, make in made.items() if name in given.parts}
    tell_of(given, SEED, tables, [files[clip] for clip in longest])


def longest_clips(files: Mapping[str, Path], splits: Splits, part: str) -> list[str]:
    """Return the longest clip of every subject of a part, the longest of all first."""
    parts = splits.parts(list(files))
    motions = {c: recon.load_motion(files[c]).motion for c in parts if parts[c] == part}
    of_subject: dict[str, str] = {}
    for clip in sorted(motions, key=lambda c: -motions[c].frames / motions[c].fps):
        of_subject.setdefault(splits.subject(clip), clip)
    return list(of_subject.values())


def fitting() -> Table:
    """Build a table of median CPU seconds of fits of one clip, and of sixteen."""
    motion = demo_clip(FRAMES)
    one = recon.simulate(motion, "joints3d", noise=NOISE, seed=SEED)
    many = [recon.simulate(motion, "joints3d", noise=NOISE, seed=k) for k in range(16)]
    calls: dict[str, tuple[Callable[[], object], int]] = {
        "fit of one clip of 2 s, pose prior, s": (lambda: recon.fit(one, "pose"), 3),
        "fit of one clip of 2 s, HuMoR, s": (lambda: recon.fit(one), 3),
        "fits of sixteen such clips, pose prior, s":
            (lambda: recon.fit_clips(many, "pose"), 1),
    }  # fmt: skip
    rows: list[list[Cell]] = []
    for name, (call, rounds) in calls.items():
        call()
        spent = []
        for _ in range(rounds):
            began = time.process_time()
            call()
            spent.append(time.process_time() - began)
        rows.append([name, number(float(np.median(spent)))])
    return Table([("one thread", None), ("CPU time", 2)], rows)


def there_and_back(motion: Motion, seconds: float) -> Motion:
    """Play a clip forwards and backwards for so many seconds; its clock starts at 0."""
    period = 2 * (motion.frames - 1)
    place = torch.arange(round(seconds * motion.fps)) % period
    place = torch.minimum(place, period - place)
    return Motion.create(
        motion.translation[place], motion.rotations[place], motion.shape, motion.fps
    )


def long_recordings(corpus: Path, file: Path, clip: str) -> Table:
    """Build a table of fits of every duration under both priors, each in a new process."""
    rows: list[list[Cell]] = []
    for prior, label in (("humor", "collocation"), ("pose", "pose prior")):
        for seconds in SECONDS:
            command = [sys.executable, "-m", "benchmarks.speed", str(corpus), "--alone"]
            done = subprocess.run(
                [*command, prior, str(file), str(seconds)], stdout=subprocess.PIPE, check=True,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )  # fmt: skip
            row = json.loads(done.stdout)
            rest = (number(row[key]) for key in ("jump", "jump_truth"))
            rows.append([f"{label}, {clip}, {seconds} s", number(row["cpu"]), number(row["mb"]),
                         number(row["error"], 100), *rest])  # fmt: skip
    heads = (("CPU s", 0), ("peak MB", 0), ("error cm", 2),
             ("largest change of velocity m/s", 2), ("the truth's m/s", 2))  # fmt: skip
    return Table([("4 cm of noise", None), *heads], rows)


def over_long(prior: str, file: Path, seconds: int) -> Row:
    """Fit one long recording in this process; return CPU time, memory and errors."""
    body = BodyModel.load()
    truth = there_and_back(recon.load_motion(file).motion.resample(FPS), seconds)
    seen = noisy_joints(truth[None], body, SEED, NOISE)
    began = time.process_time()
    result = recon.fit(seen, prior, body=body, noise=NOISE)
    row = {"cpu": time.process_time() - began}
    row["mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    motion = result.motion
    joints, true = (body.pose(m).joints for m in (motion, truth.at(motion.times, motion.fps)))
    return row | compared(joints, true)


def streams(recorded: list[Motion], seconds: float = 6.0) -> Table:
    """Build a table of streams of several lags, compared with fits of whole clips, over clips."""
    body, found = BodyModel.load(), dict[str, list[Row]]()
    for motion in recorded:
        whole = motion.resample(FPS)
        truth = whole.window(0, min(whole.frames, round(seconds * FPS))).replace(start_time=0.0)
        seen, true = noisy_joints(truth[None], body, SEED, NOISE), body.pose(truth).joints
        for prior in PRIORS:
            for lag in LAGS:
                found.setdefault(f"{prior}, lag {lag}", []).append(pushed(seen, true, prior, lag))
            offline = recon.fit(seen, prior, body=body, noise=NOISE).joints
            found.setdefault(f"offline, {prior}", []).append(compared(offline, true))
    rows: list[list[Cell]] = []
    for name, own in found.items():
        pairs = zip(own, found["offline, pose"], strict=True)
        ratio = float(np.mean([row["error"] / other["error"] for row, other in pairs]))
        mean = {key: float(np.mean([row[key] for row in own])) for key in own[0]}
        times = (number(mean.get(key)) for key in ("median", "longest"))
        rows.append([name, number(mean["error"], 100), number(ratio), *times])
    heads = (("error cm", 2), ("of offline, pose", 3), ("CPU ms a push, median", 0),
             ("longest", 0))  # fmt: skip
    return Table([("4 cm of noise", None), *heads], rows)


def hour(motion: Motion, minutes: int = 60) -> Table:
    """Build a table of an hour-long stream of one clip, played back and forth (pose prior)."""
    period, body = there_and_back(motion, 2 * (motion.frames - 1) / FPS), BodyModel.load()
    seen = noisy_joints(period[None], body, SEED, NOISE)
    row = pushed(seen, body.pose(period).joints, "pose", 15, minutes * 60 * round(FPS))
    heads = {"median": "CPU ms a push, median", "p95": "95 %", "longest": "longest",
             "mb": "MB more after the first minute", "jump": "largest change of velocity m/s",
             "jump_truth": "the truth's m/s"}  # fmt: skip
    columns = [("4 cm of noise", None), ("error cm", 2), *((name, 1) for name in heads.values())]
    cells = [number(row["error"], 100), *(number(row[key]) for key in heads)]
    return Table(columns, [[f"pose, lag 15, {minutes} minutes", *cells]])


def pushed(
    seen: recon.Joints3D, true: Tensor, prior: str, lag: int, moments: int | None = None
) -> Row:
    """Push a clip frame by frame, repeatedly if there are more frames than it has."""
    known = true[torch.arange(moments or len(true)) % len(true)]
    joints, rows = torch.full_like(known, torch.nan), iter(range(len(known)))
    stream, spent, peaks = recon.Stream(prior, lag), list[float](), list[float]()
    for k in range(len(known)):
        one = seen[0].window(k % len(true) / FPS, k % len(true) / FPS)
        began = time.process_time()
        estimate = stream.push(one, k / FPS)
        spent.append(1000 * (time.process_time() - began))
        for told in () if estimate is None else estimate.every:
            joints[next(rows)] = told.joints
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    for told in stream.finish():
        joints[next(rows)] = told.joints
    row = {"median": float(np.median(spent)), "p95": float(np.quantile(spent, 0.95))}
    row |= {"longest": max(spent), "mb": peaks[-1] - peaks[: 60 * round(FPS)][-1]}
    return row | compared(joints, known)


def compared(joints: Tensor, true: Tensor) -> Row:
    """Return the mean distance of joints (m), and the largest changes of velocity (m/s)."""
    true = true[: len(joints)]
    own, best = (float(p.diff(n=2, dim=0).norm(dim=-1).max() * FPS) for p in (joints, true))
    return {"error": float((joints - true).norm(dim=-1).mean()), "jump": own, "jump_truth": best}


def cost_of(*words: str, folder: Path) -> tuple[float, float]:
    """Return CPU seconds of all processes of a `recon batch`, and memory (MB) of the largest.

    Raises:
        RuntimeError: when a clip was not fitted.
    """
    log = folder / "log"
    with log.open("w") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "recon", "batch", *words], cwd=folder, stdout=file,
            stderr=file, env={**os.environ, "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"{process.args}: {log.read_text(encoding='utf-8')}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def batches(truth: Motion, count: int, processes: int) -> Table:
    """Build a table of `recon batch` under both priors."""
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        manifest(folder, truth, count)
        for prior in PRIORS[::-1]:
            how = ("--prior", prior, "--processes", str(processes))
            cpu, mb = cost_of("all.jsonl", "--out", prior, *how, folder=folder)
            found = fitted_joints(folder / prior, count)
            true = BodyModel.load().pose(truth).joints.double().numpy()
            known = true[np.arange(count) % len(true)]
            error = float(np.linalg.norm(found - known, axis=-1).mean())
            rows.append([f"`{prior}`", number(cpu / count), number(mb), number(error, 100)])
    heads = (("CPU s a clip", 2), ("MB a process", 0), ("error cm", 2))
    title = (f"{count} clips, {processes} processes", None)
    return Table([title, *heads], rows)


def manifest(folder: Path, truth: Motion, count: int) -> None:
    """Write observation files of noisy joints, windows repeatedly with other noise if needed."""
    body, lines = BodyModel.load(), list[str]()
    for k in range(count):
        seen = noisy_joints(truth[[k % len(truth.translation)]], body, SEED + k, NOISE)
        positions, visible = seen.positions[0].double().numpy(), seen.visible[0].numpy()
        file = PositionsFile("joints3d", positions, visible, JOINTS, seen.fps)
        save_observation(folder / f"{k}.npz", file)
        lines.append(json.dumps({"id": str(k), "observations": f"{k}.npz"}) + "\n")
    (folder / "all.jsonl").write_text("".join(lines), encoding="utf-8")


def fitted_joints(folder: Path, count: int) -> np.ndarray:
    """Read the joints (m) of all results, axes (clips, time, joints, 3)."""
    body = BodyModel.load()
    motions = [recon.load_motion(folder / f"{k}.npz").motion for k in range(count)]
    return np.stack([body.pose(motion).joints.double().numpy() for motion in motions])


if __name__ == "__main__":
    main()
