"""`recon.label`: names for the markers of a recording that has none."""

import dataclasses
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.results import Tables, closing_fields
from recon.body.model import BodyModel
from recon.core.errors import FormatError, ReconError
from recon.core.units import Unit, Up
from recon.formats.outputs import Output, OutputKind
from recon.formats.writing import writing
from recon.ingest.marker_naming import Naming
from recon.ingest.marker_places import distances_in_trial
from recon.ingest.marker_tracks import tracks_of
from recon.mocap.marker_tables import write_trc
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording, SkeletonRecording
from recon.solver.solution import one_thread

_FEWEST_NAMES = 10
_MANY_OPEN = 0.1
"""Share of the points without a name that is worth a warning."""


@dataclass(frozen=True, repr=False)
class LabelledMarkers:
    """A recording whose markers have names, and the tracks that could not be named."""

    recording: MarkerRecording
    """Named markers, then points without a name (*1, *2, ...); metres, z up."""
    confidence: Mapping[str, float]
    """Mean probability of the name over the frames of each named marker."""
    named: float
    """Share of all points that have a name."""
    warnings: tuple[str, ...]

    @property
    def tables(self) -> Tables:
        """The share of points with a name."""
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
        """Write a TRC file in millimetres, y up, and the report OUT.json.

        Raises:
            FormatError: when the name of the file does not end in .trc.
            FileExistsError: when something is there that recon did not write, unless `overwrite`.
        """
        if Path(out).suffix.lower() != ".trc":
            raise FormatError(f"{out}: named markers are written as TRC; expected a name in .trc")
        said = self.report() if report is None else report
        output = Output(Path(out), OutputKind.FILE)
        with writing(output, report=said, overwrite=overwrite) as (staged,):
            write_trc(staged, self.recording)


def label(
    recording: str | Path | SkeletonRecording | MarkerRecording,
    *,
    like: str | Path | None = None,
    unit: Unit | None = None,
    up: Up | None = None,
) -> LabelledMarkers:
    """Name the markers of a recording as in another trial of the same person.

    Trajectories are cut where they jump, and named by their distances from each other and by
    their places seen from others: in the named trial, and on its body in other poses. Names the
    recording has are ignored. Doubtful points stay open (*1, *2, ...). Nothing is random.

    Args:
        recording: a file (.c3d, .trc, ...) of markers without names, of one person.
        like: a recording of this person, with names and the markers in the same places; needed.
        unit: of both files; default: found out.
        up: axis of both files that points up, or down; default: found out.

    Raises:
        ReconError: when one is no recording of markers, or the named trial has fewer than ten
            markers or the other hardly fits it.
        FileNotFoundError: when there is no such file.
    """
    if like is None:
        raise ReconError(
            "expected a trial of the same person whose markers have names; give it with --like"
        )
    body = BodyModel.load()
    trial = _checked_markers(read_recording(like, unit=unit, up=up))
    if isinstance(recording, str | Path):
        recording = read_recording(recording, unit=unit, up=up)
    seen = _checked_markers(recording)
    named = [name for name in trial.marker_names if name[:1] not in ("*", "")]
    if len(named) < _FEWEST_NAMES:
        raise ReconError(
            f"{trial.name}: expected a trial with {_FEWEST_NAMES} named markers or more to name "
            f"others by, got {len(named)}: give one whose markers have names with --like"
        )
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the mean of no values is NaN, as wanted
        model = distances_in_trial(trial.select(named), body)
        track = tracks_of(seen.positions, seen.visible, seen.fps)
        naming = Naming(track, seen.positions, seen.fps, model)
        naming.run()
    if (naming.marker >= 0).sum() < _FEWEST_NAMES:
        raise ReconError(
            f"{seen.name}: its points fit the markers of {trial.name} nowhere; expected the same "
            "person with the same markers, seen at once; check the unit (--unit)"
        )
    return _labelled(seen, naming, trial.name)


def _checked_markers(recording: SkeletonRecording | MarkerRecording) -> MarkerRecording:
    if isinstance(recording, SkeletonRecording):
        raise ReconError(f"{recording.name}: expected markers, got the joints of a skeleton")
    return recording


def _labelled(seen: MarkerRecording, naming: Naming, like: str) -> LabelledMarkers:
    """The recording with a column for every named marker, then for every track without a name."""
    names, track = naming.model.names, naming.track
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
    shape = (len(track), len(names) + len(ends))
    positions, visible = np.zeros((*shape, 3)), np.zeros(shape, bool)
    positions[frames, column[numbers]] = seen.positions[frames, points]
    visible[frames, column[numbers]] = True
    sure = 1 / (1 + np.exp(-naming.margin))
    confidence: dict[str, float] = {}
    for k, name in enumerate(names):
        if (mine := naming.marker[numbers] == k).any():
            confidence[name] = round(float(sure[numbers[mine]].mean()), 4)
    share = float((naming.marker[numbers] >= 0).mean())
    lacking = [name for name in names if name not in confidence]
    said: list[str] = []
    if 1 - share > _MANY_OPEN:
        said.append(f"{100 * (1 - share):.0f} % of the points have no name: they are doubtful")
    if lacking:
        said.append(f"nowhere found: {', '.join(lacking)}")
    recording = dataclasses.replace(
        seen,
        marker_names=(*names, *(f"*{k + 1}" for k in range(len(ends)))),
        positions=positions,
        visible=visible,
        decisions=(*seen.decisions, f"{100 * share:.1f} % of the points named as in {like}"),
    )
    return LabelledMarkers(recording, confidence, share, tuple(said))
