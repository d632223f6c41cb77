"""One person in several calibrated views: the tracks whose rays meet."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from recon.core.coordinates import corrected_up
from recon.core.errors import ObservationError
from recon.reading.tracks import CONFIDENT, Track, TrackedView, Triangulated, triangulated

_CONSISTENT = 0.03
"""Median reprojection error of one person's triangulated keypoints, in body sizes."""
_JOINTLY = 0.05
"""Median reprojection error, in body sizes, of keypoints triangulated from all views at once, in
which errors along single rays show."""
_CLEARLY = 2.0
_MARGIN = 0.005
"""A second track of a view that overlaps the first must fit so many times, and so much, worse."""
_SEED = 0.2
"""Tracks less complete than this share of their view's best do not make a person."""
_EQUAL = 0.8
"""Ratio of completeness up to which no person is the most complete, as in `people`."""
_DOUBTFUL = 0.5
"""Share of the person's completeness from which somebody in one view alone is doubtful."""
_TRUNK = (0.2, 0.9)
"""Metres between shoulder and hip of a side: children to the tallest adults."""


def person_across_views(
    views: Sequence[TrackedView], person: int | None, *, up_given: bool
) -> tuple[list[Track | None], tuple[str, ...]]:
    """The tracks of one person, one per view or None where it is not found, and the reasons.

    For two tracks of two views, keypoints seen in both are triangulated; the tracks can be one
    person when the median reprojection error is at most 3 % of the body's size in the image. Where
    none are, and some are with y pointing up in all views or in one, y is turned down.
    Parts of a track that was lost and found again are joined where the other views agree.

    Args:
        views: at least two, all with a camera pose.
        person: number of a track of the first view; None for whoever is seen most completely.
        up_given: whether the up axis of the world is known, so that a body that does not stand
            along it is no reason to doubt it.

    Raises:
        ValueError: when no tracks of two views agree, several persons are seen about equally
            well, or the triangulated body has no human size or does not stand along z.
    """
    pairs = _TriangulatedPairs(views)
    if person is not None and not 0 <= person < len(views[0].tracks):
        raise ObservationError(
            f"{views[0].name}: there is no person {person}; there are {_listed_people(views[:1])}"
        )
    seeds = [(0, person)] if person is not None else _starting_tracks(views)
    groups = [
        group for group in (pairs.consistent_group(*seed) for seed in seeds) if len(group) > 1
    ]
    if len(groups) == 0:
        for turned, names in _with_flipped_y(views):
            if any(len(_TriangulatedPairs(turned).consistent_group(*seed)) > 1 for seed in seeds):
                tracks, said = person_across_views(turned, person, up_given=up_given)
                told = (
                    f"y of the keypoints of {names} points up, as rays meet only so: turned down"
                )
                return tracks, (told, *said)
        if np.isinf(pairs.smallest_error()):
            raise ObservationError(
                "no two views show enough of the same keypoints at the same moments with "
                f"confidences of {CONFIDENT:g} or more. There are {_listed_people(views)}"
            )
        raise ObservationError(
            "no person found in one view is found in another: rays of the same keypoints miss "
            f"each other (least median error {pairs.smallest_error():.1%} of the body, at most "
            f"{_CONSISTENT:.0%} expected). Does each view have its own camera, is the calibration "
            f"of this recording, do the frames belong together? There are {_listed_people(views)}"
        )
    groups.sort(key=lambda group: -_completeness(views, group))
    best = groups[0]
    for other in groups[1:]:
        same = any(set(best.get(v, ())) & set(other.get(v, ())) for v in other)
        if not same and _completeness(views, other) >= _EQUAL * _completeness(views, best):
            raise ObservationError(
                "two persons are seen about equally well; choose one with --person, by number in "
                f"{views[0].name}. There are {_listed_people(views)}"
            )
    pairs.check_left_out_views(best)
    error = pairs.check_body(best, up_given=up_given)
    notes = [f"rays of the views meet: median error {error:.1%} of the body's size"]
    for v, view in enumerate(views):
        found = " and ".join(str(view.tracks[k]) for k in best.get(v, ()))
        none = "left out, the person of the other views is not found"
        notes.append(f"{view.name}: {found or none}")
    return _merged_tracks_by_view(views, best), tuple(notes)


def _with_flipped_y(views: Sequence[TrackedView]) -> Iterator[tuple[list[TrackedView], str]]:
    """Yield the views with pixel y reversed in all, then in one each, and words that say where."""
    over = [
        replace(
            view,
            tracks=tuple(track.flipped_in_y(view.camera.image_size[1]) for track in view.tracks),
        )
        for view in views
    ]
    yield over, "all views"
    for v, view in enumerate(views):
        yield [over[v] if one is view else one for one in views], view.name


def everybody_across_views(
    views: Sequence[TrackedView], *, up_given: bool
) -> tuple[list[tuple[int, list[Track | None]]], list[str]]:
    """Everybody found in two or more views, numbered as in the first view that shows them.

    Args:
        views: as of `person_across_views`.
        up_given: as of `person_across_views`.

    Returns:
        The tracks of every person, one per view or None, and who was left out.

    Raises:
        ValueError: when nobody is found in two views, or somebody has no human size or does not
            stand along z.
    """
    pairs = _TriangulatedPairs(views)
    taken: set[tuple[int, int]] = set()
    found: list[tuple[int, list[Track | None]]] = []
    notes: list[str] = []
    for v, a in _starting_tracks(views):
        if (v, a) in taken:
            continue
        group = pairs.consistent_group(v, a)
        members = {(w, b) for w, own in group.items() for b in own}
        if len(group) < 2 or members & taken:
            notes.append(
                f"left out, found in no other view: {views[v].name}: {views[v].tracks[a]}"
            )
            continue
        taken |= members
        pairs.check_body(group, up_given=up_given)
        first = min(group)
        number = views[first].tracks[group[first][0]].number
        found.append((number, _merged_tracks_by_view(views, group)))
    if len(found) == 0:
        raise ObservationError(
            "no person found in one view is found in another; does each view have its own camera? "
            f"There are {_listed_people(views)}"
        )
    return found, notes


def _merged_tracks_by_view(
    views: Sequence[TrackedView], group: Mapping[int, tuple[int, ...]]
) -> list[Track | None]:
    """One track of a person for every view, made of its pieces; None where the view has none."""
    out: list[Track | None] = []
    for v, view in enumerate(views):
        tracks = [view.tracks[k] for k in group.get(v, ())]
        if not tracks:
            out.append(None)
            continue
        frame = np.concatenate([track.frame for track in tracks])
        order = np.argsort(frame)
        pixels = np.concatenate([track.pixels for track in tracks])[order]
        confidence = np.concatenate([track.confidence for track in tracks])[order]
        hands = [track.hands for track in tracks if track.hands is not None]
        both = np.concatenate(hands)[order] if hands else None
        out.append(Track(tracks[0].number, frame[order], pixels, confidence, both))
    return out


class _TriangulatedPairs:
    """Triangulations of pairs of tracks, each made once."""

    def __init__(self, views: Sequence[TrackedView]) -> None:
        self.views = views
        self._made: dict[tuple[int, int, int, int], Triangulated] = {}

    def pair(self, v: int, a: int, w: int, b: int) -> Triangulated:
        """Keypoints triangulated from track a of view v and track b of view w."""
        if v > w:
            v, a, w, b = w, b, v, a
        if (v, a, w, b) not in self._made:
            self._made[v, a, w, b] = triangulated([(self.views[v], a), (self.views[w], b)])
        return self._made[v, a, w, b]

    def smallest_error(self) -> float:
        """The smallest triangulation error of any pair of tracks."""
        return min((pair.error for pair in self._made.values()), default=float("inf"))

    def consistent_group(self, v: int, a: int) -> dict[int, tuple[int, ...]]:
        """Tracks of all views that agree with a track and with each other, by view."""
        group: dict[int, tuple[int, ...]] = {v: (a,)}
        for w, view in enumerate(self.views):
            if w == v:
                continue
            chosen = _best_track(view, self._errors_with_group(group, w))
            if chosen:
                group[w] = chosen
        if len(group) > 1:
            others = {w: members for w, members in group.items() if w != v}
            errors = self._errors_with_group(others, v) | {a: 0.0}
            group[v] = (a, *(b for b in _best_track(self.views[v], errors) if b != a))
        return group

    def _errors_with_group(self, group: Mapping[int, tuple[int, ...]], w: int) -> dict[int, float]:
        """How badly each track of a view fits a group: its largest error with any member view."""
        return {
            b: max(min(self.pair(v, k, w, b).error for k in group[v]) for v in group)
            for b in range(len(self.views[w].tracks))
        }

    def check_left_out_views(self, group: Mapping[int, tuple[int, ...]]) -> None:
        """Raise an error if a left-out view clearly shows somebody whom no other view shows.

        Raises:
            ValueError: when it shows somebody, as completely as the others show the person, who
                is in no other view: then its camera is doubtful.
        """
        enough = _DOUBTFUL * _completeness(self.views, group) / len(group)
        for w, view in enumerate(self.views):
            for b, track in enumerate(view.tracks):
                if w in group or track.completeness < enough:
                    continue
                errors = [
                    self.pair(v, a, w, b).error
                    for v, other in enumerate(self.views)
                    for a in range(len(other.tracks))
                    if v != w and a not in group.get(v, ())
                ]
                if min(errors, default=np.inf) > _CONSISTENT:
                    raise ObservationError(
                        f"{view.name} does not agree with the other views: its person {b} is "
                        "nobody whom they see. Check that this view has its own camera, or leave "
                        f"it out. There are {_listed_people(self.views)}"
                    )

    def check_body(self, group: Mapping[int, tuple[int, ...]], *, up_given: bool) -> float:
        """Return a group's error; refuse disagreeing views, a wrong body size or wrong up axis."""
        members = [(v, tracks[0]) for v, tracks in group.items()]
        made = [self.pair(*one, *two) for k, one in enumerate(members) for two in members[k + 1 :]]
        pair = min(made, key=lambda pair: pair.error)
        every = triangulated([(self.views[v], number) for v, number in members])
        errors = [float(np.median(miss[every.seen])) for miss in every.misses if every.seen.any()]
        if max(errors, default=0.0) > _JOINTLY:
            names = [self.views[v].name for v, _ in members]
            worst = ", ".join(f"{name} {e:.1%}" for name, e in zip(names, errors, strict=True))
            raise ObservationError(
                "the views agree in pairs, but not all together: points triangulated from all "
                f"views miss their keypoints by {worst} of the body size (at most {_JOINTLY:.0%} "
                "expected). Does each view have its own camera, and does it begin with the others?"
            )
        trunk = _trunk_length(pair)
        if trunk is not None and not _TRUNK[0] <= trunk <= _TRUNK[1]:
            raise ObservationError(
                f"the calibration makes the body's trunk {trunk:.3g} m long, not {_TRUNK[0]} to "
                f"{_TRUNK[1]} m; give its unit with --camera-unit"
            )
        found = None if up_given else corrected_up("z", pair.names, pair.points, pair.seen)
        if found is not None:
            raise ObservationError(
                f"in the calibration's world the body stands along {found}, but z was taken as "
                f"up; give --camera-up {found}, or z if the person lies"
            )
        return float(np.median([pair.error for pair in made]))


def _best_track(view: TrackedView, errors: Mapping[int, float]) -> tuple[int, ...]:
    """The best track and those that continue it; short rivals of similar error are left out.

    Raises:
        ValueError: when another that overlaps the best is about as good.
    """
    fit = [b for b, error in errors.items() if error <= _CONSISTENT]
    chosen: list[int] = []
    for b in sorted(fit, key=lambda b: -view.tracks[b].completeness):
        rivals = [
            c for c in chosen if np.intersect1d(view.tracks[b].frame, view.tracks[c].frame).size
        ]
        if not rivals:
            chosen.append(b)
            continue
        rival = rivals[0]
        if errors[b] * _CLEARLY + _MARGIN <= errors[rival]:
            chosen[chosen.index(rival)] = b
        elif errors[rival] * _CLEARLY + _MARGIN > errors[b] and (
            view.tracks[b].completeness >= _SEED * view.tracks[rival].completeness
        ):
            if rival != chosen[0]:
                chosen.remove(rival)
                continue
            raise ObservationError(
                f"{view.name}: persons {rival} and {b} fit the other views about equally well; "
                f"give fewer views or files of one person. There are {_listed_people([view])}"
            )
    return tuple(chosen)


def _starting_tracks(views: Sequence[TrackedView]) -> list[tuple[int, int]]:
    out: list[tuple[int, int]] = []
    for v, view in enumerate(views):
        most = max(track.completeness for track in view.tracks)
        out += [
            (v, a) for a, track in enumerate(view.tracks) if track.completeness >= _SEED * most
        ]
    # tracks of the first view come first: persons are numbered as in that view
    return sorted(out, key=lambda seed: (seed[0], -views[seed[0]].tracks[seed[1]].completeness))


def _completeness(views: Sequence[TrackedView], group: Mapping[int, tuple[int, ...]]) -> float:
    return sum(views[v].tracks[k].completeness for v, members in group.items() for k in members)


def _listed_people(views: Sequence[TrackedView]) -> str:
    return "; ".join(f"in {view.name}: " + ", ".join(map(str, view.tracks)) for view in views)


def _trunk_length(keypoints: Triangulated) -> float | None:
    lengths: list[np.ndarray] = []
    for side in ("left", "right"):
        if {f"{side}_shoulder", f"{side}_hip"} <= set(keypoints.names):
            ends = [keypoints.names.index(f"{side}_{end}") for end in ("shoulder", "hip")]
            both = keypoints.seen[:, ends].all(1)
            joints = keypoints.points[both][:, ends]
            lengths.append(np.linalg.norm(joints[:, 0] - joints[:, 1], axis=-1))
    found = np.concatenate(lengths) if lengths else np.zeros(0)
    return float(np.median(found)) if len(found) > 0 else None
