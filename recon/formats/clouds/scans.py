"""Folders of point clouds or surface scans, one PLY or PCD file per frame."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import CLOUD, FRAME_RATE, POSITION
from recon.core.units import METRES, Up, check_override, to_z_up
from recon.formats.clocks.scan_times import timed
from recon.formats.clouds.pcd import read_pcd
from recon.formats.clouds.ply import read_ply, write_ply
from recon.formats.files.opening import replacing
from recon.formats.observations import PointsFile

POINTS = 4096
"""Points kept of a frame."""
_SEARCHED = 500_000
"""Points of a frame among which outliers are searched: of denser clouds some, drawn at random."""
_BODY = (0.4, 8.0)
"""Metres that a cloud with a person, and some of the room, extends over."""


def read_scans(
    folder: str | Path,
    *,
    fps: float | None = None,
    unit: str | None = None,
    up: Up = "z",
    points: int = POINTS,
    outliers: float | None = 3.0,
    seed: int = 0,
) -> PointsFile:
    """Clouds of all frames, in metres, z up. Files count in natural order, `scan_2` first of `10`.

    A file `times.csv` beside them (a line per file: its time in seconds, or its name and its
    time) tells the clock; frames that were dropped stay empty. Times of named files may be in any
    order, and at any distances: they are then put on a clock with a frame near each.

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
    decisions: list[str] = []
    if times.exists():
        clock = timed(times, paths)
        paths, frames, fps = clock.files, clock.frames, clock.fps
        start, decisions = clock.start_time, clock.decisions
    elif fps is None:
        raise FormatError(
            f"{folder}: no times.csv tells when its files were recorded; give frames per second "
            "with --frame-rate"
        )
    else:
        frames, start = np.arange(len(paths)), 0.0
    FRAME_RATE.check(fps, folder, "frame rate")
    clouds = [_read(path) for path in paths]
    CLOUD.check(sum(map(len, clouds)), folder, "all files together: ")
    if not any(map(len, clouds)):
        raise FormatError(f"{folder}: no file holds any point")
    if unit is None and (unit := unit_of_clouds(clouds, str(folder))) != "m":
        decisions.append(f"by the size of the clouds, their unit is {unit}")
    metres = METRES[unit]
    for path, cloud in zip(paths, clouds, strict=True):
        POSITION.check(cloud * metres, path, "[point, axis]")
    generator = np.random.default_rng(seed)
    kept = [thinned(cloud * metres, points, outliers, generator) for cloud in clouds]
    return PointsFile(
        points=np.concatenate(kept) @ to_z_up(up).T,
        frame=np.repeat(frames, [len(cloud) for cloud in kept]),
        fps=fps,
        start_time=start,
        decisions=tuple(decisions),
    )


def write_scans(folder: str | Path, scans: PointsFile) -> tuple[Path, ...]:
    """Write frame_000000.ply, ... and times.csv; frames without points have no file.

    Only points and times are kept. The clouds read back are the same to single precision.

    Raises:
        ValueError: when fewer than two frames have points (one has no clock), the points are of a
            camera, or the folder holds other clouds.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise FormatError(
            f"{folder} is a file; give a folder, or a name ending in .npz for one file"
        )
    frames = np.unique(scans.frame)
    if len(frames) < 2:
        raise FormatError(f"{folder}: a folder needs two frames with points, got {len(frames)}")
    if scans.camera is not None:
        raise FormatError(f"{folder}: PLY files say nothing of a camera; write .npz instead")
    paths = tuple(folder / f"frame_{frame:06d}.ply" for frame in frames)
    if folder.is_dir() and (foreign := set(folder.glob("*.ply")) - set(paths)):
        raise FormatError(f"{folder} holds other clouds ({min(foreign).name}); give a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    times = scans.start_time + frames / scans.fps
    lines = [f"{path.name},{time:.9f}" for path, time in zip(paths, times, strict=True)]
    for path, frame in zip(paths, frames, strict=True):
        write_ply(path, scans.points[scans.frame == frame])
    with replacing(folder / "times.csv") as beside:
        beside.write_text("\n".join(["file,seconds", *lines, ""]), encoding="utf-8")
    return paths


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
        raise FormatError(
            f"{folder}: expected files .ply or .pcd, one per frame, got "
            f"{'both' if found else 'none'}"
        )
    return naturally(found)


def naturally(paths: Iterable[Path]) -> list[Path]:
    """Sorted by name, numbers in it by their value."""

    def key(path: Path) -> list[tuple[int, int | str]]:
        # longer runs of digits than Python converts are no numbers of frames
        parts = re.split(r"(\d{1,4000})", path.name)
        return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]

    return sorted(paths, key=key)


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
        raise FormatError(f"{name}: too few points to tell their unit; give it with --unit")
    size = float(np.median(sizes))
    for unit in ("m", "mm"):
        if _BODY[0] <= size * METRES[unit] <= _BODY[1]:
            return unit
    raise FormatError(
        f"{name}: the clouds measure {size:.3g} units, which is {_BODY[0]} to {_BODY[1]} m "
        "neither in m nor in mm; give it with --unit"
    )


def thinned(
    cloud: Float[np.ndarray, "points 3"],
    count: int,
    outliers: float | None,
    generator: np.random.Generator,
) -> Float[np.ndarray, "kept 3"]:
    """A cloud without outliers, of at most `count` points drawn at random, in their order."""
    if len(cloud) > _SEARCHED:
        cloud = cloud[np.sort(generator.permutation(len(cloud))[:_SEARCHED])]
    if outliers is not None:
        cloud = cloud[~is_outlier(cloud, outliers)]
    if len(cloud) <= count:
        return cloud
    return cloud[np.sort(generator.permutation(len(cloud))[:count])]


def is_outlier(
    cloud: Float[np.ndarray, "points 3"], deviations: float, neighbours: int = 16
) -> np.ndarray:
    """Points whose mean distance to their neighbours is that of no surface (Rusu et al. 2008)."""
    from scipy.spatial import KDTree

    if len(cloud) <= neighbours:
        return np.zeros(len(cloud), np.bool_)
    distance = KDTree(cloud).query(cloud, neighbours + 1)[0][:, 1:].mean(1)
    return distance > distance.mean() + deviations * distance.std()


def _read(path: Path) -> Float[np.ndarray, "points 3"]:
    return read_pcd(path) if path.suffix.lower() == ".pcd" else read_ply(path)[0]
