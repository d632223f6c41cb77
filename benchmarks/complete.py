"""Completing sparse scans of gait cycles: Chamfer distance to the full scans, and vertex error.

python -m benchmarks.complete CORPUS --weights nc --json benchmarks/results/complete_nc.json

Columns are those of Marsot et al., table 1: p points a frame, or f of 100 frames with all points;
each with the 16 landmarks (+lm) and without. Test cycles, each of a body and in clothes of its
own (benchmarks/scans.py). The row of the truth is the bare body in its true motion. `frames` fits
every frame for itself, `smooth` is the same pose prior with its smoothness; `pose` and `humor` are
what `recon fit` does with these priors, whose noise it tells from the data.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from benchmarks.arguments import over_windows
from benchmarks.cycles import FoundCycle, chosen, found_cycles
from benchmarks.results import corpus_source, write
from benchmarks.scans import (
    ScannedCycle,
    scanned_cycle,
    thinned_frames,
    thinned_landmarks,
    thinned_points,
)
from observations.curvature import Surfels
from observations.depth import PointCloud
from observations.files.points import positions_of
from observations.kinds import InSpace
from priors.anchor.prior import AnchorFit
from priors.pose.prior import PosePrior, PoseWeights
from recon.benchmark.dataset import Part, Splits
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.struct import concatenate
from recon.fitting.clip import fit_clip
from recon.fitting.cycles import NAMED_NOISE, complete
from recon.fitting.methods import FitOptions
from recon.method.reconstruction import solve
from recon.metrics.errors import chamfer_of_clip

READ = 512
"""Most points of a frame that the command keeps when it reads scans."""
_JUDGED = 3
"""Every so many frames are compared with the full scans."""


@dataclass(frozen=True)
class Column:
    """What of a scanned cycle is observed."""

    points: int | None = None
    """Points of every frame; None is all, 0 none."""
    frames: int | None = None
    """Frames out of 100; None is all."""
    landmarks: bool = True


COLUMNS = {
    "p=0": Column(points=0),
    **{f"p={p}+lm": Column(points=p) for p in (50, 100, 1000, 10000)},
    **{f"p={p}": Column(points=p, landmarks=False) for p in (50, 100, 1000, 10000)},
    **{f"f={f}+lm": Column(frames=f) for f in (5, 20, 100)},
    **{f"f={f}": Column(frames=f, landmarks=False) for f in (5, 20, 100)},
}
Fitter = Callable[[list[InSpace]], list[Motion]]


def observe(scanned: ScannedCycle, column: Column, body: BodyModel) -> list[InSpace]:
    """The observations of one cycle."""
    scans, landmarks = scanned.scans, scanned.landmarks
    if column.frames is not None:
        scans = thinned_frames(scans, column.frames)
        landmarks = thinned_landmarks(landmarks, column.frames)
    found: list[InSpace] = []
    if column.points != 0:
        most = min(column.points or READ, READ)
        thin = thinned_points(scans, most, 0)
        found.append(cloud_from(thin.points, thin.frame, scanned.truth.frames, most, body))
    if column.landmarks:
        found.append(positions_of(landmarks, scanned.name, body))
    return found


def together(cycles: Sequence[list[InSpace]]) -> list[InSpace]:
    """Observations of several cycles as one batch; shorter ones see nothing at their end."""
    return [concatenate([_longer(o, kind) for o in kind]) for kind in zip(*cycles, strict=True)]


def completed(weights: str, body: BodyModel, kind: type[AnchorFit] = AnchorFit) -> Fitter:
    """The anchor-frame prior."""

    def run(observations: list[InSpace]) -> list[Motion]:
        result = complete(
            observations, FitOptions(prior="anchor", weights=weights), body, kind=kind
        ).result
        return [result.clip(k).detach() for k in range(len(result.motion.shape))]

    return run


def frame_by_frame(body: BodyModel, *, smooth: bool) -> Fitter:
    """The density of single poses, which knows no motion, with its smoothness or without."""
    weights = PoseWeights.for_noise(NAMED_NOISE)
    if not smooth:
        weights = replace(weights, velocity=0.0, acceleration=0.0)
    prior = PosePrior.load(weights=weights)

    def run(observations: list[InSpace]) -> list[Motion]:
        start = (observations[-1]).start(body)
        result = solve(observations, prior, body, start=start)
        return [result.clip(k).detach() for k in range(len(result.motion.shape))]

    return run


def fitted(settings: FitOptions, body: BodyModel) -> Fitter:
    """What `recon fit` does with the same observations, all frames of the batch."""

    def run(observations: list[InSpace]) -> list[Motion]:
        result = fit_clip(observations, settings, body).result
        return [result.clip(k).detach() for k in range(len(result.motion.shape))]

    return run


def called(cycle: FoundCycle) -> str:
    """The name of a cycle in result files: its clip and when it begins."""
    return f"{cycle.clip}@{cycle.cycle.start:.2f}"


def listed(result: Path, corpus: Path, splits: Splits, part: Part) -> list[FoundCycle]:
    """The cycles of a part that a result file lists, for comparison with it.

    Raises:
        ValueError: when one of them is not found in the corpus.
    """
    tables = json.loads(result.read_text(encoding="utf-8"))["cycles"]
    names = {name for row in tables.values() for name in row}
    clips = {name.rsplit("@", 1)[0] for name in names}
    wanted = {clip for clip, own in splits.parts(sorted(clips)).items() if own == part}
    found = {
        called(c): c for c in found_cycles(corpus, splits, part, wanted) if called(c) in names
    }
    if missing := {n for n in names if n.rsplit("@", 1)[0] in wanted} - set(found):
        raise ValueError(f"{corpus}: these cycles of {result.name} are not there: {missing}")
    return [found[name] for name in sorted(found)]


def judged(
    motion: Motion, scanned: ScannedCycle, body: BodyModel, step: int = _JUDGED
) -> dict[str, float]:
    """Chamfer distance to the full scans, the truth's own, and vertex error, mm.

    Every `step`-th frame is compared.
    """
    last = min(motion.times[-1].item(), scanned.truth.times[-1].item()) + 1e-6
    scans = scanned.scans
    kept = (scans.frame % step == 0) & (scans.frame / scans.fps <= last)
    scans = replace(scans, points=scans.points[kept], frame=scans.frame[kept])
    times = scanned.truth.times[scanned.truth.times <= last][::step]
    pair = [body.pose(m.at(times, scans.fps)).vertices for m in (motion, scanned.truth)]
    return {
        "chamfer": 1000 * chamfer_of_clip(motion, body, scans),
        "truth": 1000 * chamfer_of_clip(scanned.truth, body, scans),
        "vertices": 1000 * (pair[0] - pair[1]).norm(dim=-1).mean().item(),
    }


def cloud_from(
    points: np.ndarray, frame: np.ndarray, frames: int, most: int, body: BodyModel
) -> PointCloud:
    """Points with the numbers of their frames, at most so many of each, as scans at 50 Hz."""
    padded, present = np.zeros((1, frames, most, 3)), np.zeros((1, frames, most), np.bool_)
    for k in range(frames):
        own = points[frame == k]
        padded[0, k, : len(own)], present[0, k, : len(own)] = own, True
    return PointCloud(
        torch.from_numpy(padded).float(), torch.from_numpy(present), Surfels.of(body), fps=50.0
    )


def _longer(one: InSpace, others: Sequence[InSpace]) -> InSpace:
    longest = max(_moments(other) for other in others) - _moments(one)

    def pad(tensor: torch.Tensor) -> torch.Tensor:
        return torch.cat((tensor, torch.zeros_like(tensor[:, :1]).expand(
            -1, longest, *tensor.shape[2:])), 1)  # fmt: skip

    if isinstance(one, PointCloud):
        return one.replace(points=pad(one.points), present=pad(one.present))
    return one.replace(positions=pad(one.positions), visible=pad(one.visible))


def _moments(one: InSpace) -> int:
    return (one.present if isinstance(one, PointCloud) else one.visible).shape[1]


def _show(title: str, table: dict[str, dict[str, float]]) -> None:
    shown = Table("observed", "Chamfer mm", "sd", "truth", "vertices mm", "CPU s", title=title)
    for name, row in table.items():
        shown.add_row(name, *(f"{row[key]:.1f}" for key in row))
    Console().print(shown)


def _main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--weights", default="nc", help="of the anchor prior: open, nc or a file")
    methods = ("complete", "frames", "smooth", "pose", "humor")
    parser.add_argument("--method", choices=methods, default="complete")
    parser.add_argument("--like", type=Path, help="complete the cycles that a result file lists")
    parser.add_argument("--each", type=int, default=4, help="cycles of every subject")
    parser.add_argument("--columns", nargs="*", choices=COLUMNS, default=list(COLUMNS))
    given = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    splits = Splits.load(given.splits)
    if given.like is None:
        cycles = chosen(list(found_cycles(given.corpus, splits, given.part)), given.each)
    else:
        cycles = listed(given.like, given.corpus, splits, given.part)
    scanned = [scanned_cycle(called(c), c.subject, c.motion, body) for c in cycles]
    fitter = {
        "complete": lambda: completed(given.weights, body),
        "frames": lambda: frame_by_frame(body, smooth=False),
        "smooth": lambda: frame_by_frame(body, smooth=True),
        "pose": lambda: fitted(FitOptions(prior="pose"), body),
        "humor": lambda: fitted(FitOptions(prior="humor", weights=given.weights), body),
    }[given.method]()
    table: dict[str, dict[str, float]] = {}
    every: dict[str, dict[str, dict[str, float]]] = {}
    for name in given.columns:
        seen = [observe(one, COLUMNS[name], body) for one in scanned]
        began = process_time()
        motions = fitter(together(seen))
        seconds = (process_time() - began) / len(scanned)
        rows = [judged(m, one, body) for m, one in zip(motions, scanned, strict=True)]
        every[name] = {one.name: row for one, row in zip(scanned, rows, strict=True)}
        chamfer = [row["chamfer"] for row in rows]
        table[name] = {
            "chamfer": float(np.mean(chamfer)),
            "sd": float(np.std(chamfer)),
            "truth": float(np.mean([row["truth"] for row in rows])),
            "vertices": float(np.mean([row["vertices"] for row in rows])),
            "seconds": seconds,
        }
        _show(f"{given.method}, {given.weights}, {given.part}", table)
        if given.json is not None:
            write(
                given.json, 0, corpus_source(given.corpus), method=given.method,
                weights=given.weights, part=given.part, mean=table, cycles=every,
            )  # fmt: skip


if __name__ == "__main__":
    _main()
