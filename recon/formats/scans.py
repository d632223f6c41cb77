"""Folders of point clouds or surface scans, one PLY or PCD file per frame."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from recon.formats.files import decode, read_bytes
from recon.formats.observation import PointsFile
from recon.formats.pcd import read_pcd
from recon.formats.ply import read_ply
from recon.units import METRES, Axis, check_override, to_z_up

POINTS = 4096
"""Points kept of a frame."""
_BODY = (0.4, 8.0)
"""Metres that a cloud with a person, and some of the room, extends over."""
_EVEN = 0.2
"""Frames that the times of a recording may differ from an even clock."""


def read_scans(
    folder: str | Path,
    *,
    fps: float | None = None,
    unit: str | None = None,
    up: Axis = "z",
    points: int = POINTS,
    outliers: float | None = 3.0,
    seed: int = 0,
) -> PointsFile:
    """Clouds of all frames, in metres, z up. Files count in natural order, `scan_2` first of `10`.

    A file `times.csv` beside them (a line per file: its time in seconds, or its name and its
    time) tells the clock; frames that were dropped stay empty.

    Args:
        folder: with .ply or .pcd files.
        fps: frames per second where there is no times.csv.
        unit: of the files (m, cm, mm, inch); None finds it by the clouds' size.
        up: axis that points up.
        points: most points kept of a frame, drawn at random.
        outliers: points whose neighbours are farther than the frame's mean by this many standard
            deviations are left out; None keeps all.
        seed: of the draw.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it holds no clouds or two kinds, a file is damaged, or clock or unit
            cannot be told; the message says what to do.
    """
    folder = Path(folder)
    check_override(unit)
    paths = scan_paths(folder)
    times = folder / "times.csv"
    if times.exists():
        frames, fps, start = frames_of(read_times(times, paths), times)
    elif fps is None:
        raise ValueError(
            f"{folder}: no times.csv tells when its files were recorded; give frames per second "
            "with --frame-rate"
        )
    else:
        frames, start = np.arange(len(paths)), 0.0
    if not fps > 0:
        raise ValueError(f"{folder}: expected a positive fps, got {fps}")
    clouds = [_read(path) for path in paths]
    metres = METRES[unit] if unit else METRES[unit_of_clouds(clouds, str(folder))]
    generator = np.random.default_rng(seed)
    kept = [thinned(cloud * metres, points, outliers, generator) for cloud in clouds]
    if not any(map(len, kept)):
        raise ValueError(f"{folder}: no file holds any point")
    return PointsFile(
        points=np.concatenate(kept) @ to_z_up(up).T,
        frame=np.repeat(frames, [len(cloud) for cloud in kept]),
        fps=fps,
        start_time=start,
    )


def scan_paths(folder: Path) -> list[Path]:
    """The clouds of a folder, in natural order.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it holds no clouds, or files of both kinds.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder; expected one of .ply or .pcd files")
    found = [path for path in folder.iterdir() if path.suffix.lower() in (".ply", ".pcd")]
    if len({path.suffix.lower() for path in found}) != 1:
        raise ValueError(
            f"{folder}: expected files .ply or .pcd, one per frame, got "
            f"{'both' if found else 'none'}"
        )
    return naturally(found)


def naturally(paths: Iterable[Path]) -> list[Path]:
    """Sorted by name, numbers in it by their value."""

    def key(path: Path) -> list[tuple[int, int | str]]:
        parts = re.split(r"(\d+)", path.name)
        return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]

    return sorted(paths, key=key)


def read_times(path: Path, files: list[Path]) -> Float[np.ndarray, " files"]:
    """Time of every file, seconds; lines of a time, or of a name and a time; a heading may be.

    Raises:
        ValueError: when a file has no time or the lines are of another kind.
    """
    rows = [re.split(r"[,;\s]+", line.strip()) for line in decode(read_bytes(path)).splitlines()]
    rows = [row for row in rows if row != [""]]
    if rows and not _is_number(rows[0][-1]):
        rows = rows[1:]
    if not all(len(row) in (1, 2) and _is_number(row[-1]) for row in rows):
        raise ValueError(f"{path}: expected a line per file, its time in s, or its name and time")
    if any(len(row) == 2 for row in rows):
        named = {Path(row[0]).name: float(row[-1]) for row in rows}
        if missing := [file.name for file in files if file.name not in named]:
            raise ValueError(f"{path}: has no time for {', '.join(missing[:5])}")
        return np.array([named[file.name] for file in files])
    if len(rows) != len(files):
        raise ValueError(f"{path}: expected {len(files)} times, one per file, got {len(rows)}")
    return np.array([float(row[0]) for row in rows])


def frames_of(times: Float[np.ndarray, " files"], path: Path) -> tuple[np.ndarray, float, float]:
    """Frame numbers on an even clock, its rate and its first time.

    Raises:
        ValueError: when the times do not rise or lie on no even clock.
    """
    steps = np.diff(times)
    if len(times) < 2 or not (steps > 0).all() or not np.isfinite(times).all():
        raise ValueError(f"{path}: expected two or more rising times in seconds")
    step = float(np.median(steps))
    step = float((times[-1] - times[0]) / max(round((times[-1] - times[0]) / step), 1))
    place = (times - times[0]) / step
    off = float(np.abs(place - place.round()).max())
    if off > _EVEN:
        raise ValueError(
            f"{path}: the times lie on no even clock (up to {off:.2f} frames off); resample first"
        )
    return place.round().astype(np.int64), 1 / step, float(times[0])


def unit_of_clouds(clouds: list[np.ndarray], name: str) -> str:
    """Metres or millimetres, by the size of the clouds.

    Raises:
        ValueError: when the size fits neither.
    """
    sizes = [
        float(np.linalg.norm(np.subtract(*np.percentile(cloud, (98, 2), axis=0))))
        for cloud in clouds
        if len(cloud) >= 10
    ]
    if not sizes:
        raise ValueError(f"{name}: too few points to tell their unit; give it with --unit")
    size = float(np.median(sizes))
    for unit in ("m", "mm"):
        if _BODY[0] <= size * METRES[unit] <= _BODY[1]:
            return unit
    raise ValueError(
        f"{name}: the clouds measure {size:.3g} units, which is {_BODY[0]} to {_BODY[1]} m "
        "neither in m nor in mm; give it with --unit"
    )


def thinned(
    cloud: Float[np.ndarray, "points 3"],
    count: int,
    outliers: float | None,
    generator: np.random.Generator,
) -> Float[np.ndarray, "kept 3"]:
    """Without outliers, and at most `count` points of it drawn at random, in their order."""
    if outliers is not None:
        cloud = cloud[~is_outlier(cloud, outliers)]
    if len(cloud) <= count:
        return cloud
    return cloud[np.sort(generator.permutation(len(cloud))[:count])]


def is_outlier(
    cloud: Float[np.ndarray, "points 3"], deviations: float, neighbours: int = 16
) -> np.ndarray:
    """Points whose mean distance to their neighbours is that of no surface (Rusu et al. 2008)."""
    if len(cloud) <= neighbours:
        return np.zeros(len(cloud), np.bool_)
    distance = KDTree(cloud).query(cloud, neighbours + 1)[0][:, 1:].mean(1)
    return distance > distance.mean() + deviations * distance.std()


def _read(path: Path) -> Float[np.ndarray, "points 3"]:
    return read_pcd(path) if path.suffix.lower() == ".pcd" else read_ply(path)[0]


def _is_number(text: str) -> bool:
    try:
        return np.isfinite(float(text)).item()
    except ValueError:
        return False
