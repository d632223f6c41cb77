"""Tracks of people in one view, and the choice of one of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.core.errors import ObservationError
from recon.core.layouts import keypoint_names
from recon.detections.records import Detections
from recon.formats.cameras import CameraArrays
from recon.reading.linking import LOST_AFTER, largest_allowed_distance, link_detections
from recon.reading.places import FEWEST_KEYPOINTS, body_size, centre_distance

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
    hands: Float[np.ndarray, "seen 42 3"] | None = None
    """Pixels and confidence of the points of hands, where the file has any."""
    ended_by: int | None = None
    """The frame where it ended because another person was about as near, or None."""

    @property
    def completeness(self) -> float:
        """Sum over the frames of the mean confidence of the keypoints."""
        return float(self.confidence.mean(1).sum())

    @property
    def movement(self) -> float:
        """How far the keypoints move about the image over time, in body sizes.

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

    def flipped_in_y(self, height: int) -> "Track":
        """The track with the y axis of pixels reversed, in an image of this height."""
        hands = self.hands
        if hands is not None:
            hands = np.where(hands[..., 2:] > 0, hands * (1, -1, 1) + (0, height, 0), 0.0)
        return replace(self, pixels=self.pixels * (1, -1) + (0, height), hands=hands)

    def __str__(self) -> str:
        place = self.pixels[self.confidence > 0].mean(0)
        ended = "" if self.ended_by is None else f", lost at frame {self.ended_by} near another"
        return (
            f"person {self.number}: {len(self.frame)} frames from {self.frame[0]} to "
            f"{self.frame[-1]}, around pixel ({place[0]:.0f}, {place[1]:.0f}){ended}"
        )


def tracks_of_people(detections: Detections) -> tuple[Track, ...]:
    """Everybody in a view, by order of first appearance.

    Numbers that the producer gave to people are kept when they behave like identities; a file
    that merely counts the people of each frame is found out by their jumps. Otherwise people are
    expected where a constant velocity carries them, and of all ways to link the detections the
    likeliest is taken, also where people pass each other. Where another way is about as likely,
    all tracks it concerns end there and new ones begin: a track that is short can be seen and
    said, two people mixed in one cannot. Of a body found in two pieces the better one is kept.
    Nobody is followed across the cuts of a film.
    """
    shot = np.searchsorted(detections.shots, detections.frame, side="right")
    found = [
        track
        for number in range(len(detections.shots) + 1)
        for track in _tracks_of_shot(detections, shot == number)
    ]
    return tuple(replace(track, number=number) for number, track in enumerate(found))


def _tracks_of_shot(detections: Detections, within: Bool[np.ndarray, " rows"]) -> list[Track]:
    """Tracks of the people in one shot of a film."""
    seen = (detections.confidence > 0).sum(1) >= FEWEST_KEYPOINTS
    rows = np.flatnonzero(seen & within)
    labels, ended = detections.identity[rows], {}
    if (labels < 0).any() or not _are_numbers_consistent(detections, rows, labels):
        found = link_detections(detections, rows)
        labels, ended = found.labels, found.ended
    order = dict.fromkeys(labels[labels >= 0].tolist())
    return [
        Track(
            number=number,
            frame=detections.frame[rows[labels == label]],
            pixels=detections.pixels[rows[labels == label]],
            confidence=detections.confidence[rows[labels == label]],
            hands=None if detections.hands is None else detections.hands[rows[labels == label]],
            ended_by=ended.get(label),
        )
        for number, label in enumerate(order)
    ]


def chosen_track(tracks: tuple[Track, ...], person: int | None, name: str) -> Track:
    """The track of the person asked for, or the most complete one.

    Of two that are about equally complete it is the one that moves, where the other stands by.

    Raises:
        ValueError: when there is no such person, nobody, or two tracks are about equally complete
            and both move or both stand; the message lists who there is.
    """
    if len(tracks) == 0:
        raise ObservationError(f"{name}: nobody shows {FEWEST_KEYPOINTS} keypoints in any frame")
    listed = "; ".join(map(str, tracks))
    if person is not None:
        if not 0 <= person < len(tracks):
            raise ObservationError(f"{name}: there is no person {person}; there are {listed}")
        return tracks[person]
    best = max(tracks, key=lambda track: track.completeness)
    alike = [one for one in tracks if one.completeness >= _EQUAL * best.completeness]
    alike.sort(key=lambda track: -track.movement)
    if len(alike) > 1 and not _stands_while_another_moves(alike[1], alike[0]):
        numbers = sorted(one.number for one in alike[:2])
        raise ObservationError(
            f"{name}: persons {numbers[0]} and {numbers[1]} are seen about equally well; "
            f"choose one with --person. There are {listed}"
        )
    return alike[0]


def _stands_while_another_moves(other: Track, mover: Track) -> bool:
    """Whether a person stands still while another one moves."""
    return other.movement < _STANDS and mover.movement > _MOVES * max(other.movement, _STANDS / 3)


def _are_numbers_consistent(
    detections: Detections, rows: np.ndarray, identity: np.ndarray
) -> bool:
    """Whether person numbers are consistent: none jumps or occurs twice in a frame."""
    for label in np.unique(identity):
        own = rows[identity == label]
        frames = detections.frame[own]
        if (np.diff(frames) == 0).any():
            return False
        for a, b in pairwise(own.tolist()):
            gap = int(detections.frame[b] - detections.frame[a])
            if gap <= LOST_AFTER and centre_distance(detections, a, b) > largest_allowed_distance(
                gap - 1
            ):
                return False
    return True


CONFIDENT = 0.3
"""Least confidence of keypoints that are triangulated."""
_FRAMES = 25
"""Frames looked at for a pair of tracks."""
_FEWEST_POINTS = 20


@dataclass(frozen=True)
class TrackedView:
    """The tracks of all people whom one camera saw."""

    name: str
    layout: str
    camera: CameraArrays
    tracks: tuple[Track, ...]
    first_frame: int = 0
    """Frame number of the first pose of a moving camera."""


@dataclass(frozen=True)
class Triangulated:
    """Keypoints that tracks of several views have in common, triangulated."""

    points: Float[np.ndarray, "frames points 3"]
    """World frame, metres; zero where not seen."""
    seen: Bool[np.ndarray, "frames points"]
    """Which points all views saw; none where these are fewer than 20."""
    names: tuple[str, ...]
    misses: Float[np.ndarray, "views frames points"]
    """Distance of a point from its ray of each view, in body sizes; infinite behind a camera."""

    @property
    def error(self) -> float:
        """Median over points of the largest distance from a ray; infinite if too few are seen."""
        return float(np.median(self.misses.max(0)[self.seen])) if self.seen.any() else np.inf


def triangulated(members: Sequence[tuple[TrackedView, int]]) -> Triangulated:
    """Keypoints of one track of every view as the points nearest to their rays."""
    layouts = [keypoint_names(view.layout) for view, _ in members]
    names = tuple(name for name in layouts[0] if all(name in other for other in layouts))
    frames = members[0][0].tracks[members[0][1]].frame
    for view, number in members[1:]:
        frames = np.intersect1d(frames, view.tracks[number].frame)
    frames = frames[:: max(1, -(-len(frames) // _FRAMES))]
    sights = [_rays_of_track(view, number, frames, names) for view, number in members]
    seen = np.all([track_rays.seen for track_rays in sights], axis=0)
    if seen.sum() < _FEWEST_POINTS:
        nothing = np.zeros((*seen.shape, 3))
        return Triangulated(nothing, np.zeros_like(seen), names, nothing[None, ..., 0])
    rays, poses = (
        np.stack([one.rays for one in sights]), np.stack([one.pose[:, None, :3] for one in sights])
    )  # fmt: skip
    met = nearest_to_rays(rays, poses, np.broadcast_to(seen, rays.shape[:-1]))
    points = np.where(seen[..., None], met, 0.0)
    return Triangulated(
        points, seen, names, np.stack([_distance_from_rays(points, one) for one in sights])
    )


def nearest_to_rays(
    rays: Float[np.ndarray, "*rays 2"],
    poses: Float[np.ndarray, "*poses 3 4"],
    seen: Bool[np.ndarray, "*rays"],
) -> Float[np.ndarray, "*points 3"]:
    """The points in the world nearest to their rays; meaningless if fewer than two views see one.

    A ray (u, v) of a camera with the pose P = [R | t] gives two equations, u P3 - P1 and
    v P3 - P2; the point is the right singular vector of least singular value (Hartley and
    Zisserman, 12.2).

    Args:
        rays: x/z and y/z of points in the frames of cameras, axes (views, ...).
        poses: world to camera, axes (views, ...) of the same number.
        seen: which rays count.
    """
    equations = rays[..., None] * poses[..., 2:, :] - poses[..., :2, :]
    equations = np.moveaxis(np.where(seen[..., None, None], equations, 0.0), 0, -3)
    solution = np.linalg.svd(equations.reshape(*equations.shape[:-3], -1, 4))[2][..., -1, :]
    scale = solution[..., 3:]
    return solution[..., :3] / np.where(np.abs(scale) > 1e-9, scale, 1e-9)


@dataclass(frozen=True)
class _TrackRays:
    """Rays through the keypoints of a track in some frames."""

    rays: np.ndarray
    """(frames, keypoints, 2): x/z and y/z of undistorted pixels."""
    seen: np.ndarray
    scale: np.ndarray
    """(frames,) body sizes per unit of the rays."""
    pose: np.ndarray
    """(frames, 4, 4) world to camera; a fixed camera has one pose for all."""


def _rays_of_track(
    view: TrackedView, number: int, frames: np.ndarray, names: tuple[str, ...]
) -> _TrackRays:
    import cv2

    track, camera = view.tracks[number], view.camera
    at = np.searchsorted(track.frame, frames)
    pixels, confidence = track.pixels[at], track.confidence[at]
    known = keypoint_names(view.layout)
    columns = [known.index(name) for name in names]
    size = np.array([body_size(*pair) for pair in zip(pixels, confidence, strict=True)])
    pose = camera.T_camera_world
    if pose is None:
        raise ObservationError(
            f"{view.name}: expected a camera with its pose; give T_camera_world"
        )
    rays = pixels[:, columns].astype(np.float64)
    if rays.size > 0:
        flat = rays.reshape(-1, 1, 2)
        straight = cv2.undistortPoints(flat, camera.camera_matrix, camera.distortion)
        rays = np.asarray(straight).reshape(rays.shape)
    return _TrackRays(
        rays=rays,
        seen=(confidence[:, columns] >= CONFIDENT),
        scale=np.sqrt(np.linalg.det(camera.camera_matrix)) / size,
        pose=pose[np.minimum(frames - view.first_frame, len(pose) - 1)],
    )


def _distance_from_rays(points: np.ndarray, track_rays: _TrackRays) -> np.ndarray:
    """Distance of points from the rays in body sizes; infinite behind the camera."""
    local = (
        np.einsum("tij,tkj->tki", track_rays.pose[:, :3, :3], points)
        + track_rays.pose[:, None, :3, 3]
    )
    front = local[..., 2] > 1e-6
    projected = local[..., :2] / np.where(front, local[..., 2], 1.0)[..., None]
    miss = np.linalg.norm(projected - track_rays.rays, axis=-1) * track_rays.scale[:, None]
    return np.where(front, miss, np.inf)
