"""3D keypoints as JSON: MediaPipe's world landmarks, Azure Kinect bodies, lists with names."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import FRAMES
from recon.formats.json_files import as_floats, listed_frames, read_json
from recon.formats.keypoints3d.records import Points3D, followed, rate_of, taken

_WORLD = ("pose_world_landmarks", "world_landmarks", "poseWorldLandmarks", "worldLandmarks")
_IMAGE = ("pose_landmarks", "poseLandmarks", "landmarks")
_NAMES = ("joint_names", "keypoint_names", "names", "labels", "keypoints_names")
_FRAMES = ("frames", "data", "positions", "keypoints3d", "keypoints_3d", "joints3d")
_LANDMARKS = 33
_SEEN = 0.5
"""Visibility below which MediaPipe's landmarks count as not seen."""
_MICROSECONDS = 1e-6


def is_points_3d(value: Any) -> bool:
    """Whether what a JSON file holds is 3D keypoints of a kind that is known here."""
    return _is_world(value) or _is_azure(value) or _is_named(value)


def read_json_points(path: Path, value: Any = None, person: int | None = None) -> Points3D:
    """3D keypoints of one person.

    Args:
        path: of the file, for messages, and to read it where `value` is None.
        value: what the file holds, where it was read already.
        person: whom to take where there are several, from 0 on; None takes who is seen longest.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or of another kind.
    """
    value = read_json(path) if value is None else value
    if _is_world(value):
        return _world(_entries(value), path.name, person)
    if _is_azure(value):
        return _azure(value, path.name, person)
    if _is_named(value):
        return _named(value, path.name)
    raise FormatError(
        f"{path}: expected MediaPipe's pose_world_landmarks, Azure Kinect's joint_names and "
        "frames with bodies, or names and frames of x, y, z"
    )


def _entries(value: Any) -> list[Any]:
    if isinstance(value, dict):
        value = next((value[key] for key in _FRAMES if key in value), [value])
    return value if isinstance(value, list) else []


def _is_world(value: Any) -> bool:
    entries = _entries(value)
    return any(isinstance(one, dict) and any(key in one for key in _WORLD) for one in entries)


def _is_azure(value: Any) -> bool:
    if not isinstance(value, dict) or not isinstance(value.get("frames"), list):
        return False
    frames = value["frames"]
    return any(isinstance(one, dict) and isinstance(one.get("bodies"), list) for one in frames)


def _is_named(value: Any) -> bool:
    if not isinstance(value, dict) or _names(value) is None:
        return False
    entries = _entries(value)
    return len(entries) > 0 and isinstance(entries[0], list)


def _names(value: dict[str, Any]) -> tuple[str, ...] | None:
    for key in _NAMES:
        found = value.get(key)
        if isinstance(found, list) and found and all(isinstance(one, str) for one in found):
            return tuple(found)
    return None


def _world(entries: list[Any], name: str, person: int | None) -> Points3D:
    """Metres about the middle of the hips; x right, y down, z away, as the camera sees."""
    frames = listed_frames(entries, name)
    first, last = frames[0][0], frames[-1][0]
    FRAMES.check(last - first + 1, name)
    seen = [
        (number, _landmarks(entry, _WORLD, f"{name}, frame {number}")) for number, entry in frames
    ]
    found = [people for _, people in seen]
    shown = [_landmarks(entry, _IMAGE, f"{name}, frame {number}") for number, entry in frames]
    beside = all(len(a) == len(b) for a, b in zip(found, shown, strict=True))
    known = found
    if beside:  # where somebody stands in the image, too
        known = [
            [np.concatenate((w, i[:, :2]), 1) for w, i in zip(a, b, strict=True)]
            for a, b in zip(found, shown, strict=True)
        ]
    tracks = followed(known)
    if not tracks:
        raise FormatError(f"{name}: expected world landmarks, but all frames are empty")
    chosen, said = taken([len(one) for one in tracks], len(frames), person, name)
    positions = np.full((last - first + 1, _LANDMARKS, 3), np.nan)
    for k, place in tracks[chosen].items():
        positions[seen[k][0] - first] = found[k][place]
    told = ("layout mediapipe33: MediaPipe's world landmarks", *said)
    return Points3D(name, positions, layout="mediapipe33", unit="m", decisions=told)


def _landmarks(
    entry: Any, keys: tuple[str, ...], place: str
) -> list[Float[np.ndarray, "landmarks 3"]]:
    """Everybody's landmarks in one frame; NaN where not seen."""
    found = next((entry[key] for key in keys if key in entry), None) if entry else None
    if not found:
        return []
    if not isinstance(found, list):
        raise FormatError(f"{place}: expected lists of landmarks")
    people = found if isinstance(found[0], list) else [found]
    return [_person(one, place) for one in people if one]


def _person(landmarks: Any, place: str) -> Float[np.ndarray, "landmarks 3"]:
    if not isinstance(landmarks, list) or len(landmarks) != _LANDMARKS:
        raise FormatError(f"{place}: expected {_LANDMARKS} world landmarks")
    if not all(isinstance(one, dict) and {"x", "y", "z"} <= one.keys() for one in landmarks):
        raise FormatError(f"{place}: expected x, y and z of every landmark")
    rows = [[p["x"], p["y"], p["z"], p.get("visibility", 1.0)] for p in landmarks]
    values = as_floats(rows, place)
    shown = np.nan_to_num(values[:, 3], nan=1.0) >= _SEEN
    return np.where(shown[:, None], values[:, :3], np.nan)


def _azure(value: dict[str, Any], name: str, person: int | None) -> Points3D:
    """Millimetres in the frame of the depth camera: x right, y down, z forward."""
    frames = [one for one in value["frames"] if isinstance(one, dict)]
    names = _names(value)
    bodies = [
        [body for body in frame.get("bodies") or [] if isinstance(body, dict)] for frame in frames
    ]
    seen = Counter(str(body.get("body_id", 0)) for some in bodies for body in some)
    if not seen:
        raise FormatError(f"{name}: expected bodies, but all {len(frames)} frames are empty")
    ids = [who for who, _ in seen.most_common()]
    often, several = taken([seen[who] for who in ids], len(frames), person, name)
    who = ids[often]
    chosen = [
        next((body for body in some if str(body.get("body_id", 0)) == who), None)
        for some in bodies
    ]
    rows = [
        None if body is None else as_floats(body.get("joint_positions"), f"{name}, frame {k}")
        for k, body in enumerate(chosen)
    ]
    size = next(row.shape for row in rows if row is not None)
    for k, row in enumerate(rows):
        if row is not None and (row.shape != size or row.ndim != 2 or row.shape[1] != 3):
            raise FormatError(
                f"{name}, frame {k}: expected x, y, z of every joint, got {row.shape} numbers"
            )
    if names is not None and len(names) != size[0]:
        raise FormatError(f"{name}: {len(names)} joint_names, but {size[0]} joint_positions")
    empty = np.full(size, np.nan)
    positions = np.stack([empty if row is None else row for row in rows])
    said = ["unit mm: Azure Kinect's", f"body {who}: seen in {seen[who]} of {len(frames)} frames"]
    said += several
    stamps = [frame.get("timestamp_usec") for frame in frames]
    timing = None
    if all(isinstance(stamp, int | float) for stamp in stamps):
        timing = rate_of(as_floats(stamps, name) * _MICROSECONDS, name)
    points = Points3D(
        name, positions, names, layout=None if names is not None else "azure32", unit="mm"
    )
    if timing is not None:
        said.append(timing[2])
        points = Points3D(**{**vars(points), "fps": timing[0], "start_time": timing[1]})
    return Points3D(**{**vars(points), "decisions": tuple(said)})


def _named(value: dict[str, Any], name: str) -> Points3D:
    names = _names(value)
    assert names is not None
    numbers = as_floats(_entries(value), name)
    if numbers.ndim != 3 or numbers.shape[1] != len(names) or numbers.shape[2] not in (3, 4):
        raise FormatError(
            f"{name}: expected x, y, z of {len(names)} points in every frame, got numbers of "
            f"shape {numbers.shape}"
        )
    fps = value.get("fps", value.get("frame_rate"))
    rate = float(fps) if isinstance(fps, int | float) else None
    said = () if rate is None else (f"{rate:g} frames per second: stated by the file",)
    unit = value.get("unit", value.get("units"))
    return Points3D(
        name, numbers[..., :3], names, fps=rate, unit=unit if isinstance(unit, str) else None,
        decisions=said,
    )  # fmt: skip
