"""Names the points of a recording without marker names, as optical systems export them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool

from recon.body.marker_labels import FEWEST_MARKERS, are_nameless, is_nameless, load_marker_map
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.units import Unit, Up
from recon.ingest.marker_naming import Naming
from recon.ingest.marker_places import MarkedBody, bodies_of_set, body_of_trial
from recon.ingest.marker_sets import MarkerSet, full_body_markers, markers_of_set
from recon.ingest.marker_tracks import track_numbers
from recon.mocap.reader import read_recording
from recon.mocap.recording import MarkerRecording, SkeletonRecording
from recon.solver.solution import one_thread

USUAL = ("cmu", "pig")
"""Sets of markers, of 41 and 39, one of which is assumed for points without names, if the user
gives none: that whose number is nearest to the number of points seen at once."""
_TABLES = (".toml", ".json")


def placed_markers(
    recording: MarkerRecording, body: BodyModel, mapping: str | Path | None = None
) -> tuple[MarkerRecording, MarkerSet]:
    """Find a recording's markers on the body, by their labels or, without labels, by their motion.

    In a recording without names, a body is fitted to the points and followed over time. Tracks get
    the names of markers of this body; doubtful tracks are left out.

    Args:
        recording: in metres, z up.
        body: the body model on whose mesh the markers sit.
        mapping: as in `full_body_markers`; for points without names, the table of their set, or a
            recording of the same person and markers that has names. None takes usual places.

    Raises:
        FileNotFoundError: when there is no such file.
        ReconError: as in `full_body_markers`; or when no body is found among the points.
    """
    names = [recording.marker_names[k] for k in np.flatnonzero(recording.visible.any(0))]
    table = mapping if mapping is None or Path(mapping).suffix.lower() in _TABLES else None
    given = () if table is None else load_marker_map(table)
    if not are_nameless(names) or set(given) & set(names):
        return recording, full_body_markers(recording, body, mapping)
    like = "usual places" if mapping is None else str(mapping)
    if mapping is None or table is not None:
        sets = [markers_of_set(name, body) for name in (USUAL if table is None else (table,))]
        count = np.median(recording.visible.sum(1))
        bodies = bodies_of_set(min(sets, key=lambda one: abs(len(one.labels) - count)), body)
    else:
        bodies = [body_of_named_trial(marker_recording(mapping), body)]
    named = _recording_of_named(named_tracks(recording, recording.visible, bodies, like), like)
    return named, replace(full_body_markers(named, body, table), guessed=mapping is None)


def marker_recording(
    given: str | Path | SkeletonRecording | MarkerRecording,
    unit: Unit | None = None,
    up: Up | None = None,
) -> MarkerRecording:
    """Return a recording of markers, which is read if a file is given.

    Raises:
        ReconError: when it holds the joints of a skeleton, or cannot be read.
        FileNotFoundError: when there is no such file.
    """
    read = read_recording(given, unit=unit, up=up) if isinstance(given, str | Path) else given
    if isinstance(read, SkeletonRecording):
        raise ReconError(f"{read.name}: expected markers, got the joints of a skeleton")
    return read


def body_of_named_trial(
    trial: MarkerRecording, body: BodyModel, markers: MarkerSet | None = None
) -> MarkedBody:
    """Fit a body to a trial whose markers have names; return it with these markers.

    Raises:
        ReconError: when fewer than ten markers have names.
    """
    known = () if markers is None else markers.labels
    named = [name for name in trial.marker_names if name in known or not is_nameless(name)]
    if len(named) < FEWEST_MARKERS:
        raise ReconError(
            f"{trial.name}: expected a trial with {FEWEST_MARKERS} named markers or more to name "
            f"others by, got {len(named)}: give one whose markers have names"
        )
    return body_of_trial(trial.select(named), body, markers)


def named_tracks(
    seen: MarkerRecording,
    visible: Bool[np.ndarray, "time points"],
    bodies: list[MarkedBody],
    like: str,
) -> Naming:
    """Name a recording's tracks of points by the markers of the best fitting of some bodies.

    Args:
        seen: the recording.
        visible: which of its points may be markers.
        bodies: bodies with named markers.
        like: origin of these markers, for messages.

    Raises:
        ReconError: when no body fits.
    """
    with one_thread(), torch.no_grad():
        naming = Naming(seen, track_numbers(seen.positions, visible, seen.fps), bodies)
        naming.name_all_tracks()
    if len(np.unique(naming.marker[naming.marker >= 0])) < FEWEST_MARKERS:
        raise ReconError(
            f"{seen.name}: its points fit the markers of {like} in no frame; expected one person "
            "with these markers, upright at some time; check the unit (--unit) and axis (--up)"
        )
    return naming


def _recording_of_named(naming: Naming, like: str) -> MarkerRecording:
    """Return a recording of the named markers alone, with a note on the share of other points."""
    seen, names = naming.seen, naming.bodies[0].markers.labels
    x, visible = naming.named_points(np.arange(seen.frames))
    share = visible.sum() / seen.visible.sum()
    said = (
        f"points without names: {100 * share:.0f} % are markers of a body, found by {like}; the "
        "others were left out, as they are doubtful"
    )
    found = replace(
        seen, marker_names=names, positions=x, visible=visible, decisions=(*seen.decisions, said)
    )
    return found.select([names[k] for k in np.flatnonzero(visible.sum(0))])
