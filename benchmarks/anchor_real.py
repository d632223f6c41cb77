"""Real marker recordings of gait, 16 landmarks of them or fewer, completed: left-out markers, mm.

    python -m benchmarks.anchor_real OBSERVATIONS --weights open nc
        --json benchmarks/results/anchor_real.json --picture docs/anchor_real.png

All known markers of a recording are fitted (`recon.ingest.markers.fit`), which tells where its
cycles are; the one in the middle is taken. Given are the markers of `LANDMARKS_16` that the
recording has, in every frame (`16`) or in the frames at 5 of the cycle's 100 anchors (`16, f=5`).
Judged are all other known markers, except those that share a landmark with a given one.

A left-out marker's constant offset, in the frame of its bone, is the mean over every tenth frame
on the body that is judged; its error is measured in the other frames, as benchmarks/markers.py
does. `nominal` is the error with no offset but the 9.5 mm from skin to marker centre. The row
`all markers` is the fit that saw everything, the left-out markers too, judged alike: a floor.
`pose` is what `recon fit --prior pose --noise 0.01` makes of the same landmarks; told the noise,
because 5 frames do not tell it and the body shrinks. At 50 to 60 Hz.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from time import process_time

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.anchor import weights_name
from benchmarks.real_cycles import RealCycle, judged, real_cycle, together
from benchmarks.results import recordings_source, write
from benchmarks.scans import observed_frames
from observations.markers3d import Markers3D
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.fitting.clip import fit_clip
from recon.fitting.cycles import NAMED_NOISE, complete
from recon.fitting.methods import FitOptions
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.view.frames import write_png
from recon.view.scene import GREY, Figure, Points, Show

RECORDINGS = {
    "cmu_c3d/02_01.c3d": "walk, training subject",
    "cmu_c3d/06_01.c3d": "walk, validation subject",
    "mocaptoolbox/mcdemodata.mat::walk1": "walk",
    "opensim/gait2354_subject01_walk1.trc": "walk",
    "opensim/hamner_subject02_running.trc": "run on treadmill",
    "rehazenter/2014001_C1_01.c3d": "walk",
    "bmc/Gait.c3d": "walk",
    "opensim/rajagopal_walk.trc": "walk",
    "nimblephysics/opencap_s6_walking1.trc": "walk",
    "nimblephysics/hamner04_run300.trc": "run on treadmill",
    "nimblephysics/sprinter_run0350cms.trc": "run",
}
PICTURED = "cmu_c3d/06_01.c3d"
"""CMU's recordings are free to show; this person is not among those that weights learned from."""
MOST = 10
"""Landmarks; recordings with fewer are reported, but not part of the mean: their knees, ankles
and toes all lack, so that nothing tells how the legs move."""
CASES = {"16": None, "16, f=5": 5}
"""Frames of 100 in which landmarks are given; None is all."""
Fitter = Callable[[list[Markers3D]], list[Motion]]


def completed(weights: str, body: BodyModel) -> Fitter:
    """The anchor-frame prior; cycles of one rate as one batch."""
    settings = FitOptions(prior="anchor", weights=weights)

    def run(seen: list[Markers3D]) -> list[Motion]:
        motions: list[Motion | None] = [None] * len(seen)
        for fps in {one.fps for one in seen}:
            rows = [k for k, one in enumerate(seen) if one.fps == fps]
            result = complete([together([seen[k] for k in rows])], settings, body).result
            for clip, row in enumerate(rows):
                motions[row] = result.clip(clip).detach()
        return [motion for motion in motions if motion is not None]

    return run


def by_pose(body: BodyModel) -> Fitter:
    """What `recon fit --prior pose --noise 0.01` gives, one by one."""
    settings = FitOptions(prior="pose", noise=(NAMED_NOISE,))

    def run(seen: list[Markers3D]) -> list[Motion]:
        return [fit_clip([one], settings, body).result.clip(0).detach() for one in seen]

    return run


Errors = dict[str, dict[str, dict[str, float]]]
"""Errors of one recording by method, case and kind of offset, per marker, mm."""


def summary(errors: Errors) -> dict[str, dict[str, float]]:
    """Mean and median over markers of every row."""
    return {
        row: {
            "mean": round(fmean(found["left out"].values()), 1),
            "median": round(median(found["left out"].values()), 1),
            "worst": max(found["left out"].values()),
            "nominal": round(fmean(found["nominal"].values()), 1),
        }
        for row, found in errors.items()
    }


def overall(rows: Sequence[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Means over recordings; nothing of none."""
    return {
        row: {key: round(fmean(one[row][key] for one in rows), 1) for key in rows[0][row]}
        for row in (rows[0] if rows else {})
    }


def show(title: str, rows: dict[str, dict[str, float]]) -> None:
    """One table."""
    table = Table("fit", "mean mm", "median", "worst marker", "nominal", title=title)
    for name, row in rows.items():
        table.add_row(name, *(f"{value:.1f}" for value in row.values()))
    Console().print(table)


def draw(path: Path, cycle: RealCycle, fits: dict[str, Motion], body: BodyModel) -> None:
    """A row per fit, midway between the 5 frames: the full fit in grey, and all markers.

    What was not given is drawn where it was recorded.
    """
    frames = min(round(fit.times[-1].item() * cycle.given.fps) for fit in fits.values()) + 1
    times = torch.arange(frames, dtype=torch.float64) / cycle.given.fps
    there = cycle.given.visible[0].all(0)
    given = cycle.given.positions[0][:frames, there]
    kept = cycle.visible[:frames].all(0)
    places = torch.cat((given, cycle.positions[:frames, kept]), 1)
    hidden = torch.zeros(frames, int(kept.sum()), dtype=torch.bool)
    observed = observed_frames(len(cycle.positions), 5).tolist()
    shows: list[Show] = []
    for title, motion in fits.items():
        case = next(case for case in reversed(CASES) if title.endswith(case))
        seen = cycle.seen(CASES[case]).visible[0][:frames, there]
        figures = (
            Figure(body, motion.at(times, cycle.given.fps), "reconstruction"),
            Figure(
                body, cycle.everything.at(times, cycle.given.fps), "fit of all markers",
                colour=GREY, opacity=0.4,
            ),
        )  # fmt: skip
        points = Points(places, torch.cat((seen, hidden), 1), places, radius=0.015)
        shows.append(Show(title, figures, points))
    wanted = [0, *(frame for frame in observed if frame < frames)]
    write_png(path, shows, [(a + b) // 2 for a, b in pairwise(wanted)])


def cycles_of(root: Path, only: Sequence[str], body: BodyModel) -> Iterator[RealCycle]:
    """The recordings' cycles; those without are said."""
    for name in RECORDINGS:
        if only and not any(part in name for part in only):
            continue
        if not (root / name.split("::")[0]).is_file():
            continue
        recording = read_recording(f"{root}/{name}")
        assert isinstance(recording, MarkerRecording)
        try:
            yield real_cycle(name, recording, body)
        except ValueError as error:
            print(f"{name} refused: {error}")


def main() -> None:
    """Fit, print, write and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("observations", type=Path, help="folder of marker recordings")
    parser.add_argument("--weights", nargs="+", default=["open", "nc"])
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--picture", type=Path, default=None)
    options = parser.parse_args()
    torch.set_num_threads(1)
    body = BodyModel.load()
    cycles = list(cycles_of(options.observations, options.only, body))
    if not cycles:
        parser.error(
            f"no cycle of gait in {options.observations}; expected {', '.join(RECORDINGS)}"
        )
    errors: list[Errors] = [{"all markers": judged(c.everything, c, body)} for c in cycles]
    fitters: dict[str, Fitter] = {weights_name(w): completed(w, body) for w in options.weights}
    fitters["pose"] = by_pose(body)
    drawn: dict[str, Motion] = {}
    seconds: dict[str, float] = {}
    for case, observed in CASES.items():
        for name, fitter in fitters.items():
            row, began = f"{name}, {case}", process_time()
            motions = fitter([cycle.seen(observed) for cycle in cycles])
            seconds[row] = round((process_time() - began) / len(cycles), 1)
            print(f"{row}: {seconds[row]} s of processor time a cycle", flush=True)
            for found, motion, cycle in zip(errors, motions, cycles, strict=True):
                found[row] = judged(motion, cycle, body)
                if cycle.name == PICTURED:
                    drawn[row] = motion
    rows = [summary(found) for found in errors]
    for cycle, row in zip(cycles, rows, strict=True):
        show(f"{cycle.name}: {cycle.landmarks} landmarks, {len(cycle.labels)} left out", row)
    most = [row for cycle, row in zip(cycles, rows, strict=True) if cycle.landmarks >= MOST]
    show(f"mean of {len(most)} recordings with {MOST} landmarks or more", overall(most))
    if options.json is not None:
        recordings = {
            cycle.name: {
                "what": RECORDINGS[cycle.name],
                "landmarks": cycle.landmarks,
                "left_out": len(cycle.labels),
                "seconds": round((len(cycle.positions) - 1) / cycle.given.fps, 2),
                "fits": row,
                "markers_mm": {name: one["left out"] for name, one in found.items()},
            }
            for cycle, row, found in zip(cycles, rows, errors, strict=True)
        }
        write(options.json, None, recordings_source(options.observations, recordings),
              mean=overall(most), mean_of=len(most), seconds_of_processor=seconds,
              recordings=recordings)  # fmt: skip
    if options.picture is not None and drawn:
        [cycle] = [cycle for cycle in cycles if cycle.name == PICTURED]
        last = weights_name(options.weights[-1])
        wanted = (f"{last}, 16", f"{last}, 16, f=5", "pose, 16, f=5")
        draw(options.picture, cycle, {row: drawn[row] for row in wanted}, body)


if __name__ == "__main__":
    main()
