"""Predicts hidden markers of real recordings: all lower ones, and every fifth one.

    python -m benchmarks.real OBSERVATIONS --out FOLDER
    python -m benchmarks.real OBSERVATIONS --only cmu_c3d

`hidden_markers.toml` lists the runs, walks and jumps, and those that are measured apart. Markers
below 0.9 m are hidden in every frame, as by a table; the fit sees the others. The error is the
distance of the hidden markers from their place on the fitted body. One or two centimetres of it
are the distance of any marker from its nominal landmark, as the row of a fit to all markers shows.
At most three seconds of a recording are used, at 30 Hz or a little more.

The table `markers` leaves out every fifth known marker of a conversion, five times, in all frames.
A marker that is left out has no fitted offset from its landmark: the offset is its mean over every
tenth frame of the body that was fitted without it, and the error is measured in the other frames.
`without its offset` uses no offset but the 9.5 mm from skin to marker centre. Errors are in
millimetres, over at most 200 frames.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

import recon
from benchmarks.protocol import Cell, Table, number, parser, recordings_source, spread, tell
from benchmarks.strangers.compare import estimated, over_people, quotient
from recon import BodyModel, Markers3D
from recon.benchmark.table import MeanWithInterval
from recon.ingest.marker_fit import MarkerFit, fit_markers
from recon.ingest.marker_sets import MarkerSet, full_body_markers
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording

LIST = Path(__file__).parent / "hidden_markers.toml"
SECONDS, HIDDEN_BELOW, NOISE = 3.0, 0.9, 0.02
"""Length (s) of a clip; height (m) below which markers are hidden; and standard deviation (m) of a
marker from its landmark, by skin motion and placement."""
POSE, HUMOR, EVERYTHING = "stages 1-2", "collocation", "nothing hidden"
KINDS = ("runs", "walks", "jumps")
FOLDS, FRAMES, OFFSET_EVERY = 5, 200, 10
PREDICTED = (
    "cmu_c3d/02_01.c3d", "cmu_c3d/02_05.c3d", "cmu_c3d/06_01.c3d", "rehazenter/2014001_C1_01.c3d",
    "bmc/walk1.trc", "opensim/gait2354_subject01_walk1.trc",
    "opensim/hamner_subject02_running.trc", "opensim/rajagopal_walk.trc",
    "nimblephysics/hamner04_run300.trc", "nimblephysics/nick_freeform_001.c3d",
    "nimblephysics/sehoon_squat.c3d", "nimblephysics/sprinter_run0500cms.trc",
    "nimblephysics/opencap_s4_DJ1.trc", "nimblephysics/opencap_s3_DJ2.trc",
    "nimblephysics/opencap_s6_walking1.trc", "mocaptoolbox/mcdemodata.mat::dance1",
    "mocaptoolbox/mcdemodata.mat::walk1",
)  # fmt: skip
"""Recordings of which every fifth marker is predicted, one or more of every marker set."""


@dataclass(frozen=True)
class HiddenMarkers:
    """A listed recording whose lower markers are hidden."""

    row: str
    """Row of the table in whose mean it counts (runs, walks or jumps), or `apart`."""
    path: str
    """Path below the folder of observations."""
    person: str
    first: float = 0.0
    """Start of the clip in the recording (s)."""
    why: str = ""
    """Reason why it counts in no mean."""


def load_list(path: Path = LIST) -> tuple[HiddenMarkers, ...]:
    """Load the listed recordings, row after row."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    return tuple(HiddenMarkers(row=row, **own) for row, rows in table.items() for own in rows)


def main() -> None:
    """Hide markers, fit, print and write the tables."""
    arguments = parser(__doc__, "observations")
    arguments.add_argument("--weights", default="open", help="of HuMoR: open or a file")
    arguments.add_argument("--only", nargs="*", default=[""], help="paths that hold one of these")
    given = arguments.parse_args()
    body, errors = BodyModel.load(), dict[HiddenMarkers, Mapping[str, float]]()
    for one in load_list():
        if not any(part in one.path for part in given.only):
            continue
        seen = observation(given.observations / one.path, body, one.first)
        errors[one] = given_back(seen, given.weights, body)
        print(one.path, {k: f"{value:.1f} cm" for k, value in errors[one].items()}, flush=True)
    tables = {"real-hidden": means(errors), "real-recordings": recordings(errors)}
    names = [name for name in PREDICTED if any(part in name for part in given.only)]
    if given.weights == "open":
        tables["markers"] = predicted(given.observations, names, body)
    source = recordings_source(given.observations, [*(one.path for one in errors), *names])
    tell(given.out, None, source, tables)


def given_back(seen: Markers3D, weights: str, body: BodyModel) -> dict[str, float]:
    """Return the mean errors (cm) of the hidden markers, predicted from the upper ones, by prior.

    The last entry is the pose prior's fit to all markers. Nothing is repaired.
    """
    hidden = lower(seen)
    spoilt = seen.replace(visible=seen.visible & ~hidden)
    fits = {POSE: (spoilt, "pose", "open"), HUMOR: (spoilt, "humor", weights),
            EVERYTHING: (seen, "pose", "open")}  # fmt: skip
    errors: dict[str, float] = {}
    for label, (data, prior, own) in fits.items():
        result = recon.fit(data, prior, weights=own, body=body, noise=NOISE, repair=False)
        times = torch.arange(seen.positions.shape[1], dtype=torch.float64) / seen.fps
        kept = times <= result.motion.stop_time + 1e-6
        there = seen.predict(body.pose(result.motion.at(times[kept], seen.fps)))
        away = (there - seen.positions[0, kept]).norm(dim=-1)
        errors[label] = 100 * away[hidden[0, kept]].mean().item()
    return errors


def lower(seen: Markers3D) -> Bool[Tensor, "1 time markers"]:
    """Return a mask of the positions that are hidden."""
    return seen.visible & (seen.positions[..., 2] < HIDDEN_BELOW)


def observation(path: Path, body: BodyModel, first: float = 0.0) -> Markers3D:
    """Read a part of a recording's known markers, thinned to 30 Hz or a little more."""
    recording = read_recording(path)
    assert isinstance(recording, MarkerRecording)
    markers = full_body_markers(recording, body)
    chosen = recording.select(markers.labels)
    step = max(1, int(chosen.fps // 30))
    start = round(first * chosen.fps)
    kept = slice(start, start + int(SECONDS * chosen.fps), step)
    return Markers3D(
        positions=torch.from_numpy(chosen.positions[kept]).float()[None],
        visible=torch.from_numpy(chosen.visible[kept])[None],
        vertices=markers.vertices,
        fps=chosen.fps / step,
    )


def means(errors: Mapping[HiddenMarkers, Mapping[str, float]]) -> Table:
    """Build a table of mean errors over people by kind of motion, with 95 % intervals."""
    rows: list[list[Cell]] = []
    for kind in KINDS:
        own = {one: found for one, found in errors.items() if one.row == kind}
        if not own:
            continue
        count = f"{len(own)} of {sum(one.row == kind for one in load_list())}"
        cells = [spread(over(own, label)) for label in (POSE, HUMOR, EVERYTHING)]
        people = len({one.person for one in own})
        rows.append([kind, people, count, *cells, spread(over(own, HUMOR, POSE))])
    heads = ((POSE, 1), (HUMOR, 1), (EVERYTHING, 1), ("collocation / stages 1-2", 2))
    columns = [("hidden markers, cm", None), ("people", 0), ("recordings measured", None), *heads]
    return Table(columns, rows)


def over(
    errors: Mapping[HiddenMarkers, Mapping[str, float]], label: str, other: str | None = None
) -> MeanWithInterval:
    """Return the mean over people of an error, or of its ratio to another.

    Its interval is by resampling recordings, and people where there are several.
    """
    by_person: dict[str, list[tuple[float, float]]] = {}
    for one, found in errors.items():
        pair = found[label], 1.0 if other is None else found[other]
        by_person.setdefault(one.person, []).append(pair)
    sums = [np.array(own) for own in by_person.values()]
    return estimated(sums[0], quotient) if len(sums) == 1 else over_people(sums, quotient)


def recordings(errors: Mapping[HiddenMarkers, Mapping[str, float]]) -> Table:
    """Build a table of each recording's errors, those that count in no mean last."""
    rows: list[list[Cell]] = [
        [one.path, one.person, one.row + (f": {one.why}" if one.why else ""),
         *(number(found[label]) for label in (POSE, HUMOR, EVERYTHING))]
        for one, found in errors.items()
    ]  # fmt: skip
    heads = ((POSE, 1), (HUMOR, 1), (EVERYTHING, 1))
    return Table(
        [("recording, cm", None), ("person", None), ("counted among", None), *heads], rows
    )


def predicted(observations: Path, names: Sequence[str], body: BodyModel) -> Table:
    """Build a table of errors of markers that were left out, every fifth at a time."""
    rows: list[list[Cell]] = []
    for name in names:
        recording = read_recording(f"{observations}/{name}")
        assert isinstance(recording, MarkerRecording)
        markers = full_body_markers(recording, body)
        rows.append([name, len(markers.labels), *left_out(recording, markers, body)])
    heads = ("left-out, own offset known", "without its offset", "residual of the others")
    return Table([("recording, mm", None), ("markers", 0), *((head, 1) for head in heads)], rows)


def left_out(recording: MarkerRecording, markers: MarkerSet, body: BodyModel) -> list[float]:
    """Return mean errors (mm) with the marker's own offset, without it, and of fitted markers."""
    chosen = recording.select(markers.labels)
    step = -(-chosen.frames // FRAMES)
    chosen = replace(chosen, positions=chosen.positions[::step], visible=chosen.visible[::step],
                     fps=chosen.fps / step)  # fmt: skip
    positions = torch.from_numpy(chosen.positions).float()
    visible, numbers = torch.from_numpy(chosen.visible), torch.arange(len(markers.labels))
    errors: tuple[list[Tensor], ...] = ([], [], [])
    for fold in range(FOLDS):
        used = numbers % FOLDS != fold
        shown = replace(chosen, visible=chosen.visible & used.numpy())
        fit = fit_markers(shown, markers, body)
        judged = visible & ~used
        judged[::OFFSET_EVERY] = False
        for kept, place in zip(
            errors, placed(fit, markers, positions, visible, body), strict=False
        ):
            kept.append((place - positions).norm(dim=-1)[judged])
        errors[2].append((fit.predicted - positions).norm(dim=-1)[:, used][visible[:, used]])
    return [round(1000 * torch.cat(own).mean().item(), 1) for own in errors]


def placed(
    fit: MarkerFit,
    markers: MarkerSet,
    positions: Float[Tensor, "time markers 3"],
    visible: Bool[Tensor, "time markers"],
    body: BodyModel,
) -> tuple[Tensor, Tensor]:
    """Return places of all markers with the mean offset of every tenth frame, and with none."""
    posed = body.pose(fit.motion)
    bones = body.weights[list(markers.vertices)].argmax(-1)
    turns = posed.orientations[:, bones]
    skin = posed.points(torch.tensor(markers.vertices))
    local = (turns.mT @ (positions - skin)[..., None])[..., 0][::OFFSET_EVERY]
    seen = visible[::OFFSET_EVERY, :, None]
    own = local.where(seen, 0.0).sum(0) / seen.sum(0).clamp(min=1)
    return tuple(skin + (turns @ o[..., None])[..., 0] for o in (own, markers.nominal))  # type: ignore[return-value]


if __name__ == "__main__":
    main()
