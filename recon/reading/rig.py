"""Poses and focal lengths of cameras from a person whom all of them see.

Keypoints of the same name at the same moment are images of one point. Two views give an essential
matrix (Hartley and Zisserman, chapter 9), further ones are added by the points known so far, and
then all cameras and points are refined together (bundle adjustment, Triggs et al. 1999). The unit
of length is that of the first two cameras' distance.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from recon.core.errors import ObservationError
from recon.reading.tracks import nearest_to_rays

_SEEN = 0.3
"""Confidence from which on a keypoint takes part."""
_MOST_POINTS = 600
"""Points in space that are refined; more hardly change the poses."""
_FEWEST_POINTS = 60
"""Points that two views must share: three moments of a whole body."""
_OFF = 0.008
"""Distance of a keypoint from its epipolar line, as a share of the focal length, up to which two
views agree."""
_FIRST_OFF = 4 * _OFF
"""Reprojection error, as a share of the focal length, up to which a keypoint of a further view
agrees; focal lengths, not refined by then, may be a quarter off."""
_AGREEING = 0.5
"""Share of the points of two views that must agree."""
_SAMPLED = 200
"""Points of two views that are looked at for each shift in time."""
_COARSE = 12
"""Shifts in time to either side that are tried; the best one is refined with the poses."""
_BETTER = 0.97
"""A shift in time is believed where it makes the disagreement smaller by this factor."""
_ROUNDS = 200
"""Samples of five points that propose an essential matrix."""
_DETECTOR = 0.004
"""Standard deviation of a keypoint, as a share of the focal length."""
_FOCAL_STD = 0.002
"""Standard deviation of the logarithm of a known focal length."""
_UP_STD = np.radians(1.5)
"""Standard deviation of the vertical that lines of an image tell."""
_LATE_STD = 4.0
"""Standard deviation of the true shift in time about the one that was tried, frames."""
_UNKNOWNS = 8
"""Of a camera: a turn, a translation, the logarithm of its focal length's correction, and the
frames by which it is late."""


@dataclass(frozen=True)
class FilmedPerson:
    """The keypoints of a person in one view, whose camera has no distortion."""

    name: str
    pixels: Float[np.ndarray, "frames points 2"]
    confidence: Float[np.ndarray, "frames points"]
    focal: float
    """Pixels."""
    focal_std: float
    """Standard deviation of its logarithm."""
    centre: Float[np.ndarray, "2"]
    """The principal point."""
    up: Float[np.ndarray, "3"] | None = None
    """The vertical in the camera's frame, where it is known."""

    def shifted(self, frames: int) -> "FilmedPerson":
        """The view as if it had begun `frames` frames later."""
        pixels, confidence = np.zeros_like(self.pixels), np.zeros_like(self.confidence)
        here = slice(max(frames, 0), len(pixels) + min(frames, 0))
        there = slice(max(-frames, 0), len(pixels) + min(-frames, 0))
        pixels[there], confidence[there] = self.pixels[here], self.confidence[here]
        return replace(self, pixels=pixels, confidence=confidence)


@dataclass(frozen=True)
class Rig:
    """Cameras in a world of unknown unit; its axes and origin are the first camera's."""

    T_camera_world: Float[np.ndarray, "views 4 4"]
    focal: Float[np.ndarray, " views"]
    """Pixels."""
    late: Float[np.ndarray, " views"]
    """Frames by which each view begins after the first one."""
    points: Float[np.ndarray, "frames points 3"]
    """NaN where fewer than two views saw a point."""
    error: float
    """Median reprojection error of a keypoint, as a share of the focal length."""


def rig_of_person(views: Sequence[FilmedPerson], longest_shift: int) -> Rig:
    """Find the cameras that saw one person: poses, focal lengths and delays.

    Args:
        views: at least two, of the same frames and the same names of points.
        longest_shift: frames by which one view may have begun after another.

    Raises:
        ObservationError: when two views share too few points or disagree.
    """
    late = _frame_shifts(views, min(longest_shift, len(views[0].pixels) - 1))
    views = [view.shifted(frames) for view, frames in zip(views, late, strict=True)]
    frames, points = views[0].confidence.shape
    seen = np.stack([view.confidence.reshape(-1) > _SEEN for view in views])
    places = np.stack([_normalised_coordinates(view).reshape(-1, 2) for view in views])
    speeds = np.stack([_image_velocities(view).reshape(-1, 2) for view in views])
    used = np.flatnonzero(seen.sum(0) >= 2)
    if len(used) > _MOST_POINTS:
        used = used[np.linspace(0, len(used) - 1, _MOST_POINTS).astype(int)]
    poses = _first_poses([view.name for view in views], places, seen)
    poses, scale, later = _bundle_adjusted(
        views, poses, places[:, used], speeds[:, used], seen[:, used]
    )
    places = (places + later[:, None, None] * speeds) / scale[:, None, None]
    nearest = _triangulated(poses, places, seen)
    off = np.linalg.norm(_projected_points(poses, nearest) - places, axis=-1)
    error = float(np.median(off[seen & (seen.sum(0) >= 2)]))
    if error > _OFF:
        raise ObservationError(
            f"the views disagree: keypoints lie {error:.1%} of the focal length from where all "
            f"views together place them, expected at most {_OFF:.1%}; do they show one person, "
            "filmed at the same time by cameras that stand still?"
        )
    shifts = np.array(late) + later - later[0]
    if np.abs(shifts).max() > longest_shift + 1:
        raise ObservationError(
            f"the views agree best where films begin {np.abs(shifts).max():.0f} frames apart, "
            f"expected at most {longest_shift}; do they show one person at the same time?"
        )
    T = np.tile(np.eye(4), (len(views), 1, 1))
    T[:, :3] = poses
    return Rig(
        T_camera_world=T,
        focal=scale * [view.focal for view in views],
        late=shifts,
        points=nearest.reshape(frames, points, 3),
        error=error,
    )


def _normalised_coordinates(view: FilmedPerson) -> Float[np.ndarray, "frames points 2"]:
    """Normalised image coordinates of the keypoints: x/z and y/z in the camera's frame."""
    return (view.pixels - view.centre) / view.focal


def _image_velocities(view: FilmedPerson) -> Float[np.ndarray, "frames points 2"]:
    """Change of image coordinates per frame; zero where a neighbouring frame lacks the point."""
    seen = view.confidence > _SEEN
    three = seen & np.roll(seen, 1, 0) & np.roll(seen, -1, 0)
    three[[0, -1]] = False
    places = _normalised_coordinates(view)
    return np.where(three[..., None], (np.roll(places, -1, 0) - np.roll(places, 1, 0)) / 2.0, 0.0)


def _frame_shifts(views: Sequence[FilmedPerson], longest: int) -> tuple[int, ...]:
    """How many frames after the first each view begins, so that their points agree best."""
    coarse = max(1, longest // _COARSE)
    found = [0]
    for view in views[1:]:
        off = cache(lambda frames, view=view: _epipolar_misfit(views[0], view.shifted(frames)))
        best = min(range(-longest // coarse * coarse, longest + 1, coarse), key=off)
        found.append(best if off(best) < _BETTER * off(0) else 0)
    return tuple(found)


def _epipolar_misfit(one: FilmedPerson, other: FilmedPerson) -> float:
    """Mean Sampson distance of shared points from their epipolar lines.

    In standard deviations of a detector, each at most two; infinite where the views share too few.
    """
    seen = (one.confidence > _SEEN) & (other.confidence > _SEEN)
    if seen.sum() < _FEWEST_POINTS:
        return np.inf
    some = np.flatnonzero(seen)
    some = some[np.linspace(0, len(some) - 1, min(len(some), _SAMPLED)).astype(int)]
    a, b = (_normalised_coordinates(view).reshape(-1, 2)[some] for view in (one, other))
    matrix, _ = _essential_matrix(a, b, _DETECTOR)
    a, b = (np.concatenate((x, np.ones((len(x), 1))), -1) for x in (a, b))
    there, here = a @ matrix.T, b @ matrix
    steepness = np.linalg.norm(np.concatenate((there[:, :2], here[:, :2]), -1), axis=-1)
    off = np.abs((b * there).sum(-1)) / np.maximum(steepness, 1e-12)
    return float(np.minimum(off / _DETECTOR, 2.0).mean())


def _essential_matrix(
    a: Float[np.ndarray, "points 2"], b: Float[np.ndarray, "points 2"], off: float = _OFF
) -> tuple[Float[np.ndarray, "3 3"], Bool[np.ndarray, " points"]]:
    """The essential matrix of two views, and which points agree with it."""
    cv2.setRNGSeed(0)  # RANSAC draws random samples: the same input must give the same result
    found, inliers = cv2.findEssentialMat(a, b, np.eye(3), cv2.RANSAC, 0.999, off, _ROUNDS)
    if found is None or found.shape != (3, 3):
        return np.eye(3), np.zeros(len(a), dtype=bool)
    return found, inliers[:, 0] > 0


def _first_poses(
    names: Sequence[str],
    places: Float[np.ndarray, "views points 2"],
    seen: Bool[np.ndarray, "views points"],
) -> Float[np.ndarray, "views 3 4"]:
    """Poses (world to camera) of all views, built up from the pair that agrees best."""
    found: dict[tuple[int, int], tuple[int, np.ndarray]] = {}
    for a, b in combinations(range(len(names)), 2):
        both = seen[a] & seen[b]
        if both.sum() < _FEWEST_POINTS:
            continue
        matrix, agree = _essential_matrix(places[a, both], places[b, both])
        if agree.mean() >= _AGREEING:
            found[a, b] = (
                int(agree.sum()),
                _second_camera_pose(matrix, places[[a, b]][:, both], agree),
            )
    if not found:
        raise ObservationError(
            f"the poses of the cameras of {', '.join(names)} cannot be found from the person: "
            f"expected two views that share {_FEWEST_POINTS} keypoints, at least {_AGREEING:.0%} "
            "of which agree; let the person walk about where all cameras see it, filmed at the "
            "same time"
        )
    (a, b), (_, pose) = max(found.items(), key=lambda item: item[1][0])
    poses = {a: np.eye(3, 4), b: pose}
    while len(poses) < len(names):
        known = sorted(poses)
        shared = seen & (seen[known].sum(0) >= 2)
        rest = [v for v in range(len(names)) if v not in poses]
        best = max(rest, key=lambda v: shared[v].sum())
        here = shared[best]
        points = _triangulated(
            np.stack([poses[v] for v in known]), places[known][:, here], seen[known][:, here]
        )
        poses[best] = _pose_from_points(names[best], points, places[best, here])
    return np.stack([poses[v] for v in range(len(names))])


def _second_camera_pose(
    matrix: Float[np.ndarray, "3 3"],
    places: Float[np.ndarray, "2 points 2"],
    agree: Bool[np.ndarray, " points"],
) -> Float[np.ndarray, "3 4"]:
    """The pose of the second camera for which the points lie in front of both cameras."""
    _, turn, step, _ = cv2.recoverPose(
        matrix, places[0], places[1], np.eye(3), mask=agree.astype(np.uint8)[:, None]
    )
    return np.concatenate((turn, step), 1)


def _pose_from_points(
    name: str, points: Float[np.ndarray, "points 3"], places: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "3 4"]:
    """The pose of a camera that sees known points.

    Raises:
        ObservationError: when it cannot be found.
    """
    share = 0.0
    if len(points) >= _FEWEST_POINTS:
        cv2.setRNGSeed(0)  # RANSAC draws random samples: the same input must give the same result
        ok, turn, step, inliers = cv2.solvePnPRansac(
            points, places, np.eye(3), None, reprojectionError=_FIRST_OFF
        )
        share = len(inliers) / len(points) if ok else 0.0
        if share >= _AGREEING:
            return np.concatenate((cv2.Rodrigues(turn)[0], step), 1)
    raise ObservationError(
        f"{name}: the pose of its camera cannot be found from the person: it shares {len(points)} "
        f"keypoints with two other views, {share:.0%} of which agree; expected {_FEWEST_POINTS} "
        f"and {_AGREEING:.0%}; leave it out, or film the person where all cameras see it"
    )


def _triangulated(
    poses: Float[np.ndarray, "views 3 4"],
    places: Float[np.ndarray, "views points 2"],
    seen: Bool[np.ndarray, "views points"],
) -> Float[np.ndarray, "points 3"]:
    """Triangulate points from their images; NaN where fewer than two views see one."""
    points = nearest_to_rays(places, poses[:, None], seen)
    return np.where((seen.sum(0) >= 2)[:, None], points, np.nan)


def _projected_points(
    poses: Float[np.ndarray, "views 3 4"], points: Float[np.ndarray, "points 3"]
) -> Float[np.ndarray, "views points 2"]:
    there = points @ poses[:, :, :3].swapaxes(-1, -2) + poses[:, None, :, 3]
    return there[..., :2] / np.maximum(there[..., 2:], 1e-3)


def _bundle_adjusted(
    views: Sequence[FilmedPerson],
    poses: Float[np.ndarray, "views 3 4"],
    places: Float[np.ndarray, "views points 2"],
    speeds: Float[np.ndarray, "views points 2"],
    seen: Bool[np.ndarray, "views points"],
) -> tuple[
    Float[np.ndarray, "views 3 4"], Float[np.ndarray, " views"], Float[np.ndarray, " views"]
]:
    """Poses, focal length factors and delays (frames) of the views, by bundle adjustment."""
    view, point = np.nonzero(seen)
    ups = [one.up for one in views]
    with_up = [v for v, up in enumerate(ups) if up is not None]
    stds = np.array([max(one.focal_std, _FOCAL_STD) for one in views])

    def cameras_and_points(values: np.ndarray) -> tuple[np.ndarray, ...]:
        cameras = values[: _UNKNOWNS * len(views)].reshape(-1, _UNKNOWNS)
        turns = Rotation.from_rotvec(cameras[:, :3]).as_matrix()
        found = np.concatenate((turns, cameras[:, 3:6, None]), -1)
        points = values[_UNKNOWNS * len(views) :].reshape(-1, 3)
        return found, cameras[:, 6], cameras[:, 7], points

    def residuals(values: np.ndarray) -> np.ndarray:
        found, logs, late, points = cameras_and_points(values)
        there = np.einsum("oij,oj->oi", found[view, :, :3], points[point]) + found[view, :, 3]
        image = there[:, :2] / np.maximum(there[:, 2:], 1e-3) * np.exp(logs[view])[:, None]
        measured = places[view, point] + late[view, None] * speeds[view, point]
        off = [((image - measured) / _DETECTOR).ravel(), logs / stds, (late - late[0]) / _LATE_STD]
        if len(with_up) > 1:
            world = np.stack([found[v, :, :3].T @ ups[v] for v in with_up])
            off.append(((world - world.mean(0)) / _UP_STD).ravel())
        return np.concatenate(off)

    turns = Rotation.from_matrix(poses[:, :, :3]).as_rotvec()
    cameras = np.concatenate((turns, poses[:, :, 3], np.zeros((len(views), 2))), 1)
    start = np.concatenate((cameras.ravel(), _triangulated(poses, places, seen).ravel()))
    filled = _jacobian_sparsity(view, point, len(views), len(residuals(start)), len(start))
    # a robust loss, since detectors make a few large errors
    found = least_squares(
        residuals, start, jac_sparsity=filled, loss="soft_l1", x_scale="jac", max_nfev=100
    )
    best, logs, late, _ = cameras_and_points(found.x)
    return best, np.exp(logs), late


def _jacobian_sparsity(
    view: np.ndarray, point: np.ndarray, views: int, residuals: int, unknowns: int
) -> csr_array:
    """Sparsity of the Jacobian: which residual depends on which unknown.

    Images depend on their camera and their point, the other residuals on all cameras.
    """
    own = np.concatenate(
        (
            _UNKNOWNS * view[:, None] + np.arange(_UNKNOWNS),
            _UNKNOWNS * views + 3 * point[:, None] + np.arange(3),
        ),
        1,
    ).repeat(2, 0)
    rest = np.tile(np.arange(_UNKNOWNS * views), (residuals - len(own), 1))
    rows = np.concatenate(
        (
            np.arange(len(own)).repeat(own.shape[1]),
            np.arange(len(own), residuals).repeat(rest.shape[1]),
        )
    )
    columns = np.concatenate((own.ravel(), rest.ravel()))
    return csr_array((np.ones(len(columns)), (rows, columns)), shape=(residuals, unknowns))
