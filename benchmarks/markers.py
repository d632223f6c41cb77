"""How well do real markers fit the body, and how well are left-out ones predicted?

    python -m benchmarks.markers OBSERVATIONS [--json FILE] [--only PART ...]

OBSERVATIONS holds .c3d, .trc and .mat recordings in folders. Every recording is fitted five times,
each time without every fifth of its known markers (in the order of the file): they are hidden in
all frames, when shape and offsets are found as well as when poses are.

A left-out marker has no fitted offset from its landmark, and one recording's markers are never
quite where their names say. Its constant offset, in the frame of its bone, is therefore the mean
over every tenth frame of the body that was fitted without it; the error is measured in the other
frames. `nominal` is the error with no offset but the 9.5 mm from skin to marker centre: it holds
how far the person who taped the marker was from our landmark too. `residual` is that of the fitted
markers. All are means over markers and frames, millimetres. At most 200 frames of a recording are
fitted, evenly spaced.
"""

import argparse
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.results import recordings_source, write
from recon.body.model import BodyModel
from recon.formats.mocap.reader import read_recording
from recon.formats.mocap.recording import MarkerRecording
from recon.ingest.markers.coverage import MarkerSet, full_body_markers
from recon.ingest.markers.fit import MarkerFit, fit_markers

FOLDS = 5
FRAMES = 200
OFFSET_EVERY = 10
LIMIT_MM = 30.0
RECORDINGS = (
    "cmu_c3d/02_01.c3d",
    "cmu_c3d/02_05.c3d",
    "cmu_c3d/06_01.c3d",
    "rehazenter/2014001_C1_01.c3d",
    "bmc/walk1.trc",
    "opensim/gait2354_subject01_walk1.trc",
    "opensim/hamner_subject02_running.trc",
    "opensim/rajagopal_walk.trc",
    "nimblephysics/hamner04_run300.trc",
    "nimblephysics/nick_freeform_001.c3d",
    "nimblephysics/sehoon_squat.c3d",
    "nimblephysics/sprinter_run0500cms.trc",
    "nimblephysics/opencap_s4_DJ1.trc",
    "nimblephysics/opencap_s3_DJ2.trc",
    "nimblephysics/opencap_s6_walking1.trc",
    "mocaptoolbox/mcdemodata.mat::dance1",
    "mocaptoolbox/mcdemodata.mat::walk1",
)
"""One or more of every marker set."""

Row = dict[str, str | float | int]


def evaluate(recording: MarkerRecording, body: BodyModel) -> Row:
    """Errors of one recording, millimetres."""
    markers = full_body_markers(recording, body)
    chosen = thinned(recording.select(markers.labels))
    positions = torch.from_numpy(chosen.positions).float()
    visible = torch.from_numpy(chosen.visible)
    numbers = torch.arange(len(markers.labels))
    left_out: list[Tensor] = []
    nominal: list[Tensor] = []
    fitted: list[Tensor] = []
    for fold in range(FOLDS):
        used = numbers % FOLDS != fold
        shown = replace(chosen, visible=chosen.visible & used.numpy())
        fit = fit_markers(shown, markers, body)
        apart = (fit.predicted - positions).norm(dim=-1)
        fitted.append(apart[:, used][visible[:, used]])
        raw, corrected = predictions(fit, markers, positions, visible, body)
        judged = visible & ~used
        judged[::OFFSET_EVERY] = False
        nominal.append((raw - positions).norm(dim=-1)[judged])
        left_out.append((corrected - positions).norm(dim=-1)[judged])
    return {
        "recording": chosen.name,
        "markers": len(markers.labels),
        "frames": chosen.frames,
        "left_out_mm": mean(left_out),
        "nominal_mm": mean(nominal),
        "residual_mm": mean(fitted),
    }


def predictions(
    fit: MarkerFit,
    markers: MarkerSet,
    positions: Float[Tensor, "time markers 3"],
    visible: Bool[Tensor, "time markers"],
    body: BodyModel,
) -> tuple[Tensor, Tensor]:
    """All markers without any offset of their own, and with that of every tenth frame."""
    posed = body.pose(fit.motion)
    bones = body.weights[list(markers.vertices)].argmax(-1)
    turns = posed.orientations[:, bones]
    skin = posed.points(torch.tensor(markers.vertices))
    raw = skin + (turns @ markers.nominal[..., None])[..., 0]
    local = (turns.mT @ (positions - skin)[..., None])[..., 0][::OFFSET_EVERY]
    seen = visible[::OFFSET_EVERY, :, None]
    own = local.where(seen, 0.0).sum(0) / seen.sum(0).clamp(min=1)
    return raw, skin + (turns @ own[..., None])[..., 0]


def thinned(recording: MarkerRecording) -> MarkerRecording:
    """The recording with at most 200 frames, evenly spaced, and the rate that they have."""
    step = -(-recording.frames // FRAMES)
    return MarkerRecording(
        name=recording.name,
        marker_names=recording.marker_names,
        positions=recording.positions[::step],
        visible=recording.visible[::step],
        fps=recording.fps / step,
        decisions=recording.decisions,
    )


def mean(parts: list[Tensor]) -> float:
    """Millimetres."""
    return round(1000 * torch.cat(parts).mean().item(), 1)


def recordings(root: Path, only: list[str]) -> Iterator[str]:
    """Recordings of the list that are there and asked for."""
    for name in RECORDINGS:
        there = (root / name.split("::")[0]).is_file()
        if there and (not only or any(part in name for part in only)):
            yield name


def main() -> None:
    logging.basicConfig(level=logging.WARNING)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("observations", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    body = BodyModel.load()
    rows: list[Row] = []
    head = ("recording", "markers", "frames", "left out", "nominal", "residual")
    print(f"{head[0]:44s}" + "".join(f"{title:>10s}" for title in head[1:]))
    for name in recordings(options.observations, options.only):
        recording = read_recording(f"{options.observations}/{name}")
        assert isinstance(recording, MarkerRecording)
        try:
            row = evaluate(recording, body)
        except ValueError as error:
            print(f"{name:44s}  refused: {error}")
            continue
        row["recording"] = name
        rows.append(row)
        print(f"{name:44s}" + "".join(f"{value:>10}" for value in list(row.values())[1:]))
        if options.json:
            source = recordings_source(
                options.observations, (str(row["recording"]) for row in rows)
            )
            write(options.json, None, source, rows=rows)
    within = sum(float(row["left_out_mm"]) <= LIMIT_MM for row in rows)
    print(f"{within} of {len(rows)} recordings predict left-out markers within {LIMIT_MM:g} mm")


if __name__ == "__main__":
    main()
