"""PLY: the body's surface, one binary file per frame."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from recon.core.errors import FormatError
from recon.formats.clouds.ply_header import check_counts
from recon.formats.files.opening import existing, replacing

_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_ply(
    path: Path,
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"] | None = None,
) -> None:
    """Write one mesh, or a point cloud where there are no faces; metres, little endian."""
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
    """Write frame_000000.ply, frame_000001.ply, ... into a folder, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"frame_{k:06d}.ply" for k in range(len(vertices)))
    for path, frame in zip(paths, vertices, strict=True):
        write_ply(path, frame, faces)
    return paths


def read_ply(
    path: Path,
) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]:
    """Vertices and triangles of one file, text or binary; no triangles in a point cloud.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or holds no finite vertices.
    """
    check_counts(existing(path))
    # imported here: it is slow to load
    import trimesh

    try:
        mesh = trimesh.load(path, process=False, file_type="ply")
        vertices = np.asarray(mesh.vertices, dtype=np.float64)  # type: ignore[union-attr]
        faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int64)
    except (
        ValueError, KeyError, IndexError, TypeError, AttributeError, EOFError, MemoryError,
        OverflowError, RuntimeError, struct.error, AssertionError, NotImplementedError,
    ) as error:  # fmt: skip
        # trimesh raises all of these on damaged files
        raise FormatError(f"{path}: damaged PLY file ({error})") from error
    if vertices.ndim != 2 or len(vertices) == 0 or not np.isfinite(vertices).all():
        raise FormatError(f"{path}: expected finite vertices, got an array {vertices.shape}")
    if faces.size > 0 and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise FormatError(f"{path}: damaged PLY file, a face names a vertex that is not there")
    return vertices, faces.reshape(-1, 3)
