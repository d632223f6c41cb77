"""Completes sparse scans with `recon.complete`: whole recordings, and cycles of gait.

    python -m benchmarks.complete CORPUS --part validation --parts recordings --out FOLDER
    python -m benchmarks.complete CORPUS --parts cycles --weights open --each 3 --out FOLDER

Scanned are bodies of random shapes in clothes (`benchmarks.scans`). Recordings are clips of
held-out people, at most ten seconds of each, of gait and other movements. Cases are scans per
second times points, or the 16 landmarks. Vertices are compared with the true ones at every third
frame. A jump is the change of a joint's displacement from one frame to the next, as a speed; the
largest of a clip, beside the truth's, shows seams.

Cycles are completed under the prior of cycles of gait, from the parts that Marsot et al. observe
(table 1): p points a frame, or f of 100 frames with all points, with the 16 landmarks and without.
The error is the Chamfer distance to the full scans.
"""

import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
import torch

import recon
from benchmarks.protocol import Cell, Table, number, over_windows, tell_of
from benchmarks.scans import (
    FPS,
    ScannedCycle,
    scanned,
    scanned_cycle,
    thinned_frames,
    thinned_landmarks,
    thinned_points,
)
from recon import BodyModel, Motion
from recon.benchmark.dataset import Part, Splits, clip_files, is_flat
from recon.body.cycles import find_cycles
from recon.formats.observations import ObservationFile, PointsFile, PositionsFile, save_observation
from recon.metrics.errors import chamfer_of_clip

SEED, LONGEST, POINTS, JUDGED = 0, 10.0, 500, 3
CLIPS = {
    "validation": ("12_02", "06_02", "10_04", "27_01", "martial_04"),
    "test": ("07_05", "07_12", "49_08", "49_21"),
}
CASES: dict[str, tuple[float, int]] = {
    "50/s x 500": (50, POINTS), "5/s x 500": (5, POINTS), "50/s landmarks": (50, 0),
    "5/s landmarks": (5, 0), "2.5/s landmarks": (2.5, 0),
}  # fmt: skip
"""Scans per second, and points of each; zero points means landmarks."""


@dataclass(frozen=True)
class Shown:
    """The part of a scanned cycle that is observed."""

    points: int | None = None
    """Number of points of every frame; None is all, 0 none."""
    frames: int | None = None
    """Number of frames out of 100; None is all."""
    landmarks: bool = True


SEEN = {
    "16 landmarks in every frame": Shown(points=0),
    "and 50 points": Shown(points=50), "and 100 points": Shown(points=100),
    "and 1,000 points": Shown(points=1000),
    "5 of 100 frames, all points and landmarks": Shown(frames=5),
    "20 of 100 frames, likewise": Shown(frames=20),
    "50 points in every frame, no landmarks": Shown(points=50, landmarks=False),
    "10,000 points, no landmarks": Shown(points=10000, landmarks=False),
    "5 of 100 frames, no landmarks": Shown(frames=5, landmarks=False),
    "20 of 100 frames, no landmarks": Shown(frames=20, landmarks=False),
}  # fmt: skip


def main() -> None:
    """Scan, complete, print and write the tables."""
    arguments = over_windows(__doc__)
    parts = ("recordings", "cycles")
    arguments.add_argument("--parts", nargs="+", choices=parts, default=list(parts))
    arguments.add_argument("--weights", nargs="+", default=["open"], help="of the prior of cycles")
    arguments.add_argument("--each", type=int, default=3, help="cycles of every subject")
    given = arguments.parse_args()
    torch.set_num_threads(1)
    body, splits = BodyModel.load(), Splits.load(given.splits)
    tables: dict[str, Table] = {}
    if "recordings" in given.parts:
        files = clip_files(given.corpus)
        clips = CLIPS[given.part][: given.only]
        tables["recordings"] = recordings({clip: files[clip] for clip in clips}, splits, body)
    if "cycles" in given.parts:
        some = chosen(list(found_cycles(given.corpus, splits, given.part)), given.each)[
            : given.only
        ]
        tables["completion"] = cycles(some, given.weights, splits.apart, body)
    tell_of(given, SEED, tables)


def recordings(files: Mapping[str, Path], splits: Splits, body: BodyModel) -> Table:
    """Measure every case over whole recordings."""
    scans = [
        scanned(clip, splits.subject(clip), _cut(path), body, points=POINTS + 100)
        for clip, path in files.items()
    ]
    rows: list[list[Cell]] = []
    for case, (rate, points) in CASES.items():
        found: list[dict[str, float]] = []
        for one in scans:
            began = process_time()
            motion = completed([thinned(one, rate, points)], "recording", "open", body)
            seconds = process_time() - began
            found.append({**judged(motion, one.truth, body), "seconds": seconds})
        mean = {key: float(np.mean([row[key] for row in found])) for key in found[0]}
        rows.append([case, len(found), *map(number, mean.values())])
    heads = (("clips", 0), ("vertices mm", 1), ("worst tenth of moments", 1),
             ("largest jump m/s", 2), ("true one", 2), ("CPU s", 0))  # fmt: skip
    return Table([("seen", None), *heads], rows)


def thinned(one: ScannedCycle, rate: float, points: int) -> ObservationFile:
    """Return a recording with a lower rate (Hz) and fewer points."""
    step = round(FPS / rate)
    if points == 0:
        seen = one.landmarks
        return replace(seen, positions=seen.positions[::step], visible=seen.visible[::step],
                       fps=FPS / step)  # fmt: skip
    scans = thinned_points(one.scans, points, SEED)
    kept = scans.frame % step == 0
    return replace(scans, points=scans.points[kept], frame=scans.frame[kept] // step,
                   fps=FPS / step)  # fmt: skip


def completed(
    seen: Sequence[ObservationFile], prior: str, weights: str, body: BodyModel
) -> Motion:
    """Return the motion that `recon.complete` makes of files without truth."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{k}.npz" for k in range(len(seen))]
        for path, file in zip(paths, seen, strict=True):
            save_observation(path, replace(file, truth_visible=None))
        return recon.complete(paths, prior, weights=weights, body=body).motion


def judged(motion: Motion, truth: Motion, body: BodyModel) -> dict[str, float]:
    """Return distances of vertices (mm), and the largest jumps (m/s)."""
    last = min(float(motion.times[-1]), float(truth.times[-1])) + 1e-6
    times = truth.times[truth.times <= last][::JUDGED]
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


def _cut(path: Path) -> Motion:
    """Return the first ten seconds of a clip, or all of it."""
    motion = recon.load_motion(path).motion
    return motion.window(0, min(motion.frames, round(LONGEST * motion.fps) + 1))


class FoundCycle(NamedTuple):
    """One cycle of gait at 50 Hz, named by its clip and start time."""

    name: str
    subject: str
    motion: Motion


def found_cycles(corpus: Path, splits: Splits, part: Part) -> Iterator[FoundCycle]:
    """Yield all gait cycles on flat ground of one part, clip by clip."""
    files = clip_files(corpus)
    for name, own in splits.parts(list(files)).items():
        if own != part or not is_flat(files[name]):
            continue
        motion = recon.load_motion(files[name]).motion
        for cycle in find_cycles(motion):
            frames = max(round(cycle.duration * FPS), 2) + 1
            label = f"{name}@{cycle.start:.2f}"
            yield FoundCycle(label, splits.subject(name), cycle.of(motion, frames))


def chosen(found: Sequence[FoundCycle], each: int) -> list[FoundCycle]:
    """Choose `each` cycles of every subject, one per clip, from clips evenly spread over names.

    From every clip it is the middle cycle, so that the choice is not biased.
    """
    by_clip: dict[str, list[FoundCycle]] = defaultdict(list)
    for one in found:
        by_clip[one.name.rsplit("@", 1)[0]].append(one)
    by_subject: dict[str, list[FoundCycle]] = defaultdict(list)
    for _, own in sorted(by_clip.items()):
        by_subject[own[0].subject].append(own[len(own) // 2])
    picked: list[FoundCycle] = []
    for _, own in sorted(by_subject.items()):
        rows = np.unique(np.linspace(0, len(own) - 1, min(each, len(own))).round().astype(int))
        picked += [own[row] for row in rows]
    return picked


def cycles(
    found: Sequence[FoundCycle], weights: Sequence[str], apart: Sequence[str], body: BodyModel
) -> Table:
    """Measure Chamfer distances over cycles, without people who are set apart."""
    scans = [scanned_cycle(c.name, c.subject, c.motion, body) for c in found
             if c.subject not in apart]  # fmt: skip
    rows: list[list[Cell]] = []
    for label, shown in SEEN.items():
        cells: list[Cell] = []
        for own in weights:
            errors = [
                full_scans(completed(observed(one, shown), "anchor", own, body), one, body)
                for one in scans
            ]
            cells.append(f"{np.mean(errors):.1f} ± {np.std(errors):.1f}")
        rows.append([label, *cells])
    return Table([("seen", None), *((f"{own} weights", None) for own in weights)], rows)


def observed(one: ScannedCycle, shown: Shown) -> list[PointsFile | PositionsFile]:
    """Return the observed part of a scanned cycle."""
    scans, landmarks = one.scans, one.landmarks
    if shown.frames is not None:
        scans = thinned_frames(scans, shown.frames)
        landmarks = thinned_landmarks(landmarks, shown.frames)
    elif shown.points:
        scans = thinned_points(scans, shown.points, SEED)
    files = [scans] if shown.points != 0 else []
    return [*files, *([landmarks] if shown.landmarks else [])]


def full_scans(motion: Motion, one: ScannedCycle, body: BodyModel) -> float:
    """Return the Chamfer distance (mm) to every third full scan."""
    scans = one.scans
    last = min(motion.times[-1].item(), one.truth.times[-1].item()) + 1e-6
    kept = (scans.frame % JUDGED == 0) & (scans.frame / scans.fps <= last)
    some = replace(scans, points=scans.points[kept], frame=scans.frame[kept])
    return 1000 * chamfer_of_clip(motion, body, some)


if __name__ == "__main__":
    main()
