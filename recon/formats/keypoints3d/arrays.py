"""Arrays of 3D keypoints, (frames, points, 3): .npy of FreeMoCap and MotionBERT, or .npz."""

from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import KEYPOINTS
from recon.formats.files.opening import load_array, load_arrays
from recon.formats.keypoints3d.records import Points3D

_NAMES = ("names", "joint_names", "keypoint_names", "labels", "markers")
_RATES = ("fps", "frame_rate", "framerate", "rate")
_FEWEST = 10
"""Points from which on an array may be a body's; fewer are three numbers of something else."""


def read_array(path: Path) -> Points3D:
    """Read an .npy file with x, y, z of every point in every frame.

    An axis of persons or batches of length one is left out; a fourth number (a confidence) too.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, needs pickle, or has other axes.
    """
    array = load_array(path)
    found = as_points(array)
    if found is None:
        raise FormatError(
            f"{path}: expected numbers of shape (frames, points, 3), got {array.dtype} "
            f"{array.shape}"
        )
    return Points3D(path.name, found)


def holds_points(arrays: dict[str, np.ndarray]) -> str | None:
    """The key of the one array of shape (frames, points, 3) in an .npz file, or None."""
    keys = [key for key, value in arrays.items() if as_points(value) is not None]
    return keys[0] if len(keys) == 1 else None


def read_arrays(path: Path) -> Points3D:
    """Read an .npz file that holds one such array, with its names and rate where it has them.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, or holds none or several such arrays.
    """
    arrays = load_arrays(path)
    key = holds_points(arrays)
    if key is None:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in sorted(arrays.items()))
        raise FormatError(
            f"{path}: expected one array of shape (frames, points, 3), got {shapes or 'nothing'}"
        )
    found = as_points(arrays[key])
    assert found is not None
    names = next((_texts(arrays[name]) for name in _NAMES if name in arrays), None)
    if names is not None and len(names) != found.shape[1]:
        names = None
    rate = next((arrays[name] for name in _RATES if name in arrays), None)
    told = rate is not None and rate.size == 1 and rate.dtype.kind in "fiu"
    fps = float(rate.reshape(())) if told and rate is not None else None
    said = () if fps is None else (f"{fps:g} frames per second: stated by the file",)
    return Points3D(path.name, found, names, fps=fps, decisions=said)


def as_points(array: np.ndarray) -> np.ndarray | None:
    """The array as (frames, points, 3), or None where it is none of that kind."""
    if array.dtype.kind not in "fiu":
        return None
    while array.ndim > 3 and 1 in array.shape[:2]:
        array = array[0] if array.shape[0] == 1 else array[:, 0]
    if array.ndim != 3 or array.shape[-1] not in (3, 4) or not KEYPOINTS.holds(array.shape[1]):
        return None
    square = array.shape[1:] in ((3, 3), (4, 4), (3, 4))
    return None if square or array.shape[1] < _FEWEST else array[..., :3].astype(np.float64)


def _texts(array: np.ndarray) -> tuple[str, ...] | None:
    if array.dtype.kind not in "US" or array.ndim != 1:
        return None
    return tuple(array.astype(str).tolist())
