"""Reads SAM 3D Body's results: 70 keypoints (MHR-70) and the position of each person.

A result is a dictionary for every person of an image. Saved are lists of them for every frame
(.pkl, .npy), an .npz for every frame, or frame and person, in a folder, and .npz of arrays.
Points are metres in the axes of the camera (x right, y down, z forward), relative to `pred_cam_t`.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import FRAMES, PEOPLE
from recon.formats.opening import DAMAGE, check_sizes
from recon.formats.pickles import read_pickle
from recon.formats.producers import SAM3D_POINTS
from recon.keypoints3d.layouts import MHR70
from recon.keypoints3d.records import Points3D, chosen_person, tracks_of_people

_POINTS, _PLACE, _PIXELS = SAM3D_POINTS, "pred_cam_t", "pred_keypoints_2d"
_FOCAL = "focal_length"
_SHAPES = {_POINTS: (70, 3), _PLACE: (3,), _PIXELS: (70, 2), _FOCAL: ()}
_HIPS = [MHR70.index("left_hip"), MHR70.index("right_hip")]
_BONES = np.array(
    [
        [MHR70.index(f"{side}_{end}") for end in bone]
        for side in ("left", "right")
        for bone in (
            ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"),
        )
    ]
)  # fmt: skip
_ADDED = 1.0
"""Depth of the hips in metres from which on `pred_cam_t` is in the points already."""
_RESIDUAL = 0.5
"""Pixels that keypoints may lie from the projection of the points in space."""
_DEPTH_COUNTS = 0.25
"""How much depths, which single images tell badly, count in following people."""
_WIDTHS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
"""Standard deviations in frames of Gaussians that smooth depths."""
_REACH = 24
"""Frames to either side that count in smoothing, three of the widest standard deviations."""
_LEAST = 8
"""Frames from which on depths are smoothed."""
_CHANGES = 0.01
"""Share by which focal lengths may differ."""

Person = Mapping[str, np.ndarray]


def read_sam3d_body(path: Path, person: int | None = None) -> Points3D:
    """Read the keypoints of one person, in the frame of a camera with one focal length.

    The focal length f and the middle c of the image follow from u = f x/z + c where 2D keypoints
    are there. Depths are brought to the median of f, each frame is scaled to the median length of
    bones, as nobody grows in a clip, and jitter of the whole body along the ray is smoothed.

    Args:
        path: of the file or folder.
        person: whom to take of several people, from 0 on; None takes who is seen longest.

    Raises:
        FileNotFoundError: when there is nothing there.
        ValueError: when it is damaged, mixed up, or nobody is found.
    """
    frames = [[_checked_person(one, path) for one in people] for people in _people_by_frame(path)]
    FRAMES.check(len(frames), path)
    PEOPLE.check(max(map(len, frames), default=0), path)
    far = [_depth_of_hips(one[_POINTS]) > _ADDED for people in frames for one in people]
    if not far:
        raise FormatError(f"{path}: expected people, but all {len(frames)} frames are empty")
    in_camera = 2 * sum(far) > len(far)
    placed = [[_in_camera_frame(one, path, in_camera) for one in people] for people in frames]
    middle = float(np.median([_depth_of_hips(one) for people in placed for one in people]))
    tracks = tracks_of_people(
        [[_matching_coordinates(one, middle) for one in people] for people in placed]
    )
    counts = [len(one) for one in tracks]
    chosen, several = chosen_person(counts, len(frames), person, path.name)
    seen = tracks[chosen]
    people = [frames[k][place] for k, place in seen.items()]
    points = np.stack([placed[k][place] for k, place in seen.items()])
    said = ["layout mhr70: SAM 3D Body's, in the frame of the camera", *several]
    if in_camera:
        said.append(f"{_PLACE} is in {_POINTS} already")
    found = [_focal_and_centre(one, at, path) for one, at in zip(people, points, strict=True)]
    if None not in found:
        points, decision = _at_common_focal_length(
            points, people, np.array(found, dtype=np.float64)
        )
        said.append(decision)
    points, held = _without_jitter(points, np.array(list(seen)))
    said += held
    positions = np.full((len(frames), *_SHAPES[_POINTS]), np.nan)
    positions[list(seen)] = points
    return Points3D(path.name, positions, MHR70, unit="m", decisions=tuple(said))


def _depth_of_hips(points: np.ndarray) -> float:
    return float(points[_HIPS, 2].mean())


def _matching_coordinates(points: np.ndarray, middle: float) -> np.ndarray:
    """Return points projected to depth `middle`, and their scaled depths, for matching people."""
    rays = points[:, :2] / points[:, 2:]
    return np.concatenate((rays * middle, points[:, 2:] * _DEPTH_COUNTS), -1)


def _checked_person(person: object, path: Path) -> Person:
    """Return the arrays that recon needs of a person's record, after a check of their shapes."""
    if not isinstance(person, dict) or _POINTS not in person:
        raise FormatError(f"{path}: expected people with {_POINTS}, got {person!r:.80}")
    out = {}
    for key, shape in _SHAPES.items():
        if person.get(key) is None:
            continue
        value = np.asarray(person[key])
        if key == _FOCAL and value.size == 1:
            value = value.reshape(())
        numeric = value.dtype.kind in "fiu"
        if value.shape != shape or not numeric or not np.isfinite(value).all():
            raise FormatError(
                f"{path}: expected {key} of finite numbers of shape {shape}, got {value.dtype} "
                f"{value.shape}"
            )
        out[key] = value.astype(np.float64)
    return out


def _in_camera_frame(person: Person, path: Path, in_camera: bool) -> np.ndarray:
    """Return a person's keypoints in the frame of the camera, metres."""
    if not in_camera and _PLACE not in person:
        raise FormatError(f"{path}: expected the person's place, {_PLACE}, beside {_POINTS}")
    points = person[_POINTS] if in_camera else person[_POINTS] + person[_PLACE]
    if not (points[:, 2] > 0).all():
        raise FormatError(f"{path}: expected people in front of the camera, got a depth below 0 m")
    return points


def _focal_and_centre(
    person: Person, points: np.ndarray, path: Path
) -> tuple[float, float, float] | None:
    """Return focal length and centre of the image, pixels; the centre is NaN if unknown."""
    stated = person.get(_FOCAL)
    if _PIXELS not in person:
        return None if stated is None else (float(stated), np.nan, np.nan)
    rays = points[:, :2] / points[:, 2:]
    ones, nothing = np.ones(len(rays)), np.zeros(len(rays))
    design = np.concatenate(
        [np.stack((rays[:, 0], ones, nothing), 1), np.stack((rays[:, 1], nothing, ones), 1)]
    )
    pixels = person[_PIXELS].T.reshape(-1)
    solution = np.linalg.lstsq(design, pixels, rcond=None)[0]
    residual = float(np.sqrt(np.mean((design @ solution - pixels) ** 2)))
    if residual > _RESIDUAL:
        raise FormatError(
            f"{path}: {_PIXELS} lie {residual:.1f} px from the projection of {_POINTS} with "
            f"{_PLACE}, expected at most {_RESIDUAL} px; they are of different people or images"
        )
    f, x, y = solution.tolist()
    if stated is not None and abs(f / float(stated) - 1) > _CHANGES:
        raise FormatError(
            f"{path}: {_FOCAL} is {float(stated):.0f} px, but the keypoints were projected with "
            f"{f:.0f} px; save both from one result"
        )
    return f, x, y


def _at_common_focal_length(
    points: np.ndarray, people: Sequence[Person], found: np.ndarray
) -> tuple[np.ndarray, str]:
    """Points moved to the depths that the median focal length implies, and a note."""
    f, x, y = np.median(found, axis=0)
    depth = [one[_PLACE][2] if _PLACE in one else _depth_of_hips(one[_POINTS]) for one in people]
    moved = points.copy()
    moved[..., 2] += (np.array(depth) * (f / found[:, 0] - 1))[:, None]
    said = f"focal length {f:.0f} px"
    if np.isfinite(x):
        said += f", middle of the image ({x:.0f}, {y:.0f}): by the keypoints in the image"
    if np.abs(found[:, 0] / f - 1).max() > _CHANGES:
        low, high = found[:, 0].min(), found[:, 0].max()
        said += f"; it changed between {low:.0f} and {high:.0f} px, depths are of the median"
    return moved, said


def _without_jitter(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Points scaled to one body size, without jitter of the body in depth, and notes.

    An image determines only the ratio of size and distance, so a body that is estimated too large
    is too far away as well. A scale about the camera corrects both; if it makes the depths less
    smooth, the body is scaled about the hips. Jitter is the deviation from a local line in time.
    """
    sizes = np.linalg.norm(points[:, _BONES[:, 0]] - points[:, _BONES[:, 1]], axis=-1).sum(-1)
    scale = np.median(sizes) / sizes
    hips = points[:, _HIPS].mean(1)
    about = [hips, hips * scale[:, None]]
    hips_now = min(about, key=lambda one: _noise_of_depths(np.log(one[:, 2])))
    body = (points - hips[:, None]) * scale[:, None, None]
    every = np.arange(seen[0], seen[-1] + 1)
    depth = np.interp(every, seen, np.log(hips_now[:, 2]))
    smooth = _smoothed_over_time(depth) if len(depth) >= _LEAST else depth
    said = [
        "the person's size is held over the clip; it varied by "
        f"{np.std(sizes) / np.mean(sizes):.1%}",
        f"jitter along the ray of {np.std(smooth - depth):.1%} of the depth was smoothed",
    ]
    return body + (hips_now * np.exp(smooth - depth)[seen - seen[0], None])[:, None], said


def _smoothed_over_time(values: np.ndarray) -> np.ndarray:
    """Values smoothed over time by local linear regression with Gaussian weights.

    The width is the largest whose error in predicting frames from the others is within one
    standard error of the least error. At the ends, lines are extrapolated.
    """
    from scipy.ndimage import convolve1d

    frame = np.arange(len(values)) - len(values) / 2
    rows = np.stack((frame**0, frame, frame**2, values, values * frame))

    def regression_line(weights: np.ndarray) -> np.ndarray:
        one, x, xx, y, xy = convolve1d(rows, weights, mode="constant")
        return ((y * xx - x * xy) + (one * xy - x * y) * frame) / (one * xx - x * x)

    away = np.arange(-_REACH, _REACH + 1)
    gaussians = [np.exp(-((away / width) ** 2) / 2) for width in _WIDTHS]
    errors = np.square([regression_line(one * (away != 0)) - values for one in gaussians])
    more = errors - errors[errors.mean(1).argmin()]
    alike = more.mean(1) <= more.std(1) / np.sqrt(len(values))
    return regression_line(gaussians[np.flatnonzero(alike)[-1]])


def _noise_of_depths(values: np.ndarray) -> float:
    """Standard deviation of white noise on smooth values, from third differences."""
    steps = np.diff(values, 3)
    return float(np.sqrt(np.mean(steps**2) / 20)) if len(steps) else 0.0


def _people_by_frame(path: Path) -> list[list[Any]]:
    """Read the records of all people in every frame."""
    if path.is_dir():
        return list(_people_in_folder(path))
    if path.suffix.lower() == ".npz":
        return _people_of_arrays(_read_arrays(path), path)
    with path.open("rb") as file:
        content = read_pickle(file, path)
    if isinstance(content, np.ndarray):
        content = content.tolist()
    if isinstance(content, dict) and _POINTS not in content:
        content = [
            content[key] for key in sorted(content, key=lambda one: _numbers_in_name(str(one)))
        ]
    frames = content if isinstance(content, list) else [content]
    return [list(_people_in_frame(one)) for one in frames]


def _people_in_frame(frame: object) -> Sequence[Any]:
    if frame is None:
        return ()
    if isinstance(frame, np.ndarray):
        frame = frame.tolist()
    return frame if isinstance(frame, list | tuple) else (frame,)


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read the arrays that recon uses; others, such as pickled masks, are not opened."""
    try:
        check_sizes(path, only=tuple(_SHAPES))
        with np.load(path, allow_pickle=False) as file:
            return {key: file[key] for key in _SHAPES if key in file.files}
    except DAMAGE as error:
        raise FormatError(f"{path}: cannot be read ({error!s:.200})") from error


def _people_of_arrays(arrays: Mapping[str, np.ndarray], path: Path) -> list[list[Any]]:
    """Split arrays with leading axes (), (frames) or (frames, people) into a list per frame.

    Somebody whose points are NaN or zero was not found.
    """
    lead = arrays[_POINTS].shape[:-2]
    if len(lead) > 2:
        raise FormatError(
            f"{path}: expected {_POINTS} with leading axes (frames, people), got the shape "
            f"{arrays[_POINTS].shape}"
        )
    frames, people = (*lead, 1, 1)[:2]
    FRAMES.check(frames, path)
    PEOPLE.check(people, path)
    rows = {}
    for key, value in arrays.items():
        each = value.ndim - len(_SHAPES[key])
        if each not in (0, len(lead)) or value.shape[:each] != lead[:each]:
            raise FormatError(
                f"{path}: expected {key} with the leading axes {lead} of {_POINTS}, got the shape "
                f"{value.shape}"
            )
        rows[key] = np.broadcast_to(value, (*lead, *value.shape[each:])).reshape(
            frames, people, *value.shape[each:]
        )
    shown = np.isfinite(rows[_POINTS]).all((-2, -1)) & (rows[_POINTS] != 0).any((-2, -1))
    return [
        [{key: value[t, p] for key, value in rows.items()} for p in np.flatnonzero(shown[t])]
        for t in range(frames)
    ]


def _people_in_folder(folder: Path) -> Iterator[list[Any]]:
    """Read a file per person and frame, numbered by name: frame first, then person."""
    files = sorted(folder.glob("*.npz"), key=lambda one: _numbers_in_name(one.stem))
    numbers = [_numbers_in_name(one.stem) for one in files]
    if len({len(one) for one in numbers}) > 1 or not numbers[0]:
        numbers = [(k,) for k in range(len(files))]
    changing = [k for k, column in enumerate(zip(*numbers, strict=True)) if len(set(column)) > 1]
    frame = (changing or [0])[-2:][0]
    first, last = numbers[0][frame], numbers[-1][frame]
    FRAMES.check(last - first + 1, folder)
    at: dict[int, list[Any]] = {}
    for file, number in zip(files, numbers, strict=True):
        for people in _people_of_arrays(_read_arrays(file), file):
            at.setdefault(number[frame], []).extend(people)
    for k in range(first, last + 1):
        yield at.get(k, [])


def _numbers_in_name(text: str) -> tuple[int, ...]:
    return tuple(int(one) for one in re.findall(r"\d{1,15}", text))
