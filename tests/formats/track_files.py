"""Tracks of cameras as trackers write them, for benchmarks and tests; poses are camera to world.

Trackers that know no metres write in a world that begins at the first camera, and in a unit of
their own.
"""

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

UNIT = 0.37
"""Units of the trackers that tell no metres, per metre."""
_Z_BACK = np.diag([1.0, -1.0, -1.0, 1.0])
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])


def in_units(T: Float[np.ndarray, "time 4 4"]) -> Float[np.ndarray, "time 4 4"]:
    """Poses in the world and the unit of a tracker that knows of neither."""
    own = np.linalg.inv(T[0]) @ T
    own[:, :3, 3] *= UNIT
    return own


def seven(T: Float[np.ndarray, "time 4 4"]) -> Float[np.ndarray, "time 7"]:
    """Rows tx ty tz qx qy qz qw."""
    from scipy.spatial.transform import Rotation

    return np.concatenate((T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()), 1)


def write_colmap(folder: Path, T: Float[np.ndarray, "time 4 4"]) -> Path:
    """A model: unordered images, world to camera, a line of points after every image."""
    folder.mkdir()
    lines = ["# Image list with two lines of data per image:"]
    rows = seven(np.linalg.inv(in_units(T)))
    for k in np.random.default_rng(0).permutation(len(T)):
        x, y, z, w = rows[k, 3:].tolist()
        place = " ".join(map(repr, rows[k, :3].tolist()))
        lines += [f"{k + 1} {w} {x} {y} {z} {place} 1 frame_{k:06d}.jpg", "1.5 2.5 -1"]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "cameras.txt").write_text(
        "# Camera list\n1 SIMPLE_RADIAL 1920 1080 1500 960.5 540.5 0.01\n"
    )
    return folder


def write_tum(path: Path, T: Float[np.ndarray, "time 4 4"]) -> Path:
    """A trajectory with the seconds of a wall clock, 30 poses a second."""
    path = path.with_suffix(".txt")
    times = 1311868164.4 + np.arange(len(T))[:, None] / 30
    table = np.concatenate((times, seven(in_units(T))), 1)
    np.savetxt(path, table, header="timestamp tx ty tz qx qy qz qw", fmt="%.9f")
    return path


def write_droid(path: Path, T: Float[np.ndarray, "time 4 4"]) -> Path:
    """The array that `Droid.terminate` returns."""
    path = path.with_suffix(".npy")
    np.save(path, seven(in_units(T)).astype(np.float32))
    return path


def write_arkit(path: Path, T: Float[np.ndarray, "time 4 4"], *, by_columns: bool = True) -> Path:
    """Metres; the world with y up, the camera with y up and z backwards."""
    path = path.with_suffix(".json")
    frames = [
        {
            "timestamp": 5.0 + k / 30,
            "transform": (one.T if by_columns else one).tolist(),
            "intrinsics": [1500, 0, 960, 0, 1500, 540, 0, 0, 1],
        }
        for k, one in enumerate(_Y_UP @ T @ _Z_BACK)
    ]
    path.write_text(json.dumps({"frames": frames}))
    return path
