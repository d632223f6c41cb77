"""NTU RGB+D's .skeleton files: bodies of Kinect v2, as text."""

from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.formats.texts import decode, read_bytes
from recon.keypoints3d.people_files import People, of_people
from recon.keypoints3d.records import Points3D

_FPS = 30.0
"""Frames per second of Kinect v2."""


def read_ntu_skeleton(path: Path, person: int | None = None) -> Points3D:
    """The joints of one body, metres, in the axes of the sensor, y up.

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
    lines = iter(decode(read_bytes(path)).split("\n"))
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
    points = of_people(
        frames, path.name, person, layout="kinect25", unit="m",
        decisions=("NTU RGB+D: Kinect v2, metres",),
    )  # fmt: skip
    return points.stated(_FPS)
