"""Reads films and other detections that state their frame rate and the size of their images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import ObservationError
from recon.detections.reader import read_keypoints
from recon.detections.records import Detections
from recon.fitting.settings import ReadOptions
from recon.formats.cameras import CameraArrays, CameraPath, straightened
from recon.formats.producers import is_film

_DRIFT = 1.0
"""Frames by which views of nearly one frame rate may drift apart."""
_SAME_FORM, _CUT = 0.002, 0.05
"""Difference of the ratios of width and height up to which images were scaled, and share of a side
that may have been cut off."""


def with_image_size(path: Path, how: ReadOptions) -> Detections | None:
    """Detections in a film or a file that states the size of its images; None for other files."""
    if is_film(path):
        from recon.films.reader import read_film  # its networks and decoders are needed here only

        return read_film(
            path, frame_rate=how.frame_rate, layout=how.layout, detector=how.detector,
            kept=None if how.detections is None else Path(how.detections),
        )  # fmt: skip
    found = read_keypoints(path, layout=how.layout) if path.suffix.lower() == ".npz" else None
    return None if found is None or found.image_size is None else found


def stated_rate(paths: Sequence[Path], known: Mapping[Path, Detections]) -> float | None:
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


def in_size_of(found: Detections, camera: CameraArrays) -> tuple[Detections, str]:
    """Detections in the pixels of a calibration, and a note where its images have another size.

    Images of the same form were scaled; others are taken as cut at their right and lower border.

    Raises:
        ValueError: when they are turned, or too different to be of this camera.
    """
    size, expected = found.image_size, camera.image_size
    if size is None or tuple(size) == tuple(expected):
        return found, ""
    ratio = np.array(expected) / size
    said = (
        f"{found.name}: images of {size[0]} x {size[1]} pixels, the calibration's have "
        f"{expected[0]} x {expected[1]}"
    )
    if np.ptp(ratio) < _SAME_FORM:
        scaled = (found.pixels + 0.5) * ratio - 0.5
        pixels = np.where((found.confidence > 0)[..., None], scaled, 0.0)
        return replace(found, pixels=pixels, image_size=expected), f"{said}: scaled"
    if np.abs(ratio - 1).max() > _CUT:
        raise ObservationError(f"{said}; give the calibration of this film")
    return found, f"{said}: taken as cut at the right and below"


_SHOTS_LISTED = 8


def in_one_shot(
    found: Detections, rate: float, between: tuple[float, float] | None
) -> tuple[Detections, tuple[int, int] | None, str]:
    """The people of the shot of a film in which they are seen longest.

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
        ),
        (starts[best], ends[best]),
        note,
    )


def levelled(found: Detections, camera: CameraArrays) -> tuple[CameraArrays, str]:
    """A still camera with the vertical, and the focal length, of straight lines in its film.

    Unchanged, and without a note, where its pose is known or lines do not tell the vertical.
    """
    if camera.T_camera_world is not None or camera.path is not None or found.lines is None:
        return camera, ""
    from recon.films.vertical import find_vertical  # films only

    matrix = camera.camera_matrix
    ends = straightened(found.lines, camera) - matrix[:2, 2]
    assert found.lines_frame is not None
    images = [ends[found.lines_frame == one] for one in np.unique(found.lines_frame)]
    focal = float(matrix[[0, 1], [0, 1]].mean())
    told = find_vertical(images, max(camera.image_size), focal, known=camera.focal_known)
    if told is None:
        return camera, ""
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = level_turn(told.up)
    down, roll = (
        np.degrees(np.arcsin(-told.up[2])), np.degrees(np.arctan2(told.up[0], -told.up[1]))
    )  # fmt: skip
    said = (
        f"{found.name}: straight lines tell that the camera looks {down:.0f} degrees down and is "
        f"rolled by {roll:.0f}"
    )
    if told.focal is not None:
        matrix = matrix * np.array([[told.focal / focal], [told.focal / focal], [1.0]])
        matrix[:2, 2] = camera.camera_matrix[:2, 2]
        said += f", and a focal length of {told.focal:.0f} pixels, which is taken instead"
    path = CameraPath(T_world_camera[None], metric=True, level=True)
    known = camera.focal_known or told.focal is not None
    return replace(camera, camera_matrix=matrix, focal_known=known, path=path), said


def level_turn(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation from a camera's frame to a level world, z up, in which the camera looks along y.

    Args:
        up: unit vector in the camera's frame, not along its viewing axis.
    """
    ahead = np.array([0.0, 0.0, 1.0]) - up * up[2]
    ahead /= np.linalg.norm(ahead)
    return np.stack((np.cross(ahead, up), ahead, up))
