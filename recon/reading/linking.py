"""Links detections to people from frame to frame, following several assignments at once.

A person is expected at the place extrapolated at constant velocity. Where people overlap, several
assignments of detections to people are followed side by side, each with the sum of its costs (half
squared deviations in units of their spread, so that differences are logarithms of likelihood
ratios), until they differ only in the people's numbers. Then the cheapest is kept, and marked as
doubtful where another is about as cheap.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.detections.records import Detections
from recon.reading.assignments import BEGINS, cheapest_assignments
from recon.reading.places import (
    FEWEST_KEYPOINTS,
    centre_of,
    keypoint_distance,
    log_trunk_length,
    pose_change,
    size_of,
    without_fragments,
)

LOST_AFTER = 60
"""Frames without a detection after which somebody who comes back is somebody new."""
_GATE, _GATE_GROWTH, _GATE_LIMIT = 0.35, 0.05, 0.8
"""How far somebody may be from the expected place, in body sizes, and more for each frame without
a detection, and at most."""
_SPREADS = (0.01, 0.05)
"""Least and largest deviation from frame to frame that is taken as usual, in body sizes."""
_SPREAD_GROWTH = 0.5
"""Growth of the usual deviation for each frame without a detection."""
_LOOSEST = 0.1
"""Largest deviation of a keypoint from where the body's pose had it, in body sizes."""
_FARTHEST = 3.0
"""Deviations beyond which a keypoint costs no more: detectors give somebody the limbs of who is in
front of them."""
_TAIL = 6.0
"""Logarithms of a likelihood at which the place of the whole body begins to count less."""
_INDEPENDENT = 0.25
"""Share of the keypoints that err independently of each other."""
_SAME_PLACE = 0.08
"""Two detections of a frame so close, keypoint by keypoint, are one person found twice ..."""
_NEAR_PERSON = 0.25
"""... unless so near, in body sizes, two people are expected who were seen lately."""
_LATELY = 10
"""Frames."""
_TRUNK_SPREAD, _TRUNK_SHARE = 0.15, 0.2
"""Spread of the logarithm of the trunk's length in the image, and how much a frame tells of it, as
neighbouring frames repeat each other."""
_MEMORY = 0.2
"""Share of a new frame in velocity and trunk length."""
_COASTING = 15
"""Frames after which the velocity of somebody unseen is forgotten."""
_KEPT, _WORST = 12, 14.0
"""Most assignments that are followed side by side, and how much more one may cost."""
_SEEN_FRAMES = 5
"""Latest frames of a person that are kept; assignments that agree in these are one."""
CERTAIN = 3.0
"""Least difference in cost by which one assignment is believed: odds of 20 to 1."""


@dataclass(frozen=True)
class PersonLinks:
    """The person that every detection of a view belongs to, and where tracks end in doubt."""

    labels: Int[np.ndarray, " rows"]
    """Person of every detection; -1 if it shows only a part of a body that another shows."""
    ended: Mapping[int, int]
    """Frame in which a person's track ends because it may go on as somebody else's."""


@dataclass(frozen=True)
class _Person:
    """A tracked person: their last detection, velocity and size in the image."""

    label: int
    rows: tuple[int, ...]
    """Their last detections."""
    frame: int
    pixels: Float[np.ndarray, "points 2"]
    known: Bool[np.ndarray, " points"]
    velocity: Float[np.ndarray, "2"]
    """Pixels per frame."""
    size: float
    """Size of the body in the image, pixels."""
    trunk: float
    """Logarithm of its length in pixels; NaN before it was seen."""

    def expected(self, frame: int) -> Float[np.ndarray, "points 2"]:
        """Return the keypoints' pixels extrapolated at constant velocity to a later frame."""
        return self.pixels + self.extrapolated_frames(frame) * self.velocity

    def extrapolated_frames(self, frame: int) -> int:
        """Return the number of frames to extrapolate to `frame`; 0 if these are too many."""
        gone = frame - self.frame
        return gone if gone <= _COASTING else 0


@dataclass(frozen=True)
class _FrameLinks:
    """The person of each detection of a frame, linked to the record of the frame before."""

    number: int
    labels: dict[int, int]
    """Row to label."""
    before: "_FrameLinks | None"


@dataclass(frozen=True)
class _Assignment:
    """A hypothesis about which detections up to now belong to which people, and its cost."""

    people: tuple[_Person, ...]
    cost: float
    frames: _FrameLinks | None
    next_label: int
    """The label that the next new person gets."""
    doubts: tuple[tuple[int, frozenset[int]], ...] = ()
    """First frame of every doubt, and the labels that it concerns from then on."""

    @property
    def without_identities(self) -> frozenset[tuple[int, ...]]:
        """The set of all people's last detections, without the people's numbers.

        It is equal for assignments that differ only in the people's numbers.
        """
        return frozenset(person.rows for person in self.people)


def largest_allowed_distance(unseen_frames: int) -> float:
    """Return how far a detection may lie from its expected place, in body sizes.

    Args:
        unseen_frames: number of frames without a detection before.
    """
    return min(_GATE + _GATE_GROWTH * unseen_frames, _GATE_LIMIT)


def link_detections(detections: Detections, rows: Int[np.ndarray, " rows"]) -> PersonLinks:
    """Link detections over time; return which person every detection belongs to.

    Args:
        detections: of one view.
        rows: detections that are people, by frame.
    """
    found = _LinkSearch(detections, rows)
    for frame in np.unique(detections.frame[rows]).tolist():
        found.link_frame(frame)
    return found.links()


class _LinkSearch:
    """Links detections frame by frame, following several assignments in parallel."""

    def __init__(self, detections: Detections, rows: Int[np.ndarray, " rows"]) -> None:
        self.seen = detections
        self.rows = rows
        self.sizes = {int(r): size_of(detections, int(r)) for r in rows}
        self.trunks = {int(r): log_trunk_length(detections, int(r)) for r in rows}
        self.spread = self._usual_spread()
        self.followed = [_Assignment((), 0.0, None, 0)]

    def link_frame(self, frame: int) -> None:
        """Link the detections of the next frame."""
        every = self.rows[self.seen.frame[self.rows] == frame].tolist()
        alive = [
            replace(one, people=tuple(p for p in one.people if frame - p.frame <= LOST_AFTER))
            for one in self.followed
        ]
        here = without_fragments(self.seen, every, [p.rows[-1] for p in alive[0].people])
        here = self._without_duplicates(here, alive[0].people, frame)
        after: list[_Assignment] = []
        for one in alive:
            costs = self._costs_of_links(one.people, here, frame)
            after += [
                self._with_frame_linked(one, here, frame, pairs, costs)
                for pairs in cheapest_assignments(costs)
            ]
        self.followed = self._best_distinct(after)

    def links(self) -> PersonLinks:
        """Return the best assignment, with tracks ended and begun anew where it is doubtful."""
        best, *others = self.followed
        for other in others:
            best = _marked_if_doubtful(best, other)
        labels = dict[int, int]()
        step = best.frames
        while step is not None:
            labels.update(step.labels)
            step = step.before
        ended: dict[int, int] = {}
        next_label = best.next_label
        for frame, names in sorted(best.doubts, key=lambda doubt: -doubt[0]):
            for name in sorted(names):
                own = [row for row, label in labels.items() if label == name]
                later = [row for row in own if self.seen.frame[row] >= frame]
                if not 0 < len(later) < len(own):
                    continue
                labels.update(dict.fromkeys(later, next_label))
                if name in ended:
                    ended[next_label] = ended[name]
                ended[name] = frame
                next_label += 1
        return PersonLinks(np.array([labels.get(int(row), -1) for row in self.rows]), ended)

    def _without_duplicates(
        self, rows: Sequence[int], people: Sequence[_Person], frame: int
    ) -> list[int]:
        """Return a frame's detections; of several of one person, the most confident only."""
        expected = [
            p.expected(frame)
            for p in people
            if frame - p.frame <= _LATELY and len(p.rows) == _SEEN_FRAMES
        ]
        kept: list[int] = []
        for row in sorted(rows, key=lambda r: -float(self.seen.confidence[r].sum())):
            doubles = sum(keypoint_distance(self.seen, row, other) < _SAME_PLACE for other in kept)
            if doubles < max(sum(self._is_near(row, place) for place in expected), 1):
                kept.append(row)
        return sorted(kept)

    def _is_near(self, row: int, expected_pixels: Float[np.ndarray, "points 2"]) -> bool:
        known = self.seen.confidence[row] > 0
        away = np.linalg.norm(
            self.seen.pixels[row, known] - expected_pixels[known], axis=-1
        ).mean()
        return bool(away < _NEAR_PERSON * self.sizes[row])

    def _usual_spread(self) -> float:
        """Return the median change of people's poses from frame to frame, in body sizes."""
        near: list[float] = []
        by_frame = [
            self.rows[self.seen.frame[self.rows] == f]
            for f in np.unique(self.seen.frame[self.rows])
        ]
        for one, two in pairwise(by_frame):
            for a in one.tolist():
                nearest = min(two.tolist(), key=lambda b, a=a: keypoint_distance(self.seen, a, b))
                near.append(pose_change(self.seen, a, nearest))
        usual = np.median(near) if near else np.inf
        return float(np.clip(usual, *_SPREADS))

    def _costs_of_links(
        self, people: Sequence[_Person], rows: Sequence[int], frame: int
    ) -> Float[np.ndarray, "people rows"]:
        """Return the cost of linking each person to each detection; infinite if too far apart."""
        out = np.full((len(people), len(rows)), np.inf)
        for k, person in enumerate(people):
            expected, unseen = person.expected(frame), frame - person.frame - 1
            gate = largest_allowed_distance(unseen)
            spread = self.spread * (1 + _SPREAD_GROWTH * unseen)
            for p, row in enumerate(rows):
                size = max(person.size, self.sizes[row])
                both = person.known & (self.seen.confidence[row] > 0)
                if both.sum() >= FEWEST_KEYPOINTS:
                    away = self.seen.pixels[row, both] - expected[both]
                    still = self.seen.pixels[row, both] - person.pixels[both]
                else:
                    middle = centre_of(self.seen, row)
                    away = middle - expected[person.known].mean(0, keepdims=True)
                    still = middle - person.pixels[person.known].mean(0, keepdims=True)
                least = min(np.linalg.norm(way.mean(0)) for way in (away, still))
                if least / size > gate:
                    continue
                moved = np.median(away, axis=0)
                apart = np.linalg.norm(away - moved, axis=-1) / (size * min(spread, _LOOSEST))
                pose = _INDEPENDENT * np.square(np.minimum(apart, _FARTHEST)).sum() / 2
                far = np.linalg.norm(moved) / (size * spread)
                place = _TAIL * np.log1p(np.square(far) / (2 * _TAIL))
                longer = (self.trunks[row] - person.trunk) / _TRUNK_SPREAD
                trunk = 0.0 if np.isnan(longer) else _TRUNK_SHARE * min(longer**2 / 2, 2.0)
                out[k, p] = place + pose + trunk
        return out

    def _with_frame_linked(
        self,
        assignment: _Assignment,
        rows: Sequence[int],
        frame: int,
        chosen_rows: Mapping[int, int],
        costs: Float[np.ndarray, "people rows"],
    ) -> _Assignment:
        people, next_label, cost, labels = (
            list(assignment.people),
            assignment.next_label,
            assignment.cost,
            dict[int, int](),
        )
        taken = {p: k for k, p in chosen_rows.items()}
        for p, row in enumerate(rows):
            if p in taken:
                k = taken[p]
                cost += float(costs[k, p])
                people[k] = self._updated_person(people[k], row, frame)
                labels[row] = people[k].label
            else:
                cost += BEGINS
                people.append(self._new_person(next_label, row, frame))
                labels[row] = next_label
                next_label += 1
        step = _FrameLinks(frame, labels, assignment.frames)
        return _Assignment(tuple(people), cost, step, next_label, assignment.doubts)

    def _new_person(self, label: int, row: int, frame: int) -> _Person:
        known = self.seen.confidence[row] > 0
        return _Person(
            label, (row,), frame, self.seen.pixels[row], known, np.zeros(2), self.sizes[row],
            self.trunks[row],
        )  # fmt: skip

    def _updated_person(self, person: _Person, row: int, frame: int) -> _Person:
        known, pixels = self.seen.confidence[row] > 0, self.seen.pixels[row]
        both, frames = person.known & known, frame - person.frame
        kept = person.velocity if person.extrapolated_frames(frame) else np.zeros(2)
        moved = frames * kept
        if both.sum() >= FEWEST_KEYPOINTS:
            moved = np.median(pixels[both] - person.pixels[both], axis=0)
        # weight of the new frame in running means; in a new track all frames weigh the same
        share = max(_MEMORY, 1 / len(person.rows)) if len(person.rows) < _SEEN_FRAMES else _MEMORY
        trunk = self.trunks[row]
        if not np.isnan(person.trunk) and not np.isnan(trunk):
            trunk = person.trunk + share * (trunk - person.trunk)
        elif np.isnan(trunk):
            trunk = person.trunk
        return replace(
            person,
            rows=(*person.rows, row)[-_SEEN_FRAMES:],
            frame=frame,
            pixels=np.where(known[:, None], pixels, person.pixels + moved),
            known=person.known | known,
            velocity=kept + share * (moved / frames - kept),
            size=max(self.sizes[row], 0.9 * person.size),
            trunk=trunk,
        )

    def _best_distinct(self, assignments: list[_Assignment]) -> list[_Assignment]:
        """Return the cheapest assignments, without those that differ only in people's numbers."""
        assignments.sort(key=lambda one: one.cost)
        kept: dict[frozenset[tuple[int, ...]], _Assignment] = {}
        for one in assignments:
            if one.cost > assignments[0].cost + _WORST:
                break
            same = kept.get(one.without_identities)
            if same is None:
                kept[one.without_identities] = one
            else:
                kept[one.without_identities] = _marked_if_doubtful(same, one)
        return list(kept.values())[:_KEPT]


def _marked_if_doubtful(best: _Assignment, other: _Assignment) -> _Assignment:
    """Return the best assignment, marked as doubtful where the other is about as good."""
    if other.cost - best.cost >= CERTAIN:
        return best
    names = {person.rows[-1]: person.label for person in other.people}
    changed = frozenset(
        person.label
        for person in best.people
        if names.get(person.rows[-1], person.label) != person.label
    )
    if not changed:
        return best
    doubt = _first_differing_frame(best.frames, other.frames), changed
    return replace(best, doubts=(*best.doubts, doubt))


def _first_differing_frame(one: _FrameLinks | None, two: _FrameLinks | None) -> int:
    """Return the first frame in which two assignments of detections to people differ."""
    first = -1
    while one is not two:
        assert one is not None
        assert two is not None
        if one.labels != two.labels:
            first = one.number
        one, two = one.before, two.before
    return first
