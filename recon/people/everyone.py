"""Everybody in detections of one or several views: an observation of each person."""

from collections.abc import Sequence
from dataclasses import dataclass

from observations.people.same_person import everybody_across_views
from observations.people.tracks import Track
from observations.people.views import SeenViews, Views
from recon.core.errors import ObservationError

_LEAST_SECONDS = 0.5
_LEAST_SHARE = 0.1
"""Somebody seen for less, or less completely than this share of who is seen best, is left out."""


@dataclass(frozen=True)
class SeenPerson:
    """One of several people."""

    number: int
    """Their number by first appearance in the first view that shows them, for `--person`."""
    views: Views
    """What was seen of them."""
    note: str
    """Frames in which they were seen, and their place in the image."""


@dataclass(frozen=True)
class Everyone:
    """Everybody who was seen for long enough to be fitted."""

    people: tuple[SeenPerson, ...]
    decisions: tuple[str, ...]
    """People who were left out, and the reasons."""


def everyone(seen: SeenViews) -> Everyone:
    """Every person's observation.

    Raises:
        ValueError: when a view shows nobody, or nobody is seen for half a second.
    """
    views = seen.followed()
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
        people.append(SeenPerson(number, seen.of(tracks, [note]), note))
    if len(people) == 0:
        raise ObservationError(
            f"{', '.join(seen.names)}: nobody is seen for {_LEAST_SECONDS} s; there are "
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
