"""Follows the regions of people from frame to frame, and looks for new people."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from recon.films.blazepose import MIRRORED, BlazePose, Image, Pose, Region

_SEARCH_S = 0.5
"""Seconds between two searches for people who are not followed yet."""
_LEAST_SCORE = 0.5
"""Score of a region from which on it holds a person."""
_SAME_PLACE = 0.25
"""Distance of the hips of two regions below which they are of one person, sides of the smaller."""
_SAME_BODY = 0.1
"""Distance of two bodies below which they are of one person, sides of the smaller region."""
_TRUNK_LEGS = [11, 12, *range(23, 29)]
"""Landmarks by which bodies are compared: shoulders, hips, knees, ankles; hands may meet."""
_CUTOFF_HZ, _SPEED_CUTOFF, _RATE_CUTOFF_HZ = 0.01, 10.0, 1.0
"""Filter of the regions' movement: cut-off frequency at rest (Hz), its increase per side of the
region per second, and the cut-off frequency of the speed."""
_TILE_STEP = 0.6
"""Largest distance of neighbouring tiles' centres, in sides of a tile."""


@dataclass(frozen=True)
class Sight:
    """One person detected in one frame: landmarks from the image and from its mirror image."""

    frame: int
    track: int
    """Number of the person's track, which ends when they are lost."""
    pose: Pose
    mirrored: Pose
    """The pose found in the mirror image, mirrored back."""


@dataclass(frozen=True)
class TrackerState:
    """The state of a `Tracker` after a frame, from which another one can continue."""

    frame: int
    shot: int
    next_id: int
    """Number of the next track."""
    next_search: int
    """Frame of the next search for new people."""
    tracks: Float[np.ndarray, "tracks 79"]
    """Number, region (centre, side, angle), filtered points, their speed and the landmarks of the
    last frame of every track."""


@dataclass
class _Track:
    number: int
    region: Region
    points: Float[np.ndarray, "2 2"] | None = None
    """Filtered mid hips and top of the circle about the body; None before the first frame."""
    speed: Float[np.ndarray, "2 2"] = field(default_factory=lambda: np.zeros((2, 2)))
    """Filtered speed of these points, in sides of the region per second."""
    body: Float[np.ndarray, "33 2"] | None = None
    """Landmarks of the last frame; None before the first."""

    def distance_from_last(self, pose: Pose) -> float:
        """Return the distance of a pose from the last frame's, in sides of the region."""
        if self.body is None:
            return 0.0
        return _distance_of_bodies(pose.pixels, self.body) / self.region.side

    def follow(self, sight: Sight, rate: float) -> None:
        """Move the region after the person by a one-euro filter (Casiez et al. 2012)."""
        self.body = sight.pose.pixels
        points = (sight.pose.next_points + sight.mirrored.next_points) / 2
        if self.points is None:
            self.points = points
        speed = (points - self.points) / self.region.side * rate
        self.speed = self.speed + _filter_weight(_RATE_CUTOFF_HZ, rate) * (speed - self.speed)
        share = _filter_weight(_CUTOFF_HZ + _SPEED_CUTOFF * np.abs(self.speed), rate)
        self.points = self.points + share * (points - self.points)
        self.region = Region.of_points(*self.points)


def _filter_weight(cutoff: float | np.ndarray, rate: float) -> float | np.ndarray:
    """Return the weight of a new value in an exponential filter with a cut-off frequency (Hz)."""
    return 1 / (1 + rate / (2 * np.pi * cutoff))


class Tracker:
    """Detects all people in a film and follows them from frame to frame."""

    def __init__(self, networks: BlazePose, rate: float) -> None:
        self._networks = networks
        self._rate = rate
        self._tracks: list[_Track] = []
        self._next_id = 0
        self._next_search = 0
        self._shot = 0
        self._frame = -1

    def state(self) -> TrackerState:
        """Return the state from which a later tracker can continue."""
        rows = [
            (
                one.number, *one.region.centre, one.region.side, one.region.angle,
                *one.points.ravel(), *one.speed.ravel(), *one.body.ravel(),
            )
            for one in self._tracks
            if one.points is not None and one.body is not None
        ]  # fmt: skip
        return TrackerState(
            self._frame, self._shot, self._next_id, self._next_search, np.reshape(rows, (-1, 79))
        )

    def continue_from(self, state: TrackerState) -> None:
        """Restore the state of an earlier tracker of the same film."""
        self._frame, self._shot, self._next_id = state.frame, state.shot, state.next_id
        self._next_search = state.next_search
        self._tracks = [
            _Track(
                int(row[0]), Region(row[1:3], float(row[3]), float(row[4])),
                row[5:9].reshape(2, 2), row[9:13].reshape(2, 2), row[13:].reshape(33, 2),
            )
            for row in state.tracks
        ]  # fmt: skip

    def detect_next(self, image: Image, frame: int, shot: int) -> list[Sight]:
        """Detect all people in the next frame; return a `Sight` for each."""
        self._frame = frame
        if shot != self._shot:
            self._tracks, self._shot, self._next_search = [], shot, frame
        if not self._tracks or frame >= self._next_search:
            self._add_new_people(image, tiles=frame >= self._next_search)
            if frame >= self._next_search:
                self._next_search = frame + max(round(_SEARCH_S * self._rate), 1)
        before = len(self._tracks)
        kept = self._without_duplicates(list(self._tracks_still_seen(image, frame)))
        for one, sight in kept:
            one.follow(sight, self._rate)
        self._tracks = sorted((one for one, _ in kept), key=lambda one: one.number)
        if len(self._tracks) < before:
            self._next_search = min(self._next_search, frame + 1)
        return [sight for _, sight in kept]

    def _add_new_people(self, image: Image, *, tiles: bool) -> None:
        found = self._networks.find(image)
        if tiles:
            found += [one for tile in _tiles(image) for one in self._networks.find(image, tile)]
        for region, _ in sorted(found, key=lambda one: -one[1]):
            if all(not _are_same_place(region, one.region) for one in self._tracks):
                self._tracks.append(_Track(self._next_id, region))
                self._next_id += 1

    def _tracks_still_seen(self, image: Image, frame: int) -> Iterator[tuple[_Track, Sight]]:
        """Yield tracks whose person is still in the region, each with the new detection.

        Where the landmarks of the image and of its mirror image are of different bodies, of two
        people who overlap, the body that moved less since the last frame is taken.
        """
        for one in self._tracks:
            both = self._networks.poses(image, one.region)
            sure = [pose for pose in both if pose.score >= _LEAST_SCORE]
            if not sure:
                continue
            steady = min(sure, key=one.distance_from_last)
            pose, mirrored = (it if _are_same_body(it, steady) else steady for it in both)
            yield one, Sight(frame, one.number, pose, mirrored)

    def _without_duplicates(self, seen: list[tuple[_Track, Sight]]) -> list[tuple[_Track, Sight]]:
        """Return tracks without duplicates: of several on one body, the one that moved least."""
        seen.sort(key=lambda it: (it[0].body is None, it[0].distance_from_last(it[1].pose)))
        kept: list[tuple[_Track, Sight]] = []
        for track, sight in seen:
            if all(not _are_same_body(sight.pose, other.pose) for _, other in kept):
                kept.append((track, sight))
        return kept


def _are_same_place(one: Region, other: Region) -> bool:
    away = np.linalg.norm(one.centre - other.centre)
    return bool(away < _SAME_PLACE * min(one.side, other.side))


def _are_same_body(one: Pose, other: Pose) -> bool:
    return _distance_of_bodies(one.pixels, other.pixels) < _SAME_BODY * min(
        one.region.side, other.region.side
    )


def _distance_of_bodies(one: Float[np.ndarray, "33 2"], other: Float[np.ndarray, "33 2"]) -> float:
    """Return the median distance (pixels) of trunk and legs, after exchanging sides if nearer."""
    away = (np.linalg.norm((one - it)[_TRUNK_LEGS], axis=1) for it in (other, other[MIRRORED]))
    return min(float(np.median(distances)) for distances in away)


def _tiles(image: Image) -> Iterator[Region]:
    """Yield overlapping squares that together cover an image."""
    height, width = image.shape[:2]
    side, long = min(width, height), max(width, height)
    count = max(1, int(np.ceil(long / (_TILE_STEP * side))))
    for at in np.linspace(side / 2, long - side / 2, count):
        middle = (side / 2, at) if height >= width else (at, side / 2)
        yield Region(np.array(middle) - 0.5, float(side), 0.0)
