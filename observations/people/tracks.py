"""Following people from frame to frame in one view, and choosing one: never a mixture."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import ObservationError
from recon.formats.detections.records import Detections

FEWEST_KEYPOINTS = 4
"""Detections with fewer are no people."""
_GATE = 0.35
"""How far somebody may move between two frames, in body sizes ..."""
_GATE_GROWTH = 0.05
"""... and for each frame without a detection ..."""
_GATE_LIMIT = 0.8
"""... and at most."""
_NEARLY = 0.08
"""A wrong link this much farther than the right one, in body sizes, might be right."""
_SAME_PLACE = 0.08
"""Two detections of a frame so close, keypoint by keypoint, are one person found twice."""
_PIECE = 0.15
"""Detections with hardly a keypoint in common, each so close to the last sight of somebody,
keypoint by keypoint, are pieces of one body."""
_LOST_AFTER = 60
"""Frames without a detection after which somebody who comes back is somebody new."""
_EQUAL = 0.8
"""Ratio of completeness from which on neither of two tracks is the more complete."""
_STANDS = 0.05
"""Spread of keypoints' places over a film, in body sizes, below which their owner stands by; sway
and the noise of detectors reach 0.03."""
_MOVES = 3.0
"""Multiple of a bystander's that is surely a person who moves."""


@dataclass(frozen=True)
class Track:
    """One person of one view over the frames where they were found."""

    number: int
    """Persons are numbered from 0 by first appearance, those of a frame in the file's order."""
    frame: Int[np.ndarray, " seen"]
    """Frame numbers, increasing."""
    pixels: Float[np.ndarray, "seen points 2"]
    confidence: Float[np.ndarray, "seen points"]
    ended_by: int | None = None
    """The frame where it ended because another person was about as near, or None."""

    @property
    def completeness(self) -> float:
        """Sum over the frames of the mean confidence of the keypoints."""
        return float(self.confidence.mean(1).sum())

    @property
    def movement(self) -> float:
        """How far the keypoints' places are spread over the film, in body sizes.

        Half the distance between the percentiles 16 and 84, as of a standard deviation; the
        median over the keypoints.
        """
        seen = self.confidence > 0
        often = seen.sum(0) > 1
        if not often.any():
            return 0.0
        places = np.where(seen[..., None], self.pixels, np.nan)[:, often]
        low, high = np.nanpercentile(places, (16, 84), axis=0)
        sizes = [body_size(p, c) for p, c in zip(self.pixels, self.confidence, strict=True)]
        return float(np.median(np.linalg.norm(high - low, axis=-1)) / 2 / np.median(sizes))

    def __str__(self) -> str:
        place = self.pixels[self.confidence > 0].mean(0)
        ended = "" if self.ended_by is None else f", lost at frame {self.ended_by} near another"
        return (
            f"person {self.number}: {len(self.frame)} frames from {self.frame[0]} to "
            f"{self.frame[-1]}, around pixel ({place[0]:.0f}, {place[1]:.0f}){ended}"
        )


def follow(detections: Detections) -> tuple[Track, ...]:
    """Everybody in a view, by order of first appearance.

    Numbers that the producer gave to people are kept when they behave like identities; a file
    that merely counts the people of each frame is found out by their jumps. Otherwise each
    frame's people are linked to the tracks so that the sum of the distances between their
    centres, over the keypoints both show and in body sizes, is least. Where another link would
    be about as good, all tracks it concerns end there and new ones begin: a track that is short
    can be seen and said, two people mixed in one cannot. Of a body found in two pieces the better
    one is kept.
    """
    rows = np.flatnonzero((detections.confidence > 0).sum(1) >= FEWEST_KEYPOINTS)
    labels, ended = detections.identity[rows], {}
    if (labels < 0).any() or not _consistent(detections, rows, labels):
        rows = _distinct(detections, rows)
        labels, ended = _linked(detections, rows)
    order = dict.fromkeys(labels[labels >= 0].tolist())
    return tuple(
        Track(
            number=number,
            frame=detections.frame[rows[labels == label]],
            pixels=detections.pixels[rows[labels == label]],
            confidence=detections.confidence[rows[labels == label]],
            ended_by=ended.get(label),
        )
        for number, label in enumerate(order)
    )


def choose(tracks: tuple[Track, ...], person: int | None, name: str) -> Track:
    """The track of the person asked for, or the most complete one.

    Of two that are about equally complete it is the one that moves, where the other stands by.

    Raises:
        ValueError: when there is no such person, nobody, or two tracks are about equally complete
            and both move or both stand; the message lists who there is.
    """
    listed = "; ".join(map(str, tracks))
    if len(tracks) == 0:
        raise ObservationError(f"{name}: nobody shows {FEWEST_KEYPOINTS} keypoints in any frame")
    if person is not None:
        if not 0 <= person < len(tracks):
            raise ObservationError(f"{name}: there is no person {person}; there are {listed}")
        return tracks[person]
    best = max(tracks, key=lambda track: track.completeness)
    alike = [one for one in tracks if one.completeness >= _EQUAL * best.completeness]
    alike.sort(key=lambda track: -track.movement)
    if len(alike) > 1 and not _stands_beside(alike[1], alike[0]):
        numbers = sorted(one.number for one in alike[:2])
        raise ObservationError(
            f"{name}: persons {numbers[0]} and {numbers[1]} are seen about equally well; "
            f"choose one with --person. There are {listed}"
        )
    return alike[0]


def _stands_beside(other: Track, mover: Track) -> bool:
    """Whether somebody stands by while another one moves."""
    return other.movement < _STANDS and mover.movement > _MOVES * max(other.movement, _STANDS / 3)


def body_size(pixels: np.ndarray, confidence: np.ndarray) -> float:
    """Diagonal of the box around the keypoints seen, pixels; at least one."""
    seen = pixels[confidence > 0]
    return max(float(np.linalg.norm(np.ptp(seen, axis=0))), 1.0) if len(seen) > 0 else 1.0


def _distinct(detections: Detections, rows: np.ndarray) -> np.ndarray:
    """The best of the detections that lie in the same place of a frame."""
    kept: list[int] = []
    for frame in np.unique(detections.frame[rows]):
        people = rows[detections.frame[rows] == frame].tolist()
        chosen: list[int] = []
        for row in sorted(people, key=lambda r: -float(detections.confidence[r].sum())):
            if not any(_coincide(detections, row, other) for other in chosen):
                chosen.append(row)
        kept += sorted(chosen)
    return np.array(kept, dtype=np.int64)


def _coincide(detections: Detections, a: int, b: int) -> bool:
    return _spread(detections, a, b) < _SAME_PLACE


def _spread(detections: Detections, a: int, b: int) -> float:
    """Mean distance of the keypoints both show, in body sizes; infinite when they are too few."""
    both = (detections.confidence[a] > 0) & (detections.confidence[b] > 0)
    if both.sum() < FEWEST_KEYPOINTS:
        return float("inf")
    gap = np.linalg.norm(detections.pixels[a, both] - detections.pixels[b, both], axis=-1).mean()
    return float(gap) / _size(detections, a, b)


def _size(detections: Detections, a: int, b: int) -> float:
    return max(body_size(detections.pixels[r], detections.confidence[r]) for r in (a, b))


def _distance(detections: Detections, a: int, b: int) -> float:
    """Distance of the centres of two detections, over the keypoints both show, in body sizes."""
    seen_a, seen_b = detections.confidence[a] > 0, detections.confidence[b] > 0
    both = seen_a & seen_b
    if both.sum() >= FEWEST_KEYPOINTS:
        seen_a = seen_b = both
    gap = detections.pixels[a, seen_a].mean(0) - detections.pixels[b, seen_b].mean(0)
    return float(np.linalg.norm(gap)) / _size(detections, a, b)


def _gate(gap: int) -> float:
    return min(_GATE + _GATE_GROWTH * (gap - 1), _GATE_LIMIT)


def _consistent(detections: Detections, rows: np.ndarray, identity: np.ndarray) -> bool:
    """Whether nobody of a number jumps, and no number stands twice in a frame."""
    for label in np.unique(identity):
        own = rows[identity == label]
        frames = detections.frame[own]
        if (np.diff(frames) == 0).any():
            return False
        for a, b in pairwise(own.tolist()):
            gap = int(detections.frame[b] - detections.frame[a])
            if gap <= _LOST_AFTER and _distance(detections, a, b) > _gate(gap):
                return False
    return True


def _linked(detections: Detections, rows: np.ndarray) -> tuple[np.ndarray, dict[int, int]]:
    """A label per row, and the frames where labels ended for being ambiguous."""
    labels = np.full(len(rows), -1)
    last: dict[int, int] = {}  # label of a living track -> its last row
    ended: dict[int, int] = {}
    fresh = 0
    frames = detections.frame[rows]
    for frame in np.unique(frames).tolist():
        places = _whole(detections, rows, np.flatnonzero(frames == frame), list(last.values()))
        last = {k: r for k, r in last.items() if frame - detections.frame[r] <= _LOST_AFTER}
        alive = list(last)
        cost = np.array(
            [[_distance(detections, last[label], int(rows[p])) for p in places] for label in alive]
        ).reshape(len(alive), len(places))
        gates = np.array([_gate(int(frame - detections.frame[last[label]])) for label in alive])
        allowed = cost <= gates[:, None]
        pairs = _assigned(cost, allowed)
        doubtful = _doubtful(cost, allowed, pairs)
        for track in doubtful:
            ended[alive[track]] = frame
            del last[alive[track]]
        taken = {p: alive[t] for t, p in pairs.items() if t not in doubtful}
        for p, place in enumerate(places):
            if p not in taken:
                taken[p] = fresh
                fresh += 1
            labels[place] = taken[p]
            last[taken[p]] = int(rows[place])
    return labels, ended


def _whole(
    detections: Detections, rows: np.ndarray, places: np.ndarray, last: list[int]
) -> np.ndarray:
    """Places without those that are a lesser piece of a body seen before."""
    strength = detections.confidence.sum(1)
    near = {
        place: {row for row in last if _spread(detections, row, int(rows[place])) < _PIECE}
        for place in places.tolist()
    }
    lesser: set[int] = set()
    for a in near:
        for b in near:
            apart = (detections.confidence[rows[[a, b]]] > 0).all(0).sum() < FEWEST_KEYPOINTS
            if near[a] & near[b] and apart and strength[rows[a]] < strength[rows[b]]:
                lesser.add(a)
    return np.array([place for place in places.tolist() if place not in lesser], dtype=np.int64)


def _assigned(cost: np.ndarray, allowed: np.ndarray) -> dict[int, int]:
    """Track to detection with the least sum of distances among the allowed links."""
    from scipy.optimize import linear_sum_assignment

    if cost.size == 0:
        return {}
    tracks, found = linear_sum_assignment(np.where(allowed, cost, 1e3))
    return {int(t): int(p) for t, p in zip(tracks, found, strict=True) if allowed[t, p]}


def _doubtful(cost: np.ndarray, allowed: np.ndarray, pairs: dict[int, int]) -> set[int]:
    """Tracks for which another set of links is about as good as the best."""
    out: set[int] = set()
    owner = {p: t for t, p in pairs.items()}
    for track, place in pairs.items():
        for other in np.flatnonzero(allowed[track]).tolist():
            if other == place:
                continue
            rival = owner.get(other)
            now, then = cost[track, place], cost[track, other]
            if rival is not None:
                now, then = now + cost[rival, other], then + cost[rival, place]
            if then - now < _NEARLY:
                out |= {track} if rival is None else {track, rival}
        for rival in np.flatnonzero(allowed[:, place]).tolist():
            unlinked = rival not in pairs
            if unlinked and cost[rival, place] - cost[track, place] < _NEARLY:
                out |= {track, rival}
    return out
