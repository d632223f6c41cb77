"""Finds person and camera of a network's motion estimate in the film that it was made from."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float

from observations.correspondences import BodyPoints
from observations.keypoints2d import Keypoints2D
from observations.keypoints3d import Keypoints3D
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.layouts import keypoint_names
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding
from recon.fitting.settings import ReadOptions
from recon.formats.observations import KeypointsFile
from recon.reading.images import keypoints_of, undistorted_keypoints
from recon.reading.places import body_size
from recon.reading.views import Views, read_views

_MOST, _FEWEST = 2000, 40
"""Keypoints of all frames from which a camera is found at most and at least."""
_NEAR, _FAR = 0.08, 0.1
"""Distance of a keypoint from the estimate's, as a share of the body's size in the image, up to
which it agrees, and median from which the estimate is of somebody else."""
_CLEARLY, _CUT_S = 0.75, 0.5
"""Factor by which keypoints are nearer when the film runs otherwise, from which on it does, and
seconds by which it may be cut otherwise. Backwards, or cut so, right films of 26 training and
validation people stay above 0.89, and of those that are wrong so 16 and 18 are below 0.75."""
_TRUNK = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def people_of_film(film: Path, how: ReadOptions) -> list[Views]:
    """Return the 2D keypoints of every person in a film, or in 2D detections of one."""
    seen = read_views([film], how)
    (view,) = seen.tracked_views()
    return [seen.views([track], [f"{view.name}: {track}"]) for track in view.tracks]


def view_of_estimate(
    people: Sequence[Views], estimate: Motion | Keypoints3D, body: BodyModel
) -> tuple[Keypoints2D, tuple[str, ...], tuple[Finding, ...]]:
    """Find the person in a film whom an estimate shows; return their keypoints and camera.

    Returns notes, too, and a warning if the keypoints fit the estimate clearly better when the
    film is reversed, or shifted in time.

    The camera does not move in the frame of the estimate, so one pose is fitted to the points of
    all frames. The vertical is left to the fit.

    Args:
        people: of the film.
        estimate: a motion without a leading axis, or keypoints of one clip.
        body: whose motion it is.

    Raises:
        ObservationError: when nobody moves like the estimate.
    """
    points = (
        _keypoints_of_motion(estimate, people[0].files[0].layout, body)
        if isinstance(estimate, Motion)
        else estimate
    )
    found = [_fitted_camera(one.files[0], points) for one in people]
    best = int(np.argmin([error for error, _ in found]))
    (error, T), views = found[best], people[best]
    (file,) = views.files
    doubts = _order_or_delay_warning(file, points)
    if error > _FAR:
        raise ObservationError(
            f"{views.names[0]}: nobody in the film moves like the estimate; give the film that "
            "the estimate was made from; its coordinates must be those of the camera, or of a "
            "world in which the camera stands still"
            + "".join(f" ({one.message})" for one in doubts)
        )
    camera = replace(file.camera, T_camera_world=T[None], focal_std=0.0, path=None)
    view = keypoints_of(replace(file, camera=camera), body)
    level = getattr(estimate, "level", False)
    said = f"{views.names[0]}: keypoints lie {error:.1%} of the body's size from the estimate's"
    view = view.derived(ground_known=False, level=level)
    return view, (*views.decisions, said), tuple(one.of_sensor(views.names[0]) for one in doubts)


def _keypoints_of_motion(motion: Motion, layout: str, body: BodyModel) -> Keypoints3D:
    """Return the 3D keypoints of a layout on the body of a motion."""
    points = BodyPoints.of_layout(layout, body)
    places = points.of(body.pose(motion)).detach()[None]
    seen = torch.ones(places.shape[:-1], dtype=torch.bool)
    return Keypoints3D(places, seen, points, motion.fps, motion.start_time)


def _order_or_delay_warning(file: KeypointsFile, estimate: Keypoints3D) -> tuple[Finding, ...]:
    """A warning if reversed or shifted frames of the film fit the estimate clearly better."""
    best, said = _CLEARLY, ""
    for how, both in _reversed_or_shifted(file):
        given, other = (_fitted_camera(one, estimate)[0] for one in both)
        if other < best * given < np.inf:
            best = other / given
            said = (
                f"keypoints lie {given:.1%} of the body's size from the estimate's, and only "
                f"{other:.1%} if the film {how}: give the film as the network saw it"
            )
    return (Finding("frame order", said, value=best),) if said else ()


def _reversed_or_shifted(
    file: KeypointsFile,
) -> Iterator[tuple[str, tuple[KeypointsFile, KeypointsFile]]]:
    """Yield reversals and shifts in time: words, and the keypoints before and after."""
    reverse = replace(file, pixels=file.pixels[::-1], confidence=file.confidence[::-1])
    yield "runs backwards", (file, reverse)
    cut, count = round(_CUT_S * file.fps), len(file.pixels)
    for how, part, shift in (
        ("later", slice(0, count - cut), _CUT_S), ("earlier", slice(cut, count), -_CUT_S)
    ):  # fmt: skip
        start = file.start_time + part.start / file.fps
        kept = replace(
            file, pixels=file.pixels[part], confidence=file.confidence[part], start_time=start
        )
        yield f"begins {_CUT_S:g} s {how}", (kept, replace(kept, start_time=start + shift))


def _fitted_camera(
    file: KeypointsFile, estimate: Keypoints3D
) -> tuple[float, Float[np.ndarray, "4 4"]]:
    """Fit T_camera_estimate to 2D keypoints; return their error in body sizes, and the pose."""
    names = keypoint_names(file.layout)
    own, places, there = estimate.points.names, estimate.positions[0], estimate.visible[0]
    named = [name for name in names if name in own and name.endswith(_TRUNK)]
    columns, others = [own.index(one) for one in named], [names.index(one) for one in named]
    times = np.arange(len(file.pixels)) / file.fps + file.start_time - estimate.start_time
    rows = np.round(times * estimate.fps).astype(int)
    kept = np.flatnonzero((rows >= 0) & (rows < len(places)))
    points = places.detach().double().numpy()[rows[kept]][:, columns]
    both = there.numpy()[rows[kept]][:, columns] & (file.confidence[kept][:, others] > 0)
    points, pixels = points[both], undistorted_keypoints(file)[kept][:, others][both]
    if len(points) < _FEWEST:
        return np.inf, np.eye(4)
    step = -(-len(points) // _MOST)
    matrix = file.camera.camera_matrix
    size = float(
        np.median(
            [
                body_size(*one)
                for one in zip(file.pixels, file.confidence, strict=True)
                if one[1].any()
            ]
        )
    )
    solved, turn, place, _ = cv2.solvePnPRansac(
        points[::step], pixels[::step], matrix, None, reprojectionError=_NEAR * size,
        flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    if not solved:
        return np.inf, np.eye(4)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], place.ravel()
    seen = cv2.projectPoints(points, turn, place, matrix, None)[0][:, 0]
    return float(np.median(np.linalg.norm(seen - pixels, axis=-1))) / size, T
