"""Reads 3D keypoints in JSON: MediaPipe's, Azure Kinect's, and lists with names."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import FRAMES
from recon.detections.json_files import LANDMARKS, landmark_rows, people_of_landmarks
from recon.formats.json_files import as_floats, as_identity, listed_frames, read_json
from recon.formats.scan_times import consecutive_numbers
from recon.keypoints3d.people_files import listed_in_time, points_of_one_person, read_people
from recon.keypoints3d.records import Person, Points3D, chosen_person, tracks_of_people

_WORLD = ("pose_world_landmarks", "world_landmarks", "poseWorldLandmarks", "worldLandmarks")
_IMAGE = ("pose_landmarks", "poseLandmarks", "landmarks")
_NAMES = ("joint_names", "keypoint_names", "names", "labels", "keypoints_names")
_FRAMES = ("frames", "data", "positions", "keypoints3d", "keypoints_3d", "joints3d")
_SEEN = 0.5
"""Visibility below which MediaPipe's landmarks count as not seen."""
_MICROSECONDS = 1e-6


def read_json_points(path: Path, person: int | None = None) -> Points3D:
    """Read the 3D keypoints of one person.

    Args:
        path: of the file.
        person: whom to take where there are several, from 0 on; None takes who is seen longest.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or of another kind.
    """
    value, name = read_json(path), path.name
    reader = _reader_of(value)
    if reader is not None:
        return reader(value, name, person)
    found = read_people(listed_in_time(value, name), name, person)
    if found is None:
        raise FormatError(
            f"{path}: expected MediaPipe's pose_world_landmarks, Azure Kinect's joint_names and "
            "frames with bodies, keypoints in space of EasyMocap, OpenPose, MMPose or ZED, or "
            "names and frames of x, y, z"
        )
    return found


def _reader_of(value: Any) -> Callable[[Any, str, int | None], Points3D] | None:
    entries = _frame_entries(value)
    records = [one for one in entries if isinstance(one, dict)]
    if any(key in one for one in records for key in _WORLD):
        return _read_mediapipe
    if not isinstance(value, dict):
        return None
    if any(isinstance(one.get("bodies"), list) for one in records):
        return _read_azure_kinect
    return (
        _read_named if _listed_names(value) and entries and isinstance(entries[0], list) else None
    )


def _frame_entries(value: Any) -> list[Any]:
    if isinstance(value, dict):
        value = next((value[key] for key in _FRAMES if key in value), [value])
    return value if isinstance(value, list) else []


def _listed_names(value: dict[str, Any]) -> tuple[str, ...]:
    lists = [value[key] for key in _NAMES if isinstance(value.get(key), list) and value[key]]
    return next((tuple(one) for one in lists if all(isinstance(n, str) for n in one)), ())


def _read_mediapipe(value: Any, name: str, person: int | None) -> Points3D:
    """Read MediaPipe's world landmarks: metres from the middle of the hips, y down, z away."""
    frames = listed_frames(_frame_entries(value), name)
    numbers, notes = consecutive_numbers([number for number, _ in frames])
    count = int(numbers[-1]) + 1
    FRAMES.check(count, name)
    found = [
        _people_of_frame(entry, _WORLD, f"{name}, frame {number}") for number, entry in frames
    ]
    image = [
        _people_of_frame(entry, _IMAGE, f"{name}, frame {number}") for number, entry in frames
    ]
    known = found
    if all(len(a) == len(b) for a, b in zip(found, image, strict=True)):
        known = [  # world landmarks all have the hips at the origin: the image tells people apart
            [np.concatenate((w, i[:, :2]), 1) for w, i in zip(a, b, strict=True)]
            for a, b in zip(found, image, strict=True)
        ]
    tracks = tracks_of_people(known)
    if not tracks:
        raise FormatError(f"{name}: expected world landmarks, but all frames are empty")
    chosen, said = chosen_person([len(one) for one in tracks], len(frames), person, name)
    positions = np.full((count, LANDMARKS, 3), np.nan)
    for k, place in tracks[chosen].items():
        positions[numbers[k]] = found[k][place]
    decisions = ("layout mediapipe33: MediaPipe's world landmarks", *notes, *said)
    return Points3D(name, positions, layout="mediapipe33", unit="m", decisions=decisions)


def _people_of_frame(entry: Any, keys: tuple[str, ...], place: str) -> list[Person]:
    """The landmarks of all people in one frame; NaN where not seen."""
    people = people_of_landmarks(entry, keys) if isinstance(entry, dict) else None
    found = [landmark_rows(one, "xyz", place) for one in people or []]
    return [np.where(one[:, 3:] < _SEEN, np.nan, one[:, :3]) for one in found]


def _read_azure_kinect(value: Any, name: str, person: int | None) -> Points3D:
    """Read Azure Kinect's joints: millimetres in the depth camera's frame, y down, z forward."""
    frames = [one for one in _frame_entries(value) if isinstance(one, dict)]
    names = _listed_names(value)
    people = [
        (k, [(as_identity(one.get("body_id", 0), name), _joints_of_body(one, f"{name}, frame {k}"))
             for one in frame.get("bodies") or [] if isinstance(one, dict)])
        for k, frame in enumerate(frames)
    ]  # fmt: skip
    points = points_of_one_person(
        people, name, person, names, layout=None if names else "azure32", unit="mm",
        decisions=("unit mm: Azure Kinect's",),
    )  # fmt: skip
    stamps = [frame.get("timestamp_usec") for frame in frames]
    if not all(isinstance(stamp, int | float) for stamp in stamps):
        return points
    return points.with_rate_of_times(as_floats(stamps, name) * _MICROSECONDS)


def _joints_of_body(body: dict[str, Any], place: str) -> Person:
    found = as_floats(body.get("joint_positions"), place)
    if found.ndim != 2:
        raise FormatError(
            f"{place}: expected joint_positions with x, y, z of every joint, got numbers of shape "
            f"{found.shape}"
        )
    return found


def _read_named(value: Any, name: str, person: int | None) -> Points3D:
    """Read a list of names with x, y, z (and a confidence) of every point in every frame."""
    del person
    names, numbers = _listed_names(value), as_floats(_frame_entries(value), name)
    if numbers.ndim != 3 or numbers.shape[1] != len(names) or numbers.shape[2] not in (3, 4):
        raise FormatError(
            f"{name}: expected x, y, z of {len(names)} points in every frame, got numbers of "
            f"shape {numbers.shape}"
        )
    fps, unit = (
        next((value[key] for key in keys if key in value), None)
        for keys in (("fps", "frame_rate"), ("unit", "units"))
    )
    points = Points3D(name, numbers[..., :3], names).with_stated_rate(
        float(fps) if isinstance(fps, int | float) else None
    )
    return replace(points, unit=unit if isinstance(unit, str) else None)
