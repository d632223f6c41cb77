"""Finds the path of a carried camera, up to scale, from points of the background.

Structure from motion: two pictures between which points move otherwise than by a rotation are
placed by their essential matrix (Nistér 2004), the others one after the other by the points that
are known by then, and all are refined together (`recon.films.bundle`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.films.bundle import NOISE, SeenBackground
from recon.films.turning import CameraMotion, fitted_rotation

_EVERY, _MOST_KEYS, _FEWEST_KEYS = 3, 150, 5
"""Fewest pictures from one key picture to the next; most and fewest key pictures of a film."""
_FEWEST_SHARED = 20
"""Fewest points that two pictures must share to start a reconstruction."""
_PAIRS = 3
"""Pairs of pictures that start a reconstruction each; that which explains most is kept."""
_TRIED = 12
"""About how many key pictures are tried as the first of such a pair."""
_IN_FRONT = 0.7
"""Least share of a pair's points that fit its essential matrix, in front of both cameras."""
_FEWEST_POINTS = 6
"""Fewest known points in a picture to find its pose."""
_REFINED_EVERY = 4
"""Pictures whose poses are found before all poses and points are refined again."""
_WIDER = (30.0, 8.0, 2.0, 1.0)
"""Widths of the robust kernel, in multiples of the noise, in the rounds of finding a pose."""
_FOCAL_DEVIATION, _FOCAL_TOLD = 0.15, 0.04
"""Standard deviation of the log of a guessed focal length, and largest of a measured one."""
_FITS, _FEWEST_FIT = 3.0, 0.5
"""Largest error of an observation that fits, in multiples of the noise, and their least share."""
_MOST_DEVIATION = 0.05
"""Largest standard deviation of camera positions, over the path's extent: in rendered films of
validation people, errors are up to four times as large."""
_ACCELERATION = 0.5
"""Standard deviation of a carried camera's acceleration, distances of the background per s²."""


def find_path(
    frame: Int[np.ndarray, " rows"],
    point: Int[np.ndarray, " rows"],
    pixels: Float[np.ndarray, "rows 2"],
    focal: float,
    *,
    focal_known: bool,
    rate: float,
) -> CameraMotion | str:
    """Find the motion of a carried camera, its path up to scale; else say why it is unknown.

    Args:
        frame: number of the picture of each observation.
        point: number of the observed point.
        pixels: its position from the principal point, without the lens' distortion.
        focal: focal length in pixels; its guess where it is not known.
        focal_known: whether the focal length is known; if not, it is refined.
        rate: frames per second.
    """
    frames, picture = np.unique(frame, return_inverse=True)
    key_step = max(_EVERY, -(-len(frames) // _MOST_KEYS))
    keys = np.arange(0, len(frames), key_step)
    seen = _Observations(picture, point, pixels / focal)
    scenes = (
        list(_reconstructions(seen, keys, known=focal_known)) if len(keys) >= _FEWEST_KEYS else []
    )
    if not scenes:
        return "no two pictures share enough points at different distances"
    best, first = max(scenes, key=lambda one: _share_that_fits(one[0]))
    if _share_that_fits(best) < _FEWEST_FIT:
        return "points of the background do not agree on a path"
    place, zoom = _path_deviations(best, _pose_known_except(best, first), focal=not focal_known)
    if place > _MOST_DEVIATION:
        return "the camera moves too little for the distance of the background"
    whole = _all_pictures_placed(best, seen, keys, len(frames), rate)
    R, places = whole.R[whole.placed], whole.camera_positions()[whole.placed]
    return CameraMotion(
        frames=frames[whole.placed],
        R_first_camera=R[0] @ R.swapaxes(1, 2),
        places=(places - places[0]) @ R[0].T,
        focal=focal * whole.focal,
        focal_told=not focal_known and zoom < _FOCAL_TOLD,
    )


@dataclass(frozen=True)
class _Observations:
    """Observations of points in pictures, which are numbered from 0."""

    picture: Int[np.ndarray, " rows"]
    point: Int[np.ndarray, " rows"]
    places: Float[np.ndarray, "rows 2"]

    def unsolved_scene(self, pictures: int, points: int) -> SeenBackground:
        """Return a scene with these observations, in which no pose and no point is known."""
        return SeenBackground(
            self.picture, self.point, self.places, np.tile(np.eye(3), (pictures, 1, 1)),
            np.zeros((pictures, 3)), np.zeros((points, 4)), np.zeros(pictures, bool),
            np.zeros(points, bool),
        )  # fmt: skip

    def in_key_pictures(self, keys: Int[np.ndarray, " keys"]) -> "_Observations":
        """Return the observations in the key pictures, which are numbered from 0 anew."""
        number = np.full(self.picture.max() + 1, -1)
        number[keys] = np.arange(len(keys))
        kept = number[self.picture] >= 0
        return _Observations(number[self.picture[kept]], self.point[kept], self.places[kept])


def _reconstructions(
    seen: _Observations, keys: Int[np.ndarray, " keys"], *, known: bool
) -> Iterator[tuple[SeenBackground, int]]:
    """Reconstruct key pictures and points from each starting pair; also yield its first picture.

    The frame of this picture is the world's.
    """
    own, points = seen.in_key_pictures(keys), int(seen.point.max()) + 1
    table = np.full((len(keys), points, 2), np.nan)
    table[own.picture, own.point] = own.places
    for one, other, R, t in _starting_pairs(table):
        scene = own.unsolved_scene(len(keys), points)
        scene.R[other], scene.t[other] = R, t
        _find_poses_from_pair(scene, one, other)
        scene.refine(
            _pose_known_except(scene, one), focal_std=None if known else _FOCAL_DEVIATION, steps=30
        )
        yield scene, one


def _starting_pairs(
    table: Float[np.ndarray, "pictures points 2"],
) -> Iterator[tuple[int, int, Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]]:
    """Yield pairs of pictures to start from, with R and t from the first's frame to the second's.

    Pairs with many points come first, and with points that a mere rotation explains badly.

    Args:
        table: x/z and y/z of each point in each picture; NaN where it is not seen.
    """
    rays = np.concatenate((table, np.ones((*table.shape[:2], 1))), 2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    seen, step = np.isfinite(table[..., 0]), max(1, len(table) // _TRIED)
    found: list[tuple[float, int, int]] = []
    for i in range(0, len(table), step):
        for j in range(i + 1, len(table), max(1, step // 2)):
            both = seen[i] & seen[j]
            if both.sum() < _FEWEST_SHARED:
                break
            _, off, _ = fitted_rotation(rays[i, both], rays[j, both])
            found.append((float(np.median(off) * np.sqrt(both.sum())), i, j))
    taken: list[tuple[int, int]] = []
    for _, i, j in sorted(found, reverse=True):
        if len(taken) == _PAIRS:
            return
        if any(abs(i - a) + abs(j - b) < 2 * step for a, b in taken):
            continue
        both = seen[i] & seen[j]
        one, other = table[i, both], table[j, both]
        E, mask = cv2.findEssentialMat(one, other, np.eye(3), cv2.RANSAC, 0.999, 2 * NOISE)
        if E is None or E.shape != (3, 3):
            continue
        fit, R, t, _ = cv2.recoverPose(E, one, other, np.eye(3), mask=mask)
        if fit >= _IN_FRONT * both.sum():
            taken.append((i, j))
            yield i, j, R, t[:, 0]


def _find_poses_from_pair(scene: SeenBackground, first: int, second: int) -> None:
    """Find the poses of all pictures, given those of two: first between these, then outwards."""
    scene.placed[[first, second]] = True
    scene.triangulate()
    scene.refine(_pose_known_except(scene, first))
    left = np.flatnonzero(~scene.placed)
    outside = (left < first) | (left > second)
    far = np.minimum(np.abs(left - first), np.abs(left - second))
    for count, k in enumerate(left[np.lexsort((far, outside))], start=1):
        placed = np.flatnonzero(scene.placed)
        near = placed[np.abs(placed - k).argmin()]
        scene.R[k], scene.t[k] = scene.R[near], scene.t[near]
        if (scene.known[scene.point] & (scene.picture == k)).sum() < _FEWEST_POINTS:
            continue
        scene.placed[k] = True
        for wider in _WIDER:
            scene.refine(np.arange(len(scene.placed)) == k, points=False, wider=wider)
        scene.triangulate()
        if count % _REFINED_EVERY == 0:
            scene.refine(_pose_known_except(scene, first), steps=3)
            scene.drop_misfits()


def _pose_known_except(scene: SeenBackground, picture: int) -> Bool[np.ndarray, " pictures"]:
    """Return which pictures have known poses, except one, whose frame is the world's."""
    return scene.placed & (np.arange(len(scene.placed)) != picture)


def _share_that_fits(scene: SeenBackground) -> float:
    """Return the share of all observations whose reprojection errors are small."""
    rows = np.flatnonzero(scene.are_usable())
    return float((scene.errors(rows) < _FITS * NOISE).sum() / len(scene.picture))


def _path_deviations(
    scene: SeenBackground, moved: Bool[np.ndarray, " pictures"], *, focal: bool
) -> tuple[float, float]:
    """Return standard deviations of positions (as shares of the path's extent) and of log focal.

    The scale of the path, which no point determines, is taken as known.
    """
    H = scene.normal
    poses = H[:-1, :-1] if focal else H
    t = scene.t[moved]
    unit = np.zeros(len(H))
    unit[: len(poses)].reshape(-1, 6)[:, 3:] = t / np.linalg.norm(t)
    variance = np.linalg.pinv(H + np.trace(H) * np.outer(unit, unit), hermitian=True).diagonal()
    places = variance[: len(poses)].reshape(-1, 6)[:, 3:].sum(1)
    extent = (t**2).sum(1).mean()
    return float(np.sqrt(places.mean() / extent)), float(np.sqrt(variance[-1]))


def _all_pictures_placed(
    best: SeenBackground,
    seen: _Observations,
    keys: Int[np.ndarray, " keys"],
    pictures: int,
    rate: float,
) -> SeenBackground:
    """Find the poses of all pictures on a smooth path, by the points of the key pictures."""
    whole = seen.unsolved_scene(pictures, len(best.X))
    whole.X, whole.known, whole.focal = best.X, best.known, best.focal
    stand = np.flatnonzero(best.placed)
    near = stand[np.abs(np.arange(pictures)[:, None] - keys[stand]).argmin(1)]
    whole.R, whole.t = best.R[near], best.t[near]
    count = np.bincount(seen.picture[best.known[seen.point]], minlength=pictures)
    whole.placed = count >= _FEWEST_POINTS
    rows = np.flatnonzero(whole.are_usable())
    w = np.abs(whole.X[whole.point[rows], 3])
    far = float(np.median(whole.points_in_cameras(rows)[:, 2] / np.maximum(w, 1e-9)))
    for wider in _WIDER:
        whole.refine(whole.placed, points=False, wider=wider, steady=_ACCELERATION * far / rate**2)
    return whole
