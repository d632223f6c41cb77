"""Reads folders of point clouds or surface scans, one PLY, PCD or OBJ file per frame."""

import re
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from recon.core.clouds import unit_of_clouds, up_of_clouds
from recon.core.errors import FormatError
from recon.core.limits import BINARY, CLOUD, POSITION
from recon.core.units import METRES, Up, check_unit, to_z_up
from recon.formats.observations import PointsFile
from recon.formats.opening import existing_file, files_of, load_array
from recon.formats.pcd import read_pcd
from recon.formats.producers import SCANS, producer_of
from recon.formats.replacing import replacing, write_text
from recon.formats.scan_times import clock_of_files
from recon.formats.texts import decoded_text, parsed_numbers, read_bytes, with_decimal_points

_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8,
    "float64": 8,
}  # fmt: skip
_LONGEST = 1 << 16
"""Most bytes of a PLY header."""


def vertex_count(path: Path) -> int:
    """Return a PLY file's number of vertices; refuse a file that is smaller than its header says.

    Raises:
        ValueError: when it has no header of a PLY file, or is cut short or too large.
    """
    BINARY.check(path.stat().st_size, path)
    with path.open("rb") as file:
        head = file.read(_LONGEST)
    end = head.find(b"end_header")
    if not head.startswith(b"ply") or end < 0:
        raise FormatError(f"{path}: expected a PLY file, with a header from 'ply' to 'end_header'")
    words = [line.split() for line in head[:end].decode("latin-1").splitlines()]
    text = ["format", "ascii"] in [line[:2] for line in words]
    needed, count, vertices = 0, 0, 0
    for line in words:
        if line[:1] == ["element"]:
            if len(line) != 3 or not line[2][:20].isdecimal():
                raise FormatError(
                    f"{path}: damaged PLY file, got the line {' '.join(line)[:60]!r}"
                )
            count = int(line[2][:20])
            CLOUD.check(count, path, f"element {line[1][:20]}")
            vertices += count * (line[1] == "vertex")
        elif line[:1] == ["property"] and len(line) >= 3:
            # a list may be empty, so only its length field surely takes bytes
            kind = line[2] if line[1] == "list" else line[1]
            if kind not in _BYTES:
                raise FormatError(f"{path}: damaged PLY file, no type is called {kind[:20]!r}")
            # in text, a value takes at least two bytes: a digit and a separator
            needed += count * (2 if text else _BYTES[kind])
    if needed > path.stat().st_size + 1:
        raise FormatError(
            f"{path}: the PLY header promises {needed} bytes or more; the file has "
            f"{path.stat().st_size} and is cut short or damaged"
        )
    return vertices


_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_ply(
    path: Path,
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"] | None = None,
) -> None:
    """Write a mesh, or a point cloud where there are no faces, as binary PLY, metres."""
    faces = np.zeros((0, 3), dtype=np.int64) if faces is None else faces
    corners = np.empty(len(faces), dtype=_FACE)
    corners["count"], corners["corners"] = 3, faces
    points = np.empty(len(vertices), dtype=_VERTEX)
    points["x"], points["y"], points["z"] = vertices.T
    header = [
        "ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
    ]  # fmt: skip
    if len(faces) > 0:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    text = "\n".join([*header, "end_header", ""])
    with replacing(path) as beside:
        beside.write_bytes(text.encode("ascii") + points.tobytes() + corners.tobytes())


def write_ply_sequence(
    folder: Path,
    vertices: Float[np.ndarray, "time vertices 3"],
    faces: Int[np.ndarray, "faces 3"] | None = None,
) -> tuple[Path, ...]:
    """Write a mesh or cloud per frame as frame_000000.ply, frame_000001.ply, ..."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"frame_{k:06d}.ply" for k in range(len(vertices)))
    for path, frame in zip(paths, vertices, strict=True):
        write_ply(path, frame, faces)
    return paths


def read_ply(path: Path) -> Float[np.ndarray, "vertices 3"]:
    """Read the vertices of a PLY file, without invalid ones (NaN).

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged.
    """
    if vertex_count(existing_file(path)) == 0:
        return np.zeros((0, 3))
    # imported only when needed, since it loads slowly
    import trimesh

    try:
        mesh = trimesh.load(path, process=False, file_type="ply")
        vertices = np.asarray(mesh.vertices, dtype=np.float64)  # type: ignore[union-attr]
    except (
        ValueError, KeyError, IndexError, TypeError, AttributeError, EOFError, MemoryError,
        OverflowError, RuntimeError, struct.error, AssertionError, NotImplementedError,
    ) as error:  # fmt: skip
        # trimesh raises all of these on damaged files
        raise FormatError(f"{path}: damaged PLY file ({error})") from error
    if vertices.ndim != 2:
        raise FormatError(f"{path}: expected vertices x, y, z, got an array {vertices.shape}")
    return vertices[np.isfinite(vertices).all(1)]


POINTS = 4096
"""Most points that are kept of a frame by default."""
_NEIGHBOURS = 16
"""Number of nearest points whose mean distance tells whether a point is an outlier."""
_SEARCHED = 100_000
"""Most points of a frame among which outliers are searched; denser clouds are first sampled."""


def read_scans(
    folder: str | Path,
    *,
    fps: float | None = None,
    unit: str | None = None,
    up: Up | None = None,
    points: int = POINTS,
    outliers: float | None = 3.0,
    seed: int = 0,
) -> PointsFile:
    """Read a folder of one cloud per frame, in metres, z up; `scan_2` comes before `scan_10`.

    A file `times.csv` beside them (a line per file: its time in seconds or in the unit of a
    heading such as time_ms, or its name and its time) gives the clock; dropped frames stay empty.
    Times of named files may be in any order, and unevenly spaced: they are then put on a clock
    with a frame near each. Without that file, numbers or times in the names tell which frames were
    dropped.

    Args:
        folder: with .ply, .pcd or .obj files.
        fps: frames per second where there is no times.csv.
        unit: of the files (m, cm, mm, inch); None finds it by the clouds' size.
        up: axis that points up, or down; None finds it by how the person stands.
        points: most points kept of a frame, drawn at random.
        outliers: points whose neighbours are farther than the frame's mean by this many standard
            deviations are left out; None keeps all.
        seed: of the draw.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it holds no clouds or two kinds, a file is damaged, or clock, unit or axis
            cannot be told; the message says what to do.
    """
    folder = Path(folder)
    check_unit(unit)
    clock = clock_of_files(folder, scan_paths(folder), fps)
    paths, decisions = clock.files, clock.decisions
    clouds = [read_cloud(path) for path in paths]
    CLOUD.check(sum(map(len, clouds)), folder, "all files together: ")
    if not any(map(len, clouds)):
        raise FormatError(f"{folder}: no file holds any point")
    told = unit is not None
    if unit is None and (unit := unit_of_clouds(clouds, str(folder))) != "m":
        decisions.append(f"by the size of the clouds, their unit is {unit}")
    metres = METRES[unit]
    if up is None:
        scaled = [cloud * metres for cloud in clouds]
        up, said = up_of_clouds(scaled, str(folder), unit_given=told)
        decisions += said
    for path, cloud in zip(paths, clouds, strict=True):
        POSITION.check(cloud * metres, path, "[point, axis]")
    generator = np.random.default_rng(seed)
    kept = [thinned_cloud(cloud * metres, points, outliers, generator) for cloud in clouds]
    return PointsFile(
        points=np.concatenate(kept) @ to_z_up(up).T,
        frame=np.repeat(clock.frames, [len(cloud) for cloud in kept]),
        fps=clock.fps,
        start_time=clock.start_time,
        decisions=tuple(decisions),
    )


def write_scans(folder: str | Path, scans: PointsFile) -> tuple[Path, ...]:
    """Write clouds as frame_000000.ply, ... and times.csv; empty frames get no file.

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
    write_text(folder / "times.csv", "\n".join(["file,seconds", *lines, ""]))
    return paths


def scan_paths(folder: Path) -> list[Path]:
    """List the files of clouds in a folder; `scan_2` comes before `scan_10`.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it holds no clouds, or files of several kinds.
    """
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder}: no such folder; expected one of {', '.join(CLOUDS)} files"
        )
    found = cloud_files(folder)
    kinds = sorted({path.suffix.lower() for path in found})
    if len(kinds) != 1:
        raise FormatError(
            f"{folder}: expected files {' or '.join(CLOUDS)}, one per frame, got "
            f"{' and '.join(kinds) or 'none'}"
        )
    return naturally_sorted(found)


def cloud_files(folder: Path) -> list[Path]:
    """List a folder's files of one cloud each; tables and arrays only if they are clouds."""
    kind = producer_of(folder)
    others = kind.endings if kind is not None and kind.holds == SCANS else ()
    found = files_of(folder, CLOUDS) or files_of(folder, others)
    return [path for path in found if path.name != "times.csv"]


def naturally_sorted(paths: Iterable[Path]) -> list[Path]:
    """Sort paths by name, comparing numbers in names by value."""

    def key(path: Path) -> list[tuple[int, int | str]]:
        # at most 4000 digits, since Python refuses to convert more than 4300 to an integer
        parts = re.split(r"(\d{1,4000})", path.name)
        return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]

    return sorted(paths, key=key)


def thinned_cloud(
    cloud: Float[np.ndarray, "points 3"],
    count: int,
    outlier_deviations: float | None,
    generator: np.random.Generator,
) -> Float[np.ndarray, "kept 3"]:
    """Remove a cloud's outliers, and keep at most `count` of its points, drawn at random."""
    if len(cloud) > _SEARCHED:
        cloud = cloud[np.sort(generator.permutation(len(cloud))[:_SEARCHED])]
    if outlier_deviations is not None:
        cloud = cloud[~_outlier_mask(cloud, outlier_deviations)]
    if len(cloud) <= count:
        return cloud
    return cloud[np.sort(generator.permutation(len(cloud))[:count])]


def _outlier_mask(cloud: Float[np.ndarray, "points 3"], deviations: float) -> np.ndarray:
    """Return a mask of points whose mean distance to their neighbours is unusually large."""
    from scipy.spatial import KDTree

    if len(cloud) <= _NEIGHBOURS:
        return np.zeros(len(cloud), np.bool_)
    distance = KDTree(cloud).query(cloud, _NEIGHBOURS + 1)[0][:, 1:].mean(1)
    return distance > distance.mean() + deviations * distance.std()


_LOOKED_AT, _REPEATED = 400, 0.05
"""Number of points of a cloud that are compared, and share of them at one place above which they
are pixels without depth."""


def read_cloud(path: Path) -> Float[np.ndarray, "points 3"]:
    """Read a cloud or mesh without pixels that lack depth: several zeros, or one place repeated.

    Raises:
        FileNotFoundError, ValueError: as `read_ply` does.
    """
    found = {**CLOUDS, **_TABLES}[path.suffix.lower()](path)
    measured = (found != 0).any(1)
    found = found[measured] if (~measured).sum() > 1 else found
    some = found[:: len(found) // _LOOKED_AT + 1]
    places, counts = np.unique(some, axis=0, return_counts=True)
    for place in places[counts > _REPEATED * len(some)] if len(some) > _LOOKED_AT / 2 else ():
        found = found[(found != place).any(1)]
    return found


def _vertices_of_obj(path: Path) -> Float[np.ndarray, "points 3"]:
    """Read the vertices of an .obj file without their colours."""
    lines = decoded_text(read_bytes(path)).splitlines()
    rows = [line.split()[1:4] for line in lines if line.startswith(("v ", "v\t"))]
    CLOUD.check(len(rows), path, "vertices")
    try:
        found = np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise FormatError(f"{path}: damaged OBJ file ({error!s:.100})") from error
    if found.ndim != 2 or found.shape[1] != 3 or not np.isfinite(found).all():
        raise FormatError(f"{path}: expected 3 finite numbers per vertex, got shape {found.shape}")
    return found


_BETWEEN = re.compile(r"\d[;\s]+-?\d+,\d+[;\s]+-?\d")
"""Matches a number with a decimal comma between two other numbers."""


def _text_cloud(path: Path) -> Float[np.ndarray, "points 3"]:
    """Read points from lines of x, y, z; further columns, such as colours, are left out.

    Lines have equally many numbers. A heading of one line may say what they are (#, //, x), or as
    in .pts how many lines follow. Invalid points (NaN) are left out.
    """
    text = with_decimal_points(decoded_text(read_bytes(path)), _BETWEEN)
    text = text.replace(",", " ").replace(";", " ").strip()
    first, _, rest = text.partition("\n")
    promised = int(first[:20]) if first[:20].strip().isdecimal() else None
    headed = first.lower().startswith(("#", "//", "x", '"x'))
    text = rest if promised is not None or headed else text
    width, count = len(text.partition("\n")[0].split()), text.count("\n") + 1
    CLOUD.check(count, path, "lines")
    try:
        if width < 3 or promised not in (None, count) or 2 * width * count > len(text) + 1:
            raise ValueError(f"the first of its {count} lines has {width} numbers")
        found = parsed_numbers(text, width * count).reshape(count, width)[:, :3]
    except ValueError as error:
        raise FormatError(
            f"{path}: expected lines of x, y, z and perhaps more, all of the same length, "
            f"but it is damaged ({error!s:.100})"
        ) from error
    return found[np.isfinite(found).all(1)]


CLOUDS: dict[str, Callable[[Path], np.ndarray]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".obj": _vertices_of_obj,
    **dict.fromkeys((".xyz", ".xyzn", ".xyzrgb", ".pts"), _text_cloud),
}
"""Readers of files that always hold one cloud, by ending."""


def _array_cloud(path: Path) -> Float[np.ndarray, "points 3"]:
    """Read points from an .npy file of (points, 3 or more numbers), without invalid ones."""
    found = load_array(path)
    if found.ndim != 2 or found.shape[1] < 3 or found.dtype.kind not in "fiu":
        raise FormatError(f"{path}: expected numbers (points, 3), got {found.dtype} {found.shape}")
    return found[np.isfinite(found).all(1), :3].astype(np.float64)


_TABLES = {".npy": _array_cloud, ".csv": _text_cloud, ".txt": _text_cloud, ".asc": _text_cloud}
"""Readers of clouds in files whose endings stand for other data, too."""
