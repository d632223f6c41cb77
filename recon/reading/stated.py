"""Reads films and other detections that state their frame rate and the size of their images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import ObservationError
from recon.detections.reader import read_keypoints
from recon.detections.records import Background, Detections
from recon.fitting.settings import ReadOptions
from recon.formats.cameras import CameraArrays, CameraPath, scale_of_images, undistorted_pixels
from recon.formats.producers import is_film
from recon.formats.scan_times import common_step, fits_memory

if TYPE_CHECKING:
    from recon.films.turning import CameraMotion

_DRIFT = 1.0
"""Frames by which views of nearly one frame rate may drift apart."""
_SPARSE = 100
"""Frame numbers may span this many times the number of frames, else they are no frame numbers."""


def read_sized_detections(path: Path, how: ReadOptions) -> Detections | None:
    """Detections in a film or a file that states the size of its images; None for other files."""
    if is_film(path):
        from recon.films.reader import read_film  # imported only for films: loads networks

        return read_film(
            path, frame_rate=how.frame_rate, layout=how.layout, detector=how.detector,
            fingers=how.fingers, kept=None if how.detections is None else Path(how.detections),
        )  # fmt: skip
    found = read_keypoints(path, layout=how.layout) if path.suffix.lower() == ".npz" else None
    return None if found is None or found.image_size is None else found


def rate_of_views(paths: Sequence[Path], known: Mapping[Path, Detections]) -> float | None:
    """The frame rate that all views state; None where one states none.

    Raises:
        ValueError: when they state different ones.
    """
    rates = {path: known[path].frame_rate if path in known else None for path in paths}
    stated = [rate for rate in rates.values() if rate is not None]
    if len(stated) < len(rates):
        return None
    frames = max(int(one.frame_numbers[-1]) + 1 for one in known.values())
    if (max(stated) / min(stated) - 1) * frames > _DRIFT:
        said = ", ".join(f"{path.name} {rate:.6g}" for path, rate in rates.items())
        raise ObservationError(
            f"expected views of one frame rate, got frames per second of {said}; convert "
            "the films to one rate"
        )
    return float(np.mean(stated))


def camera_of_images(camera: CameraArrays, found: Detections) -> tuple[CameraArrays, str]:
    """The camera of a calibration in the pixels of the detections, and a note if these differ.

    Raises:
        ValueError: when the images are turned, or of too different a form to be of this camera.
    """
    size, stated = found.image_size, camera.image_size
    if size is None or tuple(size) == tuple(stated):
        return camera, ""
    scale = scale_of_images(stated, size)
    said = (
        f"{found.name}: images of {size[0]} x {size[1]} pixels, the calibration's have "
        f"{stated[0]} x {stated[1]}"
    )
    if scale is None:
        raise ObservationError(f"{said}; give the calibration of this film")
    matrix = camera.camera_matrix.copy()
    matrix[:2] *= scale[:, None]
    matrix[:2, 2] += (scale - 1) / 2  # (0, 0) is the first pixel's centre
    note = "filled up or cut at the right and below" if (scale == 1).all() else "scaled"
    return replace(camera, camera_matrix=matrix, image_size=size), f"{said}: {note}"


def frame_range(found: Sequence[Detections]) -> tuple[int, int]:
    """First frame number and number of frames of all views together.

    Raises:
        ValueError: when the views count frames differently, or numbers are no frame numbers.
    """
    spans = [(int(one.frame_numbers[0]), int(one.frame_numbers[-1])) for one in found]
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    most = max(len(one.frame_numbers) for one in found)
    described = "; ".join(
        f"{one.name} from {a} to {b}" for one, (a, b) in zip(found, spans, strict=True)
    )
    span = last - first + 1
    if span > _SPARSE * most or not fits_memory(span, most):
        raise ObservationError(
            f"expected frame numbers without wide gaps, got {described}, of which {most} have a "
            "file; cut the recording at its gap, or number its frames one by one"
        )
    common = min(b for _, b in spans) - max(a for a, _ in spans) + 1
    shortest = min(b - a + 1 for a, b in spans)
    shifted = len(set(spans)) > 1 and len({b - a for a, b in spans}) == 1
    if common < shortest / 2 or shifted:
        raise ObservationError(
            f"the views count their frames differently: {described}; number the frames of all "
            "views from the same moment"
        )
    return first, last - first + 1


def note_of_steps(found: Sequence[Detections]) -> tuple[str, ...]:
    """Return a note if all frame numbers step by 2 or more: frames between them are unseen."""
    numbers = np.unique(np.concatenate([one.frame_numbers for one in found]))
    step = common_step(numbers)
    said = (
        f"frame numbers step by {step}: frames between them are unseen, and the frame rate is "
        "that of all frames. If it is that of the files, number these one by one"
    )
    return (said,) if step > 1 else ()


_SHOTS_LISTED = 8


def cut_to_longest_shot(
    found: Detections, rate: float, between: tuple[float, float] | None
) -> tuple[Detections, tuple[int, int] | None, str]:
    """Keep the detections in that shot of a film in which people are seen longest.

    Args:
        found: of one film.
        rate: frames per second.
        between: seconds of the film to choose from; None for all.

    Returns:
        The detections, the first and last frame of the shot (None where the film has no cuts),
        and a note.
    """
    if not found.shots:
        return found, None, ""
    starts = [int(found.frame_numbers[0]), *found.shots]
    ends = [*(start - 1 for start in found.shots), int(found.frame_numbers[-1])]
    shot = np.searchsorted(found.shots, found.frame, side="right")
    counted = np.ones(len(shot), bool)
    if between is not None:
        seconds = found.frame / rate
        counted = (seconds >= between[0]) & (seconds <= between[1])
    seen = np.bincount(shot, weights=found.confidence.mean(1) * counted, minlength=len(starts))
    best = int(seen.argmax())
    mine = shot == best
    behind = found.background
    if behind is not None:
        own = (behind.frame >= starts[best]) & (behind.frame <= ends[best])
        point = np.unique(behind.point[own], return_inverse=True)[1]
        behind = Background(behind.frame[own], point, behind.pixels[own]) if own.any() else None
    others = [f"{a / rate:.2f}-{b / rate:.2f}" for a, b in zip(starts, ends, strict=True)]
    del others[best]
    more = "" if len(others) <= _SHOTS_LISTED else f" and {len(others) - _SHOTS_LISTED} more"
    note = (
        f"{found.name}: the film has {len(starts)} shots, and only the one from "
        f"{starts[best] / rate:.2f} to {ends[best] / rate:.2f} s, in which people are seen "
        f"longest, is taken; --between takes another: {', '.join(others[:_SHOTS_LISTED])}{more} s"
    )
    return (
        replace(
            found,
            frame=found.frame[mine],
            pixels=found.pixels[mine],
            confidence=found.confidence[mine],
            identity=found.identity[mine],
            hands=None if found.hands is None else found.hands[mine],
            background=behind,
        ),
        (starts[best], ends[best]),
        note,
    )


def background_camera(
    found: Detections, camera: CameraArrays, frames: Int[np.ndarray, " frames"], rate: float
) -> tuple[CameraArrays, str]:
    """A camera with the path, up direction and focal length that the film's background shows.

    Straight lines tell the vertical, and points of the background how the camera moves. Unchanged,
    and without a note, where its pose is known or the background tells nothing.

    Args:
        found: of the film.
        camera: which filmed it.
        frames: numbers of the frames that are read.
        rate: frames per second.
    """
    if camera.T_camera_world is not None or camera.path is not None:
        return camera, ""
    camera, moved, said = _with_focal_from_motion(found, camera, rate)
    if found.lines is None and moved is None:
        return camera, said
    from recon.films.vertical import find_vertical  # films only

    matrix = camera.camera_matrix
    focal = float(matrix[[0, 1], [0, 1]].mean())
    lines, shown = found.lines, found.lines_frame
    if lines is None or shown is None:
        lines, shown = np.zeros((0, 2, 2)), np.zeros(0, int)
    ends, numbers = undistorted_pixels(lines, camera) - matrix[:2, 2], np.unique(shown)
    images = [ends[shown == one] for one in numbers]
    T = np.eye(4)[None]
    if moved is not None:
        # rotate the lines of all pictures into the view of the middle picture
        middle = np.linalg.inv(moved.poses_at(moved.frames[[len(moved.frames) // 2]])[0])
        T = middle @ moved.poses_at(frames)
        images = [
            _turned_segments(one, focal, (middle @ pose)[:3, :3])
            for one, pose in zip(images, moved.poses_at(numbers), strict=True)
        ]
    metric = moved is None or not moved.places.any()
    told = find_vertical(images, max(camera.image_size), focal, camera.focal_std)
    if told is None:
        path = None if moved is None else CameraPath(T, metric=metric, level=False)
        return camera if path is None else replace(camera, path=path), said
    down, roll = (
        np.degrees(np.arcsin(-told.up[2])), np.degrees(np.arctan2(told.up[0], -told.up[1]))
    )  # fmt: skip
    level = (
        f"{found.name}: straight lines tell that the camera looks {down:.0f} degrees down and is "
        f"rolled by {roll:.0f}"
    )
    if told.focal is not None:
        camera = _with_focal(camera, told.focal)
        level += f", and a focal length of {told.focal:.0f} pixels, which is taken instead"
    upright = np.eye(4)
    upright[:3, :3] = rotation_to_level(told.up)
    path = CameraPath(upright @ T, metric=metric, level=True)
    return replace(camera, path=path), "; ".join(one for one in (said, level) if one)


def _with_focal(camera: CameraArrays, focal: float) -> CameraArrays:
    """The camera with a known focal length, pixels; its principal point stays."""
    matrix = camera.camera_matrix.copy()
    matrix[:2, :2] *= focal / matrix[[0, 1], [0, 1]].mean()
    return replace(camera, camera_matrix=matrix, focal_std=0.0)


def _with_focal_from_motion(
    found: Detections, camera: CameraArrays, rate: float
) -> tuple[CameraArrays, "CameraMotion | None", str]:
    """The camera with a focal length found from its motion, that motion, and a note on both."""
    background = found.background
    if background is None or len(background.frame) == 0:
        return camera, None, ""
    from recon.films.carrying import find_path  # films only
    from recon.films.turning import find_turning

    matrix = camera.camera_matrix
    focal = float(matrix[[0, 1], [0, 1]].mean())
    pixels = undistorted_pixels(background.pixels, camera) - matrix[:2, 2]
    seen = background.frame, background.point, pixels, focal
    moved = find_turning(*seen, focal_known=camera.focal_known)
    if moved is None:
        moved = find_path(*seen, focal_known=camera.focal_known, rate=rate)
    if isinstance(moved, str):
        note = (
            f"{found.name}: its background moves, so the camera was carried or held in the hand; "
            f"{moved}, so the path of the camera cannot be found, and it is taken as standing "
            "still: give its track (--camera-track), or places and steps are not to be trusted"
        )
        return camera, None, note
    how = "turns" if not moved.places.any() else "is carried, and turns"
    note = (
        f"{found.name}: its background tells that the camera {how} by up to "
        f"{np.degrees(moved.angle):.0f} degrees"
    )
    if not moved.focal_told:
        # the camera's path was found with `moved.focal`, so that is the better guess
        guess = replace(_with_focal(camera, moved.focal), focal_std=camera.focal_std)
        return guess, moved, note
    note += f", and a focal length of {moved.focal:.0f} pixels, which is taken instead"
    return _with_focal(camera, moved.focal), moved, note


_MIN_COSINE_TO_AXIS = 0.3
"""Least cosine between what is seen and the axis of the camera in whose image it is drawn."""


def _turned_segments(
    ends: Float[np.ndarray, "lines 2 2"], focal: float, R: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "lines 2 2"]:
    """Segments in pixels from the principal point, after a rotation of the camera.

    Args:
        ends: of the segments.
        focal: pixels.
        R: from the frame of the camera that saw them to that of the other.
    """
    rays = np.concatenate((ends / focal, np.ones((*ends.shape[:2], 1))), -1) @ R.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = rays[(rays[..., 2] > _MIN_COSINE_TO_AXIS).all(1)]
    return focal * rays[..., :2] / rays[..., 2:]


def rotation_to_level(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation from a camera's frame to a level world, z up, in which the camera looks along y.

    Args:
        up: unit vector in the camera's frame, not along its viewing axis.
    """
    ahead = np.array([0.0, 0.0, 1.0]) - up * up[2]
    ahead /= np.linalg.norm(ahead)
    return np.stack((np.cross(ahead, up), ahead, up))
