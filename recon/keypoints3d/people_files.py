"""Reads 3D keypoints of several people: EasyMocap, OpenPose, MMPose, ZED and NTU.

Each program has a function that takes the record of one frame and returns the people in it, or
None if another program wrote the record.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import FRAMES, PEOPLE
from recon.formats.json_files import Frames, as_floats, as_identity, listed_frames
from recon.formats.scan_times import consecutive_numbers
from recon.formats.texts import decoded_text, read_bytes
from recon.keypoints3d.records import (
    APART,
    Person,
    Points3D,
    body_distance,
    chosen_person,
    tracks_of_people,
)

_LISTS = ("instance_info", "predictions", "frames")
"""Keys under which a file with all frames keeps them."""
_NANOSECONDS = 1e-9
People = list[tuple[int, Person]]
"""Number or -1, and x, y, z of everybody in a frame; NaN where not seen."""


def read_people(frames: Frames, name: str, person: int | None = None) -> Points3D | None:
    """Read the keypoints of one person; None if the format is another one.

    Args:
        frames: numbers and records of the frames.
        name: of the file or folder.
        person: whom to take of several, from 0 on; None takes who is seen longest.

    Raises:
        ValueError: when it is damaged, or nobody is in it.
    """
    reader = next((one for one in _READERS for _, entry in frames if one(entry, name)), None)
    if reader is None:
        return None
    found = [(k, reader(entry, f"{name}, frame {k}") or []) for k, entry in frames]
    points = points_of_one_person(found, name, person)
    times = _times_in_seconds([entry for _, entry in frames])
    if times is None:
        return points
    return points.with_rate_of_times(np.linspace(0.0, times[-1], len(points.positions)))


def points_of_one_person(
    frames: Sequence[tuple[int, People]],
    name: str,
    person: int | None,
    names: tuple[str, ...] = (),
    **known: Any,
) -> Points3D:
    """Return one person's keypoints in all frames, tracked by number or else by position.

    Args:
        frames: numbers of frames, increasing, and everybody in them. Evenly stepping ones become
            consecutive; a person whose number changes is one person.
        name: of the file.
        person: whom to take, from 0 on in the order of how long they are seen; None the first.
        names: of the points.
        known: further fields of `Points3D`.

    Raises:
        ValueError: when nobody is there, or somebody has another number of points.
    """
    PEOPLE.check(max((len(people) for _, people in frames), default=0), name)
    FRAMES.check(frames[-1][0] - frames[0][0] + 1 if frames else 0, name)
    numbers, notes = consecutive_numbers([k for k, _ in frames])
    if all(who >= 0 for _, people in frames for who, _ in people):
        counts = Counter(who for _, people in frames for who, _ in people).most_common()
        tracks = [
            {k: [one for one, _ in people].index(who)
             for k, (_, people) in enumerate(frames) if who in dict(people)}
            for who, _ in counts
        ]  # fmt: skip
        tracks, notes = _joined_tracks(tracks, [people for _, people in frames], notes)
    else:
        tracks = tracks_of_people([[points for _, points in people] for _, people in frames])
    if not tracks:
        raise FormatError(f"{name}: expected people, but all {len(frames)} frames are empty")
    chosen, said = chosen_person([len(one) for one in tracks], len(frames), person, name)
    rows = {int(numbers[k]): frames[k][1][place] for k, place in tracks[chosen].items()}
    (_, example), count = next(iter(rows.values())), int(numbers[-1]) + 1
    positions = np.full((count, len(names) or len(example), 3), np.nan)
    for number, (_, points) in rows.items():
        if points.shape != positions.shape[1:]:
            raise FormatError(
                f"{name}, frame {frames[0][0] + number}: expected x, y, z of "
                f"{positions.shape[1]} points{', which the file names' if names else ''}, "
                f"got numbers of shape {points.shape}"
            )
        positions[number] = points
    said = (*known.pop("decisions", ()), *notes, *said)
    return Points3D(name, positions, names, decisions=said, **known)


def _joined_tracks(
    tracks: list[dict[int, int]], frames: Sequence[People], notes: tuple[str, ...]
) -> tuple[list[dict[int, int]], tuple[str, ...]]:
    """Join a track to the one that ended shortly before in nearly the same pose, if any.

    Args:
        tracks: for every person, the place in the list of people, keyed by frame.
        frames: everybody in every frame.
        notes: sentences, to which one about joined tracks is added.

    Returns:
        The tracks, the longest first, and the sentences.
    """
    out: list[dict[int, int]] = []
    for track in sorted(tracks, key=min):  # a track's keys are its frames, ascending
        start = next(iter(track))
        pose = frames[start][track[start]][1]
        ends = [(k, frames[last][one[last]][1]) for k, one in enumerate(out)
                if 0 < start - (last := next(reversed(one))) <= _LOST]  # fmt: skip
        near = [(body_distance(end, pose), k) for k, end in ends if end.shape == pose.shape]
        away, k = min(near, default=(np.inf, 0))
        if away < APART:
            out[k] |= track
        else:
            out.append(dict(track))
    told = f"{len(tracks)} numbers of people are those of {len(out)}: some go on where others end"
    joined = len(out) < len(tracks)
    return sorted(out, key=len, reverse=True), (*notes, told) if joined else notes


_LOST = 15
"""Most frames after the end of a track at which another may continue it."""


def listed_in_time(value: Any, name: str) -> Frames:
    """Return a file's records with their frame numbers, which for ZED follow from the times.

    Raises:
        ValueError: when only some records state a frame number, or two state the same.
    """
    if isinstance(value, dict):
        inside = list(value.values())
        if inside and all(isinstance(one, dict) and "body_list" in one for one in inside):
            value = inside
        else:
            value = next((value[key] for key in _LISTS if key in value), [])
    if not isinstance(value, list):
        return []
    times = _times_in_seconds(value)
    if times is None:
        return listed_frames(value, name)
    steps = np.diff(times, prepend=times[0])
    numbers = np.cumsum(np.rint(steps / np.median(steps[1:]))).astype(int)
    return list(zip(numbers.tolist(), value, strict=True))


def _times_in_seconds(entries: list[Any]) -> Float[np.ndarray, " frames"] | None:
    """Times of ZED's frames, seconds from the first; None if missing or not rising."""
    stamps = [one.get("timestamp") if isinstance(one, dict) else None for one in entries]
    numbers = [float(one) for one in stamps if isinstance(one, int)]
    times = (np.array(numbers) - (numbers or [0.0])[0]) * _NANOSECONDS
    rising = len(numbers) == len(entries) > 1 and bool((np.diff(times) > 0).all())
    return times if rising else None


def _people_of_zed(entry: Any, place: str) -> People | None:
    """Read `{"timestamp": ..., "body_list": [{"id": ..., "keypoint": [[x, y, z], ...]}]}`."""
    return _people_under_keys(entry, "body_list", "keypoint", place)


def _people_of_openpose(entry: Any, place: str) -> People | None:
    """Read `{"people": [{"person_id": [-1], "pose_keypoints_3d": [x, y, z, c, ...]}]}`."""
    return _people_under_keys(entry, "people", "pose_keypoints_3d", place)


def _people_of_easymocap(entry: Any, place: str) -> People | None:
    """Read `[{"id": ..., "keypoints3d": [[x, y, z, c], ...]}]`."""
    return _people_under_keys({"": entry}, "", "keypoints3d", place)


def _people_of_mmpose(entry: Any, place: str) -> People | None:
    """Read `{"instances": [{"keypoints": [[x, y, z], ...]}]}`, or its list alone."""
    entry = entry if isinstance(entry, dict) else {"instances": entry}
    return _people_under_keys(entry, "instances", "keypoints", place)


def _people_under_keys(entry: Any, people_key: str, points_key: str, place: str) -> People | None:
    """The people listed under one key; None if none has 3D points under the other key."""
    listed = entry.get(people_key) if isinstance(entry, dict) else None
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        return None
    found = [
        (
            as_identity(one.get("id", one.get("person_id")), place),
            _points_with_nan(one[points_key], place),
        )
        for one in listed
        if one.get(points_key)
    ]
    return found if found and all(x.shape[1] == 3 for _, x in found) else None


def _points_with_nan(value: Any, place: str) -> np.ndarray:
    """Return an array of rows x, y, z; NaN where the confidence in column four is not positive."""
    numbers = as_floats(value, place)
    if numbers.ndim == 1:
        numbers = numbers.reshape(-1, 4) if numbers.size % 4 == 0 else numbers[:, None]
    if numbers.ndim != 2 or numbers.shape[1] != 4:
        return numbers.reshape(len(numbers), -1)
    return np.where(numbers[:, 3:] > 0, numbers[:, :3], np.nan)


_READERS: Sequence[Callable[[Any, str], People | None]] = (
    _people_of_zed,
    _people_of_openpose,
    _people_of_easymocap,
    _people_of_mmpose,
)


_FPS = 30.0
"""Frames per second of Kinect v2."""


def read_ntu_skeleton(path: Path, person: int | None = None) -> Points3D:
    """Read the joints of one body: metres, axes of the sensor, y up.

    A file has the number of frames; for every frame the number of bodies; for every body a line
    with its number first, the number of joints, and a line for every joint: x, y, z, seven more
    numbers of images and orientation, and whether it was tracked (0 is not).

    Args:
        path: of the file.
        person: whom to take of several, from 0 on; None takes who is seen longest.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or holds nobody.
    """
    lines = iter(decoded_text(read_bytes(path)).split("\n"))
    bodies: dict[str, int] = {}
    frames: list[tuple[int, People]] = []
    try:
        for frame in range(int(next(lines))):
            people: People = []
            for _ in range(int(next(lines))):
                who = bodies.setdefault(next(lines).split()[0], len(bodies))
                rows = [next(lines).split() for _ in range(int(next(lines)))]
                numbers = np.array([[*row[:3], row[-1]] for row in rows], dtype=np.float64)
                seen = numbers[:, 3:] > 0
                people.append((who, np.where(seen, numbers[:, :3], np.nan)))
            frames.append((frame, people))
    except (StopIteration, ValueError, IndexError) as error:
        raise FormatError(
            f"{path}: expected NTU RGB+D's skeletons, but frame {len(frames)} is cut short or "
            f"damaged ({error!s:.100})"
        ) from error
    points = points_of_one_person(
        frames, path.name, person, layout="kinect25", unit="m",
        decisions=("NTU RGB+D: Kinect v2, metres",),
    )  # fmt: skip
    return points.with_stated_rate(_FPS)
