"""Session folders of FreeMoCap: which of their files hold the body, and at what rate.

FreeMoCap 1.x writes `output_data/mediapipe_body_3d_xyz.npy` (and .csv, wide), 2.0
`output_data/body_3d_xyz.csv` (long); both write `<session>_by_frame.csv` with time stamps.
"""

import csv
from dataclasses import replace
from itertools import islice
from pathlib import Path

from recon.core.errors import FormatError
from recon.core.limits import FRAMES
from recon.formats.files.opening import decode
from recon.formats.keypoints3d.arrays import read_array
from recon.formats.keypoints3d.records import Points3D, rate_of
from recon.formats.keypoints3d.tables import read_table

_BODY = ("mediapipe_body_3d_xyz", "body_3d_xyz")
_ENDINGS = (".npy", ".csv")
_ROWS = 2_000_000
"""Rows of a table of time stamps that are looked at."""


def body_file(folder: Path) -> Path | None:
    """The file of a session that holds the body's keypoints, or None where it is no session."""
    for place in (folder / "output_data", folder):
        if not place.is_dir():
            continue
        for stem in _BODY:
            for ending in _ENDINGS:
                if (path := place / f"{stem}{ending}").is_file():
                    return path
        others = sorted(place.glob("*_body_3d_xyz.npy")) + sorted(place.glob("*_body_3d_xyz.csv"))
        if others:
            return others[0]
    return None


def time_stamps(folder: Path) -> Path | None:
    """The table of a session that has the time stamps of its frames."""
    places = (folder, folder / "output_data", folder.parent)
    found = [one for place in places for one in sorted(place.glob("*_by_frame.csv"))]
    return found[0] if found else None


def read_session(folder: Path) -> Points3D:
    """The body's keypoints of a session, millimetres, with its rate where time stamps tell it.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it is no session, or its files are damaged.
    """
    path = body_file(folder)
    if path is None:
        raise FormatError(
            f"{folder}: expected FreeMoCap's output_data with mediapipe_body_3d_xyz.npy or "
            "body_3d_xyz.csv"
        )
    read = read_array if path.suffix == ".npy" else read_table
    points = replace(read(path), unit="mm")
    said = (*points.decisions, f"FreeMoCap session: {path.relative_to(folder)}, millimetres")
    points = replace(points, decisions=said)
    stamps = time_stamps(folder)
    if points.fps is not None or stamps is None:
        return points
    timing = rate_of(_times(stamps), stamps.name)
    if timing is None:
        return points
    return replace(
        points, fps=timing[0], start_time=timing[1], decisions=(*points.decisions, timing[2])
    )


def _times(path: Path) -> list[float]:
    """One time per frame, seconds, in the order of the frames; empty where there is none."""
    with path.open("rb") as file:
        rows = csv.reader(decode(line).replace("\0", "") for line in islice(file, _ROWS))
        header = [cell.strip().lower() for cell in next(rows, [])]
        if not {"frame", "timestamp"} <= set(header):
            return []
        frame, time = header.index("frame"), header.index("timestamp")
        times: dict[int, float] = {}
        for row in rows:
            try:
                times.setdefault(int(row[frame]), float(row[time]))
            except (ValueError, IndexError):
                return []
    FRAMES.check(len(times), path)
    return [times[number] for number in sorted(times)]
