"""Real detections of real people: the Pose2Sim recordings, from all views and from one alone.

    python -m benchmarks.pose2sim OBSERVATIONS --json pose2sim.json

OBSERVATIONS is a folder with pose2sim/*.zip and pose2sim/Calib_qualisys.toml: BODY_25B detections
of three calibrated cameras, HALPE_26 of one, one and two people, 60 Hz. `reprojection` is the
median distance of the fitted body's keypoints from the detections, over all views that were
fitted; `triangulation` that of points which follow no body, the floor of what calibration and
detector allow. A single view is fitted with its calibrated pose: `away` is the mean distance of
its joints, about the pelvis, from those of all views, `world` in the room. Where everybody's
detections are given, one view alone may mean somebody else, and is left out.
"""

import argparse
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.results import recordings_source, write
from benchmarks.scores import Columns, Row, cell
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.diagnosis.views.fitted import views_error
from recon.fitting.clip import fit_clip
from recon.fitting.fitted import ClipFit
from recon.fitting.methods import FitOptions
from recon.fitting.settings import FitSettings
from recon.metrics import errors as metrics
from recon.reading.clip import load_clip

SEED = 0
FPS = 60.0
SETS = {
    "single_balancing": "pose-associated",
    "single_static": "pose-associated",
    "multi_static_p1": "pose-associated",
    "multi_static_p2": "pose-associated",
    "multi_participants12": "pose",
}
"""Recordings, and the folder of detections: those matched between views, or everybody."""
ALONE = "cam03_json"
COLUMNS: Columns = {
    "frames": ("frames", 1), "triangulation": ("triangulation px", 1),
    "reprojection": ("reprojection px", 1), "away": ("away cm", 100), "world": ("world cm", 100),
    "seconds": ("CPU s", 1),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("observations", type=Path)
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    folder = arguments.observations / "pose2sim"
    settings = FitSettings(camera=folder / "Calib_qualisys.toml", frame_rate=FPS)
    body = BodyModel.load()
    rows: dict[str, Row] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for name, detections in SETS.items():
            place = Path(scratch) / name
            with zipfile.ZipFile(folder / f"{name}.zip") as archive:
                archive.extractall(place)
            rows |= _one(name, place, detections, settings, body)
    console = Console(width=None if sys.stdout.isatty() else 160)
    table = Table(title="Pose2Sim recordings", title_justify="left")
    for heading in ("", *(heading for heading, _ in COLUMNS.values())):
        table.add_column(heading, justify="left" if heading == "" else "right")
    for name, row in rows.items():
        table.add_row(name, *(cell(row.get(key), f) for key, (_, f) in COLUMNS.items()))
    console.print(table)
    if arguments.json is not None:
        source = recordings_source(arguments.observations, ["pose2sim"])
        write(arguments.json, SEED, source, tables=rows)


def _one(
    name: str, place: Path, detections: str, settings: FitSettings, body: BodyModel
) -> dict[str, Row]:
    """All views, one view with its pose, one without."""
    rows: dict[str, Row] = {}
    row, every = _fitted([place / detections], settings, body)
    rows[f"{name}, three views"] = row
    if detections == "pose":
        return rows
    alone = {f"{name}, one view": place / detections / ALONE}
    halpe = place / "pose_halpe26" / ALONE.removesuffix("_json")
    if halpe.is_dir():
        alone[f"{name}, one view, HALPE"] = halpe
    for title, path in alone.items():
        row, one = _fitted([path], settings, body)
        rows[title] = row | _against(one, every, body)
    return rows


def _fitted(paths: list[Path], settings: FitSettings, body: BodyModel) -> tuple[Row, ClipFit]:
    clip = load_clip(paths, settings, body)
    began = time.process_time()
    found = fit_clip(clip.observations, FitOptions(), body)
    seconds = time.process_time() - began
    views = [o for o in clip.observations if isinstance(o, Keypoints2D)]
    with torch.no_grad():
        estimate = found.result.estimate
        away = torch.cat([view.residuals(estimate).present() for view in found.observations])
    return {
        "frames": float(views[0].pixels.shape[1]),
        "triangulation": views_error(views) if len(views) > 1 else None,
        "reprojection": float(away.median()),
        "seconds": seconds,
    }, found


def _against(one: ClipFit, every: ClipFit, body: BodyModel) -> Row:
    """Joints of a single view's fit and of all views', at the frames of both."""
    a, b = one.result.clip(0), every.result.clip(0)
    first = max(a.start_time, b.start_time)
    last = min(a.stop_time, b.stop_time)
    times = first + torch.arange(round((last - first) * b.fps) + 1, dtype=torch.float64) / b.fps
    ours, theirs = (body.pose(m.at(times.clamp(max=last), b.fps)).joints for m in (a, b))
    rooted = metrics.point_errors(metrics.root_aligned(ours), metrics.root_aligned(theirs))
    return {
        "away": metrics.mean(rooted),
        "world": metrics.mean(metrics.point_errors(ours, theirs)),
    }


if __name__ == "__main__":
    main()
