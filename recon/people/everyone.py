"""Splits 2D keypoints of one or several views into one observation per person."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.body.model import BodyModel
from recon.core.errors import FormatError, ObservationError
from recon.detections.tables import holds_detections
from recon.fitting.records import Clip, clip_between, seen_times
from recon.fitting.settings import FitSettings
from recon.formats.producers import is_film
from recon.reading.clip import DETECTIONS, as_format_errors, clip_of_files, files_of_projects
from recon.reading.same_person import everybody_across_views
from recon.reading.tracks import Track
from recon.reading.views import SeenViews, Views, read_views

_LEAST_SECONDS = 0.5
_LEAST_SHARE = 0.1
"""Somebody seen for less, or less completely than this share of who is seen best, is left out."""


@dataclass(frozen=True)
class SeenPerson:
    """A person who was found in at least one view, with their keypoints in every view."""

    number: int
    """Their number by first appearance in the first view that shows them, for `--person`."""
    views: Views
    """Keypoints of this person in every view."""
    note: str
    """Frames in which they were seen, and their place in the image."""


@dataclass(frozen=True)
class Everyone:
    """All people who were seen for long enough to be fitted, and notes on the others."""

    people: tuple[SeenPerson, ...]
    decisions: tuple[str, ...]
    """People who were left out, and the reasons."""


@dataclass(frozen=True)
class PersonClip:
    """A person's number and observations, as `recon.fit_people` takes them."""

    number: int
    """The person's number, as the option `person` takes it."""
    clip: Clip
    """What was seen of them, from when they were first seen to when they were last seen."""


def people_in(
    paths: Sequence[Path], settings: FitSettings, body: BodyModel
) -> tuple[tuple[PersonClip, ...], tuple[str, ...]]:
    """Read 2D keypoints; return a clip per person, and notes on people who were left out.

    Raises:
        FileNotFoundError: when something is not there.
        FormatError: when it is something else than detections, cannot be read, or options are
            missing; says what to do.
    """
    with as_format_errors():
        paths, settings, projects = files_of_projects(paths, settings)
        for path in paths:
            known = path.suffix.lower() in DETECTIONS or is_film(path) or holds_detections(path)
            if path.is_file() and not known:
                raise FormatError(
                    f"{path}: --person all takes only films and files of 2D detections (.json, "
                    ".csv, .npz, or folders of them), in which it finds people; leave this out"
                )
        if settings.masks is not None:
            raise ObservationError("--masks show one person; leave them out with --person all")
        seen = read_views(paths, settings, settings.between)
        found = grouped_people(seen)
        people: list[PersonClip] = []
        first, last = settings.between or (-math.inf, math.inf)
        elsewhen: list[str] = []
        for one in found.people:
            files = list(zip(one.views.names, one.views.files, strict=True))
            clip = clip_of_files(files, [one.note], settings, body)
            times = np.concatenate([seen_times(view) for view in clip.observations])
            span = max(times.min(), first), min(times.max(), last)
            if span[1] - span[0] < _LEAST_SECONDS and settings.between is not None:
                elsewhen.append(f"left out, hardly seen from {first:g} to {last:g} s: {one.note}")
            else:
                people.append(PersonClip(one.number, clip_between(clip, *span)))
        if not people:
            raise ObservationError(
                f"--between {first:g} {last:g}: nobody is seen for at least {_LEAST_SECONDS} s "
                f"between these times; found were {'; '.join(one.note for one in found.people)}"
            )
    notes = [decision for one in projects for decision in one.decisions]
    return tuple(people), (*notes, *seen.decisions, *found.decisions, *elsewhen)


def grouped_people(seen: SeenViews) -> Everyone:
    """Group the tracks of all views by person; return the keypoints of each person.

    Raises:
        ValueError: when a view shows nobody, or nobody is seen for half a second.
    """
    views = seen.tracked_views()
    notes: list[str] = []
    if len(views) == 1:
        groups: list[tuple[int, list[Track | None]]] = [(t.number, [t]) for t in views[0].tracks]
    else:
        groups, notes = everybody_across_views(views, up_given=seen.up_given)
    best = max((_completeness(tracks) for _, tracks in groups), default=0.0)
    people: list[SeenPerson] = []
    for number, tracks in groups:
        note = "; ".join(str(track) for track in tracks if track is not None)
        seconds = max(len(track.frame) for track in tracks if track is not None) / seen.fps
        if seconds < _LEAST_SECONDS or _completeness(tracks) < _LEAST_SHARE * best:
            notes.append(f"left out, seen too little: {note}")
            continue
        people.append(SeenPerson(number, seen.views(tracks, [note]), note))
    if len(people) == 0:
        raise ObservationError(
            f"{', '.join(seen.names)}: nobody is seen for at least {_LEAST_SECONDS} s; found were "
            + "; ".join(str(track) for view in views for track in view.tracks)
        )
    lost = [t for view in views for t in view.tracks if t.ended_by is not None]
    if lost:
        notes.append(
            "people came so near to each other that who is who afterwards cannot be told; they "
            "are given as several people: " + "; ".join(map(str, lost))
        )
    return Everyone(tuple(people), tuple(notes))


def _completeness(tracks: Sequence[Track | None]) -> float:
    return sum(track.completeness for track in tracks if track is not None)
