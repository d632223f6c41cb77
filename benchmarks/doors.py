"""Doors: files as other programs write them, by one command, against the truth behind them.

    python -m benchmarks.doors OBSERVATIONS --json doors.json

OBSERVATIONS is a folder with doors/ (one walk as FreeMoCap, MediaPipe, MotionBERT, Azure Kinect
and Pose2Sim write 3D keypoints, 1.5 cm of noise, and its truth) and pose2sim/ (real detections).
Every 3D row is fitted with no option but a missing rate. `joints` and `legs` are mean distances
in the world; where the file is in the frame of a camera or turned, after one rigid motion of the
whole clip; where it is relative to the pelvis, about the pelvis after one rotation. `warnings`
counts repairs and warnings. Projects (`benchmarks.projects`) are fitted by their folder alone:
`reprojection` is the median distance of the body's keypoints from the detections, `away` the mean
distance of the joints that their table of triangulated keypoints gives from those of the images.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

import recon
from benchmarks import projects
from benchmarks.results import recordings_source, write
from benchmarks.scores import Columns, Row, cell
from recon.api.fit import fit
from recon.core.skeleton import LEGS

SEED = 0
Judged = Literal["world", "turned", "pelvis"]
_SESSION = "fmc_session/output_data"
FILES: tuple[tuple[str, str, Judged, float | None], ...] = (
    ("FreeMoCap session", "fmc_session", "world", None),
    ("FreeMoCap 1.x csv, wide", f"{_SESSION}/mediapipe_body_3d_xyz.csv", "world", 30.0),
    ("FreeMoCap 1.x npy", f"{_SESSION}/mediapipe_body_3d_xyz.npy", "world", 30.0),
    ("FreeMoCap 2.0 csv, long", f"{_SESSION}/body_3d_xyz.csv", "world", 30.0),
    ("FreeMoCap csv by frame", "fmc_session/fmc_session_by_frame.csv", "world", None),
    ("Pose2Sim TRC, HALPE 26", "halpe26.trc", "world", None),
    ("Azure Kinect json", "azure.json", "turned", None),
    ("MediaPipe world landmarks", "mp_world.json", "pelvis", 30.0),
    ("MotionBERT X3D.npy", "X3D.npy", "pelvis", 30.0),
)
"""Name, file below doors/, how it is judged, and the rate where the file states none."""
COLUMNS: Columns = {
    "joints": ("joints cm", 100), "legs": ("legs cm", 100), "warnings": ("warnings", 1),
    "seconds": ("CPU s", 1),
}  # fmt: skip
PROJECTS: Columns = {
    "frames": ("frames", 1), "reprojection": ("reprojection px", 1), "away": ("away cm", 100),
    "warnings": ("warnings", 1), "seconds": ("CPU s", 1),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("observations", type=Path)
    parser.add_argument("--prior", default="humor")
    parser.add_argument("--only", default="", help="rows whose name has this")
    parser.add_argument("--json", type=Path, default=None)
    arguments = parser.parse_args()
    source = recordings_source(arguments.observations, ["doors", "pose2sim"])
    files = {
        name: _file(arguments.observations / "doors", file, judged, fps, arguments.prior)
        for name, file, judged, fps in FILES
        if arguments.only in name
    }
    _show("3D keypoints", files, COLUMNS)
    found: dict[str, Row] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for name in projects.SETS:
            if arguments.only in name:
                found[name] = _project(arguments.observations, name, Path(scratch), arguments)
    _show("Projects", found, PROJECTS)
    if arguments.json is not None:
        write(arguments.json, SEED, source, files=files, projects=found)


def _file(folder: Path, file: str, judged: Judged, fps: float | None, prior: str) -> Row:
    began = time.process_time()
    result = fit([folder / file], prior, frame_rate=fps)
    seconds = time.process_time() - began
    truth = np.load(folder / "truth_joints.npy")
    away = errors(result.joints.double().numpy()[: len(truth)], truth, judged)
    return {
        "joints": float(away.mean()),
        "legs": float(away[:, list(LEGS)].mean()),
        "warnings": float(len(result.repairs) + len(result.warnings)),
        "seconds": seconds,
    }


def errors(
    joints: Float[np.ndarray, "time 22 3"], truth: Float[np.ndarray, "time 22 3"], judged: Judged
) -> Float[np.ndarray, "time 22"]:
    """Distances of joints from the true ones, metres."""
    if judged == "pelvis":
        joints, truth = joints - joints[:, :1], truth - truth[:, :1]
    if judged != "world":
        x, y = joints.reshape(-1, 3), truth.reshape(-1, 3)
        a, b = (0.0, 0.0) if judged == "pelvis" else (x.mean(0), y.mean(0))
        U, _, V = np.linalg.svd((x - a).T @ (y - b))
        turn = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V
        joints = (joints - a) @ turn + b
    return np.linalg.norm(joints - truth, axis=-1)


def _project(observations: Path, name: str, scratch: Path, arguments: argparse.Namespace) -> Row:
    trial, opencap = projects.build(observations, name, scratch)
    began = time.process_time()
    images = fit([trial], arguments.prior)
    seconds = time.process_time() - began
    points = fit([opencap], arguments.prior)
    ours, theirs = images.joints.double().numpy(), points.joints.double().numpy()
    frames = min(len(ours), len(theirs))
    return {
        "frames": float(len(ours)),
        "reprojection": _reprojection(images),
        "away": float(np.linalg.norm(ours[:frames] - theirs[:frames], axis=-1).mean()),
        "warnings": float(len(images.warnings) + len(points.warnings)),
        "seconds": seconds,
    }


def _reprojection(result: recon.Result) -> float:
    """Median over all keypoints of all views, pixels."""
    found = result.examined.fit
    with torch.no_grad():
        away = [one.residuals(found.result.estimate).present() for one in found.observations]
    return float(torch.cat(away).median())


def _show(title: str, rows: dict[str, Row], columns: Columns) -> None:
    table = Table(title=title, title_justify="left")
    for heading in ("", *(heading for heading, _ in columns.values())):
        table.add_column(heading, justify="left" if heading == "" else "right")
    for name, row in rows.items():
        table.add_row(name, *(cell(row.get(key), f) for key, (_, f) in columns.items()))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


if __name__ == "__main__":
    main()
