"""Depth alone and with other sensors through files: what somebody who has only files gets.

    python -m benchmarks.clouds CORPUS --json clouds.json
    python -m benchmarks.clouds CORPUS --cases walks --prior pose

Every window is simulated and written to observation files, which `recon.load_observation` reads
and `recon.fit` fits. The sensor has 512 x 424 pixels, noise, holes and flying pixels.

`depth` and the cases after it are the listed windows, 90 frames of each, and see body and ground;
nothing below 0.9 m is seen in the middle third. `depth` knows the pose of its sensor; `depth,
sensor unknown`, `2D` and `2D + depth` do not, nor where the ground is; 2D keypoints are in the
sensor's own image, with one pixel of noise; joints have 3 cm. `walks` are 2.5 s of straight walks
of six people, 2 to 8 m from a sensor of known pose: across its view, towards it, away from it and
askew; every other person without the ground.

Errors of joints about the pelvis and of vertices in the world (by way of the true sensor) are in
centimetres; a window is lost where joints are off by more than 15 cm in the mean. Windows whose
files are refused are counted, and the JSON says why. Windows that the JSON has already, of the
same commit, are not fitted again.
"""

import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

import recon
from benchmarks.arguments import over_windows
from benchmarks.cloud_cases import (
    CASES,
    VIEWS,
    WALK_FRAMES,
    WALKS,
    Seen,
    SeenWalk,
    view_of,
    write_files,
)
from benchmarks.humor import evenly
from benchmarks.results import corpus_source, earlier, write
from benchmarks.scores import Columns, Row, by_subject, rounded, tables
from benchmarks.uncertainty import NINE_TENTHS
from recon.benchmark.dataset import Splits
from recon.benchmark.windows import TrueWindows, load_windows
from recon.body.model import BodyModel
from recon.metrics.evaluation import evaluate, ground_errors

SEED, FRAMES = 0, 90
LOST = 0.15
"""Mean error of joints about the pelvis from which on a window is lost, metres."""

COLUMNS: Columns = {
    "root_visible": ("visible", 100), "root_hidden": ("hidden", 100), "root_all": ("all", 100),
    "vertices": ("vertices", 100), "normal": ("normal °", 1), "height": ("height", 100),
    "covered_visible": ("within, seen", 1), "covered_hidden": ("within, hidden", 1),
    "lost": ("lost %", 100), "said": ("warned %", 100), "seconds": ("CPU s", 1),
}  # fmt: skip


def main() -> None:
    parser = over_windows(__doc__)
    parser.add_argument("--only", type=int, default=None, help="use so many windows in all")
    parser.add_argument("--cases", nargs="+", choices=("walks", *CASES), default=["depth"])
    parser.add_argument("--prior", default="humor", help="as in recon.fit")
    parser.set_defaults(part="validation")
    given = parser.parse_args()
    body, splits = BodyModel.load(), Splits.load(given.splits)
    values: dict[str, dict[str, dict[str, Any]]] = earlier(given.json, "values")
    for case in given.cases:
        windows = (
            walks(given.corpus, splits, body)
            if case == "walks"
            else load_windows(given.corpus, splits, given.part, body, SEED, FRAMES)
        )
        chosen = evenly(windows, given.only)
        done = values.setdefault(case, {}).setdefault(given.prior, {})
        for k in chosen:
            name, seen = windows.names[k], Seen(windows.truth[k], body, k)
            if case == "walks":
                seen = SeenWalk(windows.truth[k], body, k, *view_of(k))
            if name not in done:
                done[name] = fitted(seen, case, given.prior)
                print(case, name, done[name], flush=True)
            if given.json is not None:
                some = windows.take(chosen)
                write(given.json, SEED, corpus_source(given.corpus, windows.files),
                      part=given.part, **some.about, values=values)  # fmt: skip
        show(case, windows.take(chosen), done)


def walks(corpus: Path, splits: Splits, body: BodyModel) -> TrueWindows:
    """Straight walks, each as often as there are views of it."""
    listed = replace(splits, windows={"validation": {WALK_FRAMES: WALKS}})
    found = load_windows(corpus, listed, "validation", body, SEED, WALK_FRAMES)
    every = found.take([k for k in range(len(found.names)) for _ in VIEWS])
    names = [
        "{}, {:g} m, {:g} degrees".format(name, *view_of(k)) for k, name in enumerate(every.names)
    ]
    return replace(every, names=tuple(names))


def fitted(seen: Seen, case: str, prior: str) -> dict[str, Any]:
    """One window's columns, or why its files are refused."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_files(seen, case, Path(folder))
        began = time.process_time()
        try:
            result = recon.fit(recon.load_observation(paths), prior)
        except recon.ReconError as error:
            return {"refused": str(error)}
    seconds = time.process_time() - began
    motion, camera, body = result.motion, seen.camera.T_world_camera, seen.body
    found = result.T_world_camera
    if found is not None:
        motion = motion.carried(camera @ found.inverse(), body.rest_joints(motion.shape)[0])
    truth = seen.truth.window(0, motion.frames)
    visible = seen.visible_joints[: motion.frames]
    errors = evaluate(motion, truth, body, truth_visible=visible)
    row: Row = {
        "root_visible": errors["root_joints_visible"], "root_hidden": errors["root_joints_hidden"],
        "root_all": errors["root_joints_all"], "vertices": errors["vertices"],
        "said": float(len(result.warnings) > 0), "seconds": seconds,
    }  # fmt: skip
    row["lost"] = float((errors["root_joints_all"] or 0.0) > LOST)
    if found is not None:
        ground = ground_errors(found, camera)
        row |= {"normal": math.degrees(ground["ground_normal"]), "height": ground["ground_height"]}
    elif result.joint_std is not None:
        away = (body.pose(motion).joints - body.pose(truth).joints).abs()
        within = (away <= NINE_TENTHS * result.joint_std[..., None]).float().mean(-1)
        row["covered_visible"] = float(within[visible].mean())
        row["covered_hidden"] = None if visible.all() else float(within[~visible].mean())
    codes = [warning.code for warning in result.warnings]
    return {**{k: rounded(v) for k, v in row.items()}, "warnings": codes}


def show(case: str, windows: TrueWindows, values: dict[str, dict[str, Any]]) -> None:
    """Print every window, and means over subjects of those that were fitted."""
    rows = [values[name] for name in windows.names]
    there = [k for k, row in enumerate(rows) if "refused" not in row]
    lost = sum(bool(rows[k]["lost"]) for k in there)
    console = Console(width=190)
    for name, row in zip(windows.names, rows, strict=True):
        errors = [row.get(k) for k in ("root_visible", "root_all")]
        seen, every = ("-" if v is None else f"{100 * v:.1f}" for v in errors)
        console.print(f"{name}: visible {seen}, all {every} cm {row.get('refused', '')}")
    console.print(f"{case}: {len(rows)} windows, {lost} lost, {len(rows) - len(there)} refused")
    if there:
        columns = [{column: rows[k].get(column) for column in COLUMNS} for k in there]
        means = by_subject(windows.take(there), columns)
        for table in tables(case, COLUMNS, {"recon": means}):
            console.print(table)


if __name__ == "__main__":
    main()
