"""C3D and TRC files of laboratories: read, converted and fitted; gaps and missing parts.

    python -m benchmarks.clinic OBSERVATIONS --json clinic.json

OBSERVATIONS is a folder with vendors/ (one file of each vendor's habits), choreonet/, biomechzoo/
and mocaprecovery/ (recordings of whole bodies).

Every file of vendors/ is converted; where that is refused, `refusal` is the CPU time of a whole
process `recon fit FILE`, with its message. Every recording of the others is converted; then its
first seconds are fitted three times. `left_out` is the error of each fifth known marker where none
of its frames were shown, at the constant offset that it has in each tenth frame
(`benchmarks.markers`). `gaps` is that of positions hidden at random, 30 % of every marker's, in
stretches of 0.2 to 1 s, at the constant offset that the marker has where it is shown. `arm` is the
mean angle of an upper arm from the vertical where its side shows no marker from the shoulder on;
it is 90 degrees in a T-pose. `invented` counts frames of the result that no marker shows and that
are not marked as such. `fit_gaps` is the error of the same gaps of some recordings by
`recon.fit`, under the prior. Errors are means, millimetres.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

import recon
from benchmarks.markers import FOLDS, OFFSET_EVERY, predictions
from benchmarks.results import recordings_source, write
from observations.markers3d import Markers3D
from recon.body.model import BodyModel
from recon.core.skeleton import joint_index
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.conversion import convert_markers, fitted_markers
from recon.ingest.markers.coverage import MarkerSet, full_body_markers
from recon.ingest.markers.gaps import trimmed
from recon.ingest.markers.observation import seen_markers
from recon.ingest.single import convert

SEED = 0
FOLDERS = ("choreonet", "biomechzoo", "mocaprecovery")
SECONDS = 3.0
"""Length of the windows in which markers are hidden."""
SHARE, SHORTEST, LONGEST = 0.3, 0.2, 1.0
"""Share of positions that gaps hide, and seconds that they last."""
FITTED = ("choreonet/ll_qq_03_1.c3d", "biomechzoo/HC030A22.c3d", "mocaprecovery/135_02.c3d")
FIT_SECONDS = 2.0
Row = dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("observations", type=Path)
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--only", default="", help="files whose path has this")
    parser.add_argument("--without-fits", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    root, body = arguments.observations, BodyModel.load()
    asked = [path for path in _files(root, ("vendors", *FOLDERS)) if arguments.only in str(path)]
    vendors: dict[str, Row] = {}
    recordings: dict[str, Row] = {}
    for path in asked:
        name = str(path.relative_to(root))
        if path.parent.name == "vendors":
            vendors[name] = row = _read_or_refused(path, body)
        else:
            fits = name in FITTED and not arguments.without_fits
            recordings[name] = row = _recording(path, body, fits=fits)
        print(name, row, flush=True)
    _show(recordings)
    if arguments.json is not None:
        source = recordings_source(root, ["vendors", *FOLDERS])
        write(arguments.json, SEED, source, vendors=vendors, recordings=recordings)


def _files(root: Path, folders: tuple[str, ...]) -> list[Path]:
    endings = (".c3d", ".trc")
    every = [path for folder in folders for path in sorted((root / folder).iterdir())]
    return [path for path in every if path.suffix.lower() in endings]


def _read_or_refused(path: Path, body: BodyModel) -> Row:
    began = time.process_time()
    try:
        found = convert(path, body)
    except ValueError as error:
        return {"refused": str(error).replace(str(path), path.name), "refusal": _refusal(path)}
    assert found.observed is not None
    return {
        "frames": found.motion.frames,
        "start": round(found.motion.start_time, 3),
        "residual_mm": found.report["residual_mm"],
        "unseen": [one.message for one in found.warnings if one.code == "unseen"],
        "warnings": len(found.warnings),
        "seconds": time.process_time() - began,
    }


def _refusal(path: Path) -> float:
    """CPU seconds of a process that refuses a file."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as scratch:
        words = [sys.executable, "-m", "recon", "fit", str(path), "--out", f"{scratch}/m.npz"]
        done = subprocess.run(words, capture_output=True, check=False)
    if done.returncode == 0:
        raise RuntimeError(f"{path} is refused by convert and fitted by fit")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _recording(path: Path, body: BodyModel, *, fits: bool) -> Row:
    recording = read_recording(path)
    assert isinstance(recording, MarkerRecording)
    began = time.process_time()
    found = convert_markers(recording, body)
    seconds = time.process_time() - began
    assert found.observed is not None
    markers = full_body_markers(recording, body)
    known = recording.select(markers.labels)
    first = round((found.motion.start_time - known.start_time) * known.fps)
    shown = known.visible[first : first + found.motion.frames].any(1)
    window = _window(known, markers, body, SECONDS)
    hidden = _gaps(window, np.random.default_rng(SEED))
    left_out, gaps = _left_out(window, markers, body), _gap_error(window, hidden, markers, body)
    row: Row = {
        "frames": known.frames,
        "residual_mm": found.report["residual_mm"],
        "left_out_mm": left_out,
        "gaps_mm": gaps,
        "arm_degrees": _hidden_arm(window, markers, body),
        "invented": int((found.observed.any(-1).numpy() & ~shown).sum()),
        "seconds": seconds,
    }
    if fits:
        short = _window(known, markers, body, FIT_SECONDS)
        row["fit_gaps_mm"] = _fitted_gaps(short, _gaps(short, np.random.default_rng(SEED)), body)
    return row


def _window(
    known: MarkerRecording, markers: MarkerSet, body: BodyModel, seconds: float
) -> MarkerRecording:
    placed, _ = trimmed(known, tuple(_bones(markers.vertices, body)))
    return placed.window(0, round(seconds * known.fps) + 1)


def _gaps(
    recording: MarkerRecording, random: np.random.Generator
) -> Bool[np.ndarray, "time markers"]:
    """Positions of every marker that gaps hide, among those that are visible."""
    hidden = np.zeros(recording.visible.shape, dtype=bool)
    frames = recording.frames
    for marker in range(len(recording.marker_names)):
        while hidden[:, marker].mean() < SHARE:
            length = max(1, round(random.uniform(SHORTEST, LONGEST) * recording.fps))
            start = int(random.integers(-length + 1, frames))
            hidden[max(0, start) : start + length, marker] = True
    return hidden & recording.visible


def _shown_but(recording: MarkerRecording, hidden: np.ndarray) -> MarkerRecording:
    visible = recording.visible & ~hidden
    positions = np.where(visible[..., None], recording.positions, 0.0)
    return replace(recording, visible=visible, positions=positions)


def _left_out(recording: MarkerRecording, markers: MarkerSet, body: BodyModel) -> float:
    """Error of every fifth marker, of which no frame is shown."""
    out = np.arange(len(markers.labels)) % FOLDS == 0
    found = fitted_markers(_shown_but(recording, out), body, markers)
    same, fit = _same_frames(recording, found.recording), found.fit
    positions = torch.from_numpy(same.positions).float()
    visible = torch.from_numpy(same.visible)
    _, places = predictions(fit, markers, positions, visible, body)
    judged = visible & torch.from_numpy(out)
    judged[::OFFSET_EVERY] = False
    return 1000 * float((places - positions).norm(dim=-1)[judged].mean())


def _gap_error(
    recording: MarkerRecording, hidden: np.ndarray, markers: MarkerSet, body: BodyModel
) -> float:
    """Error of positions that gaps hide."""
    found = fitted_markers(_shown_but(recording, hidden), body, markers)
    same = _same_frames(recording, found.recording)
    turns = body.pose(found.fit.motion).orientations[:, _bones(markers.vertices, body)]
    return _hidden_error(found.fit.predicted, turns, same, recording, hidden)


def _bones(vertices: tuple[int, ...], body: BodyModel) -> list[int]:
    return body.weights[list(vertices)].argmax(-1).tolist()


def _hidden_error(
    places: Float[Tensor, "time markers 3"],
    turns: Float[Tensor, "time markers 3 3"],
    same: MarkerRecording,
    recording: MarkerRecording,
    hidden: Bool[np.ndarray, "time markers"],
) -> float:
    """Error of hidden positions at the constant offsets that markers have where they are shown.

    Args:
        places: of the markers on the body.
        turns: orientations of their bones.
        same: the recording in the frames of the body.
        recording: in all frames.
        hidden: positions among all frames that were hidden.
    """
    first = round((same.start_time - recording.start_time) * recording.fps)
    asked = torch.from_numpy(hidden[first : first + same.frames])
    shown = (torch.from_numpy(same.visible) & ~asked)[..., None]
    local = (turns.mT @ (torch.from_numpy(same.positions).float() - places)[..., None])[..., 0]
    own = local.where(shown, 0.0).sum(0) / shown.sum(0).clamp(min=1)
    return 1000 * float((local - own).norm(dim=-1)[asked].mean())


def _same_frames(recording: MarkerRecording, other: MarkerRecording) -> MarkerRecording:
    first = round((other.start_time - recording.start_time) * recording.fps)
    return recording.window(first, first + other.frames)


def _hidden_arm(recording: MarkerRecording, markers: MarkerSet, body: BodyModel) -> float | None:
    """Angle of the left upper arm from the vertical, degrees, without markers on the arm."""
    side = body.template[list(markers.vertices)][:, 0] > 0
    elbow = joint_index("left_elbow")
    bones = body.weights[list(markers.vertices)].argmax(-1)
    arm = side & torch.isin(bones, torch.tensor([joint_index("left_shoulder"), elbow,
                                                 joint_index("left_wrist")]))  # fmt: skip
    if not bool(arm.any()):
        return None
    found = fitted_markers(_shown_but(recording, arm.numpy()), body, markers)
    joints = body.pose(found.fit.motion).joints
    down = joints[:, joint_index("left_shoulder")] - joints[:, elbow]
    return float(torch.rad2deg(torch.acos(down[:, 2] / down.norm(dim=-1))).mean())


def _fitted_gaps(recording: MarkerRecording, hidden: np.ndarray, body: BodyModel) -> float:
    """Error of positions that gaps hide, by a fit under the prior."""
    seen, _ = seen_markers(_shown_but(recording, hidden), body)
    assert isinstance(seen, Markers3D)
    result = recon.fit(seen, body=body)
    places = seen.on(body.pose(result.motion[None]))[0]
    first = round((result.motion.start_time - recording.start_time) * recording.fps)
    same = recording.window(first, first + len(places))
    turns = body.pose(result.motion).orientations[:, list(seen.bones(body))]
    return _hidden_error(places[: same.frames], turns[: same.frames], same, recording, hidden)


def _show(rows: dict[str, Row]) -> None:
    keys = ("frames", "residual_mm", "left_out_mm", "gaps_mm", "arm_degrees", "invented",
            "fit_gaps_mm", "seconds")  # fmt: skip
    table = Table("recording", *keys)
    for name, row in rows.items():
        values = (row.get(key) for key in keys)
        table.add_row(name, *("" if value is None else f"{value:.1f}" for value in values))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


if __name__ == "__main__":
    main()
