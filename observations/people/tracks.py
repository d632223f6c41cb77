"""Following people from frame to frame in one view, and choosing one: never a mixture."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from observations.people.linking import LOST_AFTER, farthest, linked
from observations.people.places import FEWEST_KEYPOINTS, body_size, distance
from recon.core.errors import ObservationError
from recon.formats.detections.records import Detections

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
    that merely counts the people of each frame is found out by their jumps. Otherwise people are
    expected where a constant velocity carries them, and of all ways to link the detections the
    likeliest is taken, also where people pass each other. Where another way is about as likely,
    all tracks it concerns end there and new ones begin: a track that is short can be seen and
    said, two people mixed in one cannot. Of a body found in two pieces the better one is kept.
    """
    rows = np.flatnonzero((detections.confidence > 0).sum(1) >= FEWEST_KEYPOINTS)
    labels, ended = detections.identity[rows], {}
    if (labels < 0).any() or not _consistent(detections, rows, labels):
        found = linked(detections, rows)
        labels, ended = found.labels, found.ended
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


def _consistent(detections: Detections, rows: np.ndarray, identity: np.ndarray) -> bool:
    """Whether nobody of a number jumps, and no number stands twice in a frame."""
    for label in np.unique(identity):
        own = rows[identity == label]
        frames = detections.frame[own]
        if (np.diff(frames) == 0).any():
            return False
        for a, b in pairwise(own.tolist()):
            gap = int(detections.frame[b] - detections.frame[a])
            if gap <= LOST_AFTER and distance(detections, a, b) > farthest(gap - 1):
                return False
    return True
