"""`recon.label`: names for the markers of a recording that has none."""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Int

from recon.api.results import Tables, closing_fields
from recon.body.marker_labels import FEWEST_MARKERS, is_nameless
from recon.body.model import BodyModel
from recon.core.errors import FormatError, ReconError
from recon.core.units import Unit, Up
from recon.diagnosis.findings import listed
from recon.formats.outputs import Output, OutputKind
from recon.formats.writing import writing
from recon.ingest.marker_naming import Naming
from recon.ingest.marker_places import MarkedBody, bodies_of_set
from recon.ingest.marker_sets import markers_of_set
from recon.ingest.marker_unnamed import body_of_named_trial, marker_recording, named_tracks
from recon.mocap.c3d_copy import write_renamed_c3d
from recon.mocap.marker_tables import write_motive, write_trc
from recon.mocap.recording import MarkerRecording, SkeletonRecording
from recon.solver.solution import one_thread

_MANY_OPEN, _LOST = 0.1, 0.2
"""Share of the points without a name that is worth a warning, and share from which on the body may
have been lost: of a sprint at 9 m/s, 12 to 46 % of the names given were wrong."""
_MAY_BE_WRONG = (
    ", and other names may be wrong: look at them, or give a named trial of the movement (--like)"
)


@dataclass(frozen=True, repr=False)
class LabelledMarkers:
    """A marker recording with the marker names that were found; doubtful markers stay unnamed."""

    recording: MarkerRecording
    """Named markers and points without a name (*1, *2, ...); metres, z up."""
    confidence: Mapping[str, float]
    """Mean probability of the name over the frames of each named marker."""
    named: float
    """Share of all points that have a name."""
    warnings: tuple[str, ...]
    columns: Int[np.ndarray, "time points"]
    """Which point of the file each point of `recording` was in every frame, -1 where unseen."""
    source: Path | None
    """The file; None of a recording that was given."""

    @property
    def tables(self) -> Tables:
        """A table of how many of the recorded points got a marker name."""
        return {"points": {"named": {"share": round(self.named, 4)}}}

    def report(
        self, inputs: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        """The JSON report saved beside the file; see `MotionResult.report`."""
        found = {"named": self.named, "confidence": dict(self.confidence)}
        said = [{"code": "unseen", "message": one} for one in self.warnings]
        decisions = list(self.recording.decisions)
        return {
            **found, "decisions": decisions, "warnings": said, **closing_fields(inputs, settings)
        }  # fmt: skip

    def save(
        self, out: Path | str, *, overwrite: bool = False, report: Mapping[str, Any] | None = None
    ) -> None:
        """Write the markers and the report OUT.json.

        A .c3d file is a copy of the one that was read, with other labels and columns of points;
        .trc is in millimetres, y up, and .csv is Motive's table in metres, y up.

        Raises:
            FormatError: when the name of the file ends in none of these, or a copy is asked for of
                what is no C3D file.
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        kind = Path(out).suffix.lower()
        if kind not in (".c3d", ".trc", ".csv"):
            raise FormatError(
                f"{out}: expected a file name that ends in .c3d, .trc or .csv for named markers"
            )
        if kind == ".c3d" and (self.source is None or self.source.suffix.lower() != ".c3d"):
            raise FormatError(
                f"{out}: a C3D file is written as a changed copy of the one that was read, but "
                f"{self.recording.name} is from another kind of file; write .trc or .csv"
            )
        output = Output(Path(out), OutputKind.FILE)
        with writing(output, report=report or self.report(), overwrite=overwrite) as (staged,):
            if kind == ".c3d" and self.source is not None:
                write_renamed_c3d(staged, self.source, self.recording.marker_names, self.columns)
            else:
                (write_trc if kind == ".trc" else write_motive)(staged, self.recording)


def label(
    recording: str | Path | SkeletonRecording | MarkerRecording,
    *,
    like: str | Path | SkeletonRecording | MarkerRecording | None = None,
    set: str | Path | None = None,
    unit: Unit | None = None,
    up: Up | None = None,
) -> LabelledMarkers:
    """Name a recording's markers as in another trial of the same person, or as in a marker set.

    Trajectories are cut where they jump. A body with the markers, that of the named trial or, of a
    set, one of several statures, is fitted to single frames and followed from there; each frame
    adds to how likely a trajectory is to be each marker. Names the recording has are ignored.
    Doubtful points stay open (*1, *2, ...). Nothing is random. A trial that is named like itself
    gets exchanged names and ghosts put right; a warning counts them. In a trial that has names,
    points that are no markers (joint centres, angles and other outputs of a model) keep theirs.

    Args:
        recording: a file (.c3d, .trc, ...) of markers without names, of one person.
        like: a recording of this person, with names and the markers in the same places.
        set: where there is none, a marker set (pig, cmu, opencap, bsm), or a file .toml or .json
            of marker = landmark; beside `like`, where its markers are.
        unit: of both files; default: found out.
        up: axis of both files that points up, or down; default: found out.

    Raises:
        ReconError: when one is no recording of markers, or the named trial has fewer than ten
            markers or the other hardly fits it, or neither `like` nor `set` is given.
        FileNotFoundError: when there is no such file.
    """
    seen = marker_recording(recording, unit, up)
    with one_thread(), torch.no_grad():
        bodies, like_what = _marked_bodies(like, set, unit, up)
    outputs = _is_model_output(seen.marker_names, bodies[0].markers.labels)
    naming = named_tracks(seen, seen.visible & ~outputs, bodies, like_what)
    source = Path(recording) if isinstance(recording, str | Path) else None
    return _labelled_markers(seen, outputs, naming, like_what, source)


def _marked_bodies(
    like: str | Path | SkeletonRecording | MarkerRecording | None,
    set: str | Path | None,
    unit: Unit | None,
    up: Up | None,
) -> tuple[list[MarkedBody], str]:
    """Return candidate bodies with named markers, and the trial or set that names them."""
    body = BodyModel.load()
    markers = None if set is None else markers_of_set(set, body)
    if like is None:
        if markers is None:
            raise ReconError(
                "nothing tells the names of the markers: give a trial of the same person whose "
                "markers have names (--like), or, where there is none, the marker set (--set)"
            )
        return bodies_of_set(markers, body), f"the set {set}"
    trial = marker_recording(like, unit, up)
    return [body_of_named_trial(trial, body, markers)], trial.name


def _is_model_output(names: Sequence[str], markers: Sequence[str]) -> Bool[np.ndarray, " points"]:
    """Return a mask of the named points that are no markers (joint centres, angles, ...)."""
    known = np.isin(names, markers)
    if known.sum() < FEWEST_MARKERS:
        return np.zeros(len(names), bool)
    return ~known & ~np.array([is_nameless(name) for name in names])


def _labelled_markers(
    seen: MarkerRecording,
    outputs: Bool[np.ndarray, " points"],
    naming: Naming,
    like: str,
    source: Path | None,
) -> LabelledMarkers:
    """Return the recording with a column per named marker, unnamed track and model output."""
    names, track = naming.bodies[0].markers.labels, naming.track
    frames, points = np.nonzero(track >= 0)
    column = naming.marker.copy()
    ends: list[int] = []
    numbers = track[frames, points]
    for number in np.flatnonzero(column < 0).tolist():
        own = frames[numbers == number]
        free = [k for k, end in enumerate(ends) if end < own[0]]
        k = free[0] if free else len(ends)
        ends[k : k + 1] = [int(own[-1])]
        column[number] = len(names) + k
    labels = [*names, *(f"*{k + 1}" for k in range(len(ends)))]
    columns = np.full((len(track), len(labels)), -1)
    columns[frames, column[numbers]] = points
    kept = np.flatnonzero(outputs)
    columns = np.concatenate((columns, np.where(seen.visible[:, kept], kept, -1)), 1)
    labels += [seen.marker_names[k] for k in kept.tolist()]
    # sort the columns by the median place of their points in the file
    place_in_file = np.where(columns >= 0, columns, np.nan)
    shown = (columns >= 0).any(0)
    order = [*np.argsort(np.nanmedian(place_in_file[:, shown], 0), kind="stable")]
    order = np.concatenate((np.flatnonzero(shown)[order], np.flatnonzero(~shown)))
    columns, labels = columns[:, order], [labels[k] for k in order.tolist()]
    visible = columns >= 0
    positions = seen.positions[np.arange(len(track))[:, None], columns]
    positions = np.where(visible[..., None], positions, 0.0)
    sure = 1 / (1 + np.exp(-naming.margin))
    confidence: dict[str, float] = {}
    for k, name in enumerate(names):
        if (mine := naming.marker[numbers] == k).any():
            confidence[name] = round(float(sure[numbers[mine]].mean()), 4)
    share = float((naming.marker[numbers] >= 0).mean())
    lacking = [name for name in names if name not in confidence]
    said: list[str] = []
    if 1 - share > _MANY_OPEN:
        said.append(
            f"{100 * (1 - share):.0f} % of the points were left without a name, as it is doubtful "
            "which markers they are" + (_MAY_BE_WRONG if 1 - share > _LOST else "")
        )
    if lacking:
        said.append(f"markers found in no frame: {', '.join(lacking)}")
    held = naming.marker[numbers] >= 0
    before = np.array(seen.marker_names)[points[held]]
    after = np.array(names)[naming.marker[numbers[held]]]
    other = after[(before != after) & np.isin(before, names)]
    if len(other):  # some points had the name of another marker
        which = [f"{name} ({count})" for name, count in Counter(other.tolist()).most_common()]
        said.append(f"{len(other)} points had another marker's name: {listed(which)}")
    recording = dataclasses.replace(
        seen,
        marker_names=tuple(labels),
        positions=positions,
        visible=visible,
        decisions=(*seen.decisions, f"{100 * share:.1f} % of the points named as in {like}"),
    )
    return LabelledMarkers(recording, confidence, share, tuple(said), columns, source)
