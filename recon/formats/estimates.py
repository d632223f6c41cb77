"""Reads per-frame parameters of SMPL-like bodies that networks estimate from video.

Read are dictionaries of arrays, nested or not, in .npz, .pt and .pkl files: GVHMR
(`smpl_params_global`), WHAM (`pose_world`, `trans_world` for every person), SLAHMR
(`root_orient`, `pose_body`, `trans` with an axis of people), SMPL-X (`global_orient`, `body_pose`,
`transl`) and AMASS (`poses`, `trans`). Pickles are read without running what is inside.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import ZIP_STORED, BadZipFile, ZipFile, is_zipfile

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from recon.core import limits
from recon.core.coordinates import signed_axis
from recon.core.errors import FormatError
from recon.core.limits import BINARY, NUMBERS
from recon.core.units import Up, to_z_up
from recon.formats.json_files import frame_numbers
from recon.formats.opening import existing_file, load_arrays
from recon.formats.pickles import check_tree_limits, read_tree
from recon.formats.scan_times import common_step

SUFFIXES = (".npz", ".pt", ".pth", ".pkl", ".npy")
_ROOT = ("global_orient", "root_orient", "poses_root")
_BODY = ("body_pose", "pose_body", "poses_body")
_WHOLE = ("pose_world", "poses", "pose", "fullpose", "pred_rotmat", "smpl_poses")
_PLACE = ("trans_world", "transl", "trans", "pred_trans", "smpl_trans")
_SHAPE = ("betas", "shape", "pred_shape")
_FRAMES = ("frame_ids", "frame", "frame_id", "frame_idx", "frame_index")
_IMAGES = ("imgname", "img_name", "image_name", "img_path", "image_path")
"""Names of columns of the images' names; their folders tell clips apart."""
_IDS = ("id", "ids", "track_id", "track_ids", "person_id", "person_ids", "subject", "sub")
"""Names of columns that tell whose row it is, where the rows of several people stand together."""
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_IN_CAMERA = ("incam", "_cam", "camera")
_DAMAGE = (
    RuntimeError, UnpicklingError, BadZipFile, EOFError, OSError, ValueError, KeyError, IndexError,
    TypeError, AttributeError, OverflowError, MemoryError, ImportError, AssertionError,
)  # fmt: skip
"""Exceptions that torch and its unpickler raise for damaged files."""
_UPRIGHT = 0.5
"""Least component of the mean trunk direction along the up axis; unit vectors are averaged."""

Tree = Mapping[Any, Any]


@dataclass(frozen=True)
class BodyEstimate:
    """One person's SMPL parameters in every frame, in the world of the estimating program."""

    rotations: Float[np.ndarray, "time 22 3 3"]
    """Local rotations of SMPL's first 22 joints."""
    translation: Float[np.ndarray, "time 3"]
    """SMPL translation, metres."""
    known: Bool[np.ndarray, " time"]
    """Whether each frame was estimated; the others repeat the estimated frame before them."""
    betas: Float[np.ndarray, " shape"]
    """Shape coefficients of the body model that the program used, which need not be ours."""
    fps: float | None
    """Frames per second; None where the file does not say."""
    up: Up
    """Axis of the file's world that points up or down."""
    notes: tuple[str, ...]
    """What was assumed (person, scale, up axis), one sentence each."""


def read_estimate(path: Path, person: int | None = None, up: Up | None = None) -> BodyEstimate:
    """Read one person's SMPL parameters of every frame, as networks estimate them from video.

    Args:
        path: the file.
        person: which of several people, by their order in the file, from 0 on; None takes the one
            of the most frames.
        up: axis that points up; None tells it from how the body stands.

    Raises:
        FileNotFoundError: when there is no such file.
        FormatError: when it is damaged, holds nothing of this kind or not so many people.
    """
    tree = _read_tree(path)
    people = list(_dictionaries_of_bodies(tree, ()))
    in_world = [
        one for one in people if not any(word in str(key) for key in one[0] for word in _IN_CAMERA)
    ]
    people = in_world or people
    if not people:
        raise FormatError(
            f"{path}: expected rotations and a translation of a SMPL-like body for every frame "
            "(global_orient, body_pose and transl; root_orient, pose_body and trans; or poses and "
            f"trans), got {_first_keys(tree)}"
        )
    number, notes = _person_index(path, people, person)
    where, arrays = people[number]
    if where:
        notes.append(f"taken from {'.'.join(map(str, where))}")
    rotations = _rotations_of_joints(path, arrays)
    translation = _array_by_any_name(path, arrays, _PLACE).reshape(-1, 3)
    if "smpl_scaling" in arrays:  # AIST++ enlarges body and path by this factor
        translation = translation / _numeric_array(arrays["smpl_scaling"]).ravel()[:1]
        notes.append("AIST++: the translation is divided by smpl_scaling")
    if len(rotations) != len(translation):
        raise FormatError(
            f"{path}: expected as many frames of translation as of rotations, got "
            f"{len(translation)} and {len(rotations)}"
        )
    finite = np.isfinite(rotations).reshape(len(rotations), -1)
    known = np.array(np.isfinite(translation).all(axis=-1) & finite.all(axis=-1), ndmin=1)
    if not known.any():
        raise FormatError(f"{path}: no frame of the person holds finite numbers")
    limits.POSITION.check(translation[known], path, "translation")
    rotations, translation, known = _filled_frames(path, arrays, rotations, translation, known)
    axis = _up_axis_of(path, rotations[known], up, notes)
    betas = next((_numeric_array(arrays[key]) for key in _SHAPE if key in arrays), np.zeros(1))
    known_shape = betas.dtype.kind in "fiu" and betas.ndim > 0 and betas.size > 0
    betas = betas.reshape(-1, betas.shape[-1]).mean(0) if known_shape else np.zeros(1)
    limits.SHAPE.check(betas, path, "betas")
    rates = [_numeric_array(tree[key]).ravel() for key in _RATES if key in tree]
    rate = next((float(one[0]) for one in rates if one.dtype.kind in "fiu" and one.size), None)
    return BodyEstimate(rotations, translation, known, betas, rate, axis, tuple(notes))


def _read_tree(path: Path) -> Tree:
    """Read a file as nested dictionaries of arrays, without running code in it."""
    existing_file(path)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return load_arrays(path)
    if suffix in (".pkl", ".npy"):
        return _records_by_person(read_tree(path))
    if suffix not in SUFFIXES:
        raise FormatError(
            f"{path}: expected a file of {', '.join(SUFFIXES)} with parameters of a SMPL-like body"
        )
    import torch

    BINARY.check(path.stat().st_size, path)
    try:
        if is_zipfile(path):
            with ZipFile(path) as archive:
                packed = [one for one in archive.infolist() if one.compress_type != ZIP_STORED]
            if packed:  # a compressed file in the archive could unpack to any size
                raise ValueError(
                    f"{packed[0].filename} is compressed, and torch.save compresses nothing"
                )
        content = torch.load(path, map_location="cpu", weights_only=True)
    except _DAMAGE as error:
        raise FormatError(
            f"{path}: expected tensors saved by torch, but {error!r:.200}"
        ) from error
    if not isinstance(content, dict):
        raise FormatError(
            f"{path}: expected a dictionary of tensors, got {type(content).__name__}"
        )
    check_tree_limits(content, path)
    return content


def _records_by_person(tree: Tree) -> Tree:
    """Regroup PHALP's (4D-Humans) records of images by person; return other trees unchanged."""
    images = list(tree.values())
    if not images or not all(
        isinstance(one, dict) and {"tid", "smpl"} <= set(one) for one in images
    ):
        return tree
    tracks: dict[Any, dict[str, list[Any]]] = {}
    for frame, one in enumerate(images):
        for who, body, place in zip(one["tid"], one["smpl"], one["camera"], strict=False):
            track = tracks.setdefault(f"camera, person {who}", {})
            row = {"frame_ids": frame, "transl": place, **body}
            for key, value in row.items():
                track.setdefault(key, []).append(value)
    return {
        who: {key: np.array(rows) for key, rows in track.items()} for who, track in tracks.items()
    }


def _dictionaries_of_bodies(
    tree: Tree, keys: tuple[Any, ...]
) -> Iterator[tuple[tuple[Any, ...], Tree]]:
    """Find all nested dictionaries with per-frame body parameters, each with its path of keys."""
    names = {key for key in tree if isinstance(key, str)}
    has_rotations = names & set(_WHOLE) or (names & set(_ROOT) and names & set(_BODY))
    if has_rotations and names & set(_PLACE):
        yield from ((keys, one) for one in _people_of_arrays(tree))
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _dictionaries_of_bodies(value, (*keys, key))


def _people_of_arrays(arrays: Tree) -> Iterator[Tree]:
    """Split arrays with axes (people, frames, ...) into one dictionary per person."""
    place = _numeric_array(next(arrays[key] for key in _PLACE if key in arrays))
    if place.ndim != 3 or place.shape[1] == 1:
        yield from _people_of_rows(arrays, len(place))
        return
    for row in range(len(place)):
        yield {
            key: value[row]
            for key, value in {key: _numeric_array(value) for key, value in arrays.items()}.items()
            if value.ndim >= 2 and len(value) == len(place)
        }


def _people_of_rows(arrays: Tree, count: int) -> Iterator[Tree]:
    """Split rows by the columns of ids and the folders of images into one dictionary per person.

    People come in the order of their first rows. Where no such column is, or where it numbers
    the rows, all rows are one person's.
    """
    columns = {key: _numeric_array(arrays[key]) for key in (*_IDS, *_IMAGES) if key in arrays}
    labels = [
        [str(Path(str(one)).parent) if key in _IMAGES else str(one) for one in column.ravel()]
        for key, column in columns.items()
        if column.size == count
    ]
    rows: dict[tuple[str, ...], list[int]] = {}
    for row, who in enumerate(zip(*labels, strict=True)):
        rows.setdefault(who, []).append(row)
    if not 0 < len(rows) < count:
        yield arrays
        return
    values = {key: _numeric_array(value) for key, value in arrays.items()}
    for mine in rows.values():
        yield {
            key: value[mine]
            if value.ndim and len(value) == count and (value.ndim > 1 or key not in _SHAPE)
            else value
            for key, value in values.items()
        }


def _frame_numbers(arrays: Tree, count: int) -> tuple[str, np.ndarray] | None:
    """Return name and values of the column that numbers the frames; None if there is none.

    Names of images count by their last numbers, in steps of the greatest number that divides all
    differences: those of a clip of which each fifth image was taken are one frame apart.
    """
    columns = {k: _numeric_array(arrays[k]) for k in (*_FRAMES, *_IMAGES) if k in arrays}
    for key in (key for key in _FRAMES if key in columns and columns[key].ndim):
        ids = columns[key].ravel()
        whole = np.nan_to_num(ids).astype(np.int64) if ids.dtype.kind == "f" else ids
        return key, whole if np.array_equal(whole, ids) else ids
    key = next((key for key in columns if columns[key].shape == (count,)), None)
    if key is None:
        return None
    names, numbers = np.unique([str(one) for one in columns[key]], return_inverse=True)
    with suppress(FormatError):  # names without numbers stay in alphabetical order
        numbers = np.array(frame_numbers(names.tolist(), key))[numbers]
    return key, numbers // common_step(numbers)


def _person_index(
    path: Path, people: list[tuple[tuple[Any, ...], Tree]], person: int | None
) -> tuple[int, list[str]]:
    if person is not None and not 0 <= person < len(people):
        raise FormatError(f"{path}: expected a person from 0 to {len(people) - 1}, got {person}")
    if person is not None:
        return person, []
    frames = [len(_numeric_array(next(a[k] for k in _PLACE if k in a))) for _, a in people]
    number = int(np.argmax(frames))
    if len(people) == 1:
        return 0, []
    return number, [
        f"person {number} of {len(people)} is taken, the one with the most frames "
        f"({frames[number]}); --person chooses another"
    ]


def _rotations_of_joints(path: Path, arrays: Tree) -> Float[np.ndarray, "time 22 3 3"]:
    if any(key in arrays for key in _ROOT) and any(key in arrays for key in _BODY):
        parts = [
            _rotation_matrices(path, _array_by_any_name(path, arrays, keys))
            for keys in (_ROOT, _BODY)
        ]
        if len(parts[0]) != len(parts[1]):
            raise FormatError(
                f"{path}: expected as many frames of the root's rotation as of the body's, got "
                f"{len(parts[0])} and {len(parts[1])}"
            )
        turns = np.concatenate(parts, 1)
    else:
        turns = _rotation_matrices(path, _array_by_any_name(path, arrays, _WHOLE))
    if turns.shape[1] < 22:
        raise FormatError(
            f"{path}: expected rotations of SMPL's first 22 joints, got {turns.shape[1]}"
        )
    return turns[:, :22]


def _rotation_matrices(path: Path, values: np.ndarray) -> Float[np.ndarray, "time joints 3 3"]:
    """Convert rotation vectors or matrices, flat or not, to matrices; NaN stays NaN."""
    if values.ndim >= 3 and values.shape[-2:] == (3, 3):
        found = values.reshape(len(values), -1, 3, 3)
        off = np.abs(found @ found.swapaxes(-1, -2) - np.eye(3)).max((-1, -2))
        limits.ORTHOGONALITY.check(off[np.isfinite(off)], path, "rotation matrices")
        return found
    limits.check_rotation_vectors(values, path, "rotations")
    if values.size % (3 * max(len(values), 1)):
        raise FormatError(f"{path}: expected three numbers for every joint, got {values.shape}")
    vectors = values.reshape(len(values), -1, 3)
    finite = np.array(np.isfinite(vectors).all(-1), ndmin=2)
    turned = Rotation.from_rotvec(np.where(finite[..., None], vectors, 0.0).reshape(-1, 3))
    matrices = turned.as_matrix().reshape(*vectors.shape[:2], 3, 3)
    return np.where(finite[..., None, None], matrices, np.nan)


def _array_by_any_name(path: Path, arrays: Tree, names: tuple[str, ...]) -> np.ndarray:
    key = next(name for name in names if name in arrays)
    value = _numeric_array(arrays[key])
    NUMBERS.check(value.size, path, key)
    if value.dtype.kind not in "fiu" or value.ndim < 2 or len(value) == 0:
        raise FormatError(
            f"{path}: expected numbers for every frame in {key}, got {value.dtype} {value.shape}"
        )
    return value.astype(np.float64)


def _numeric_array(value: Any) -> np.ndarray:
    """Convert an array, tensor or nested list to a NumPy array; empty if that is impossible."""
    if isinstance(value, np.ndarray):
        return value
    if hasattr(value, "numpy"):
        if value.numel() * value.element_size() > value.untyped_storage().nbytes():
            raise FormatError(
                "expected tensors that store all their numbers, got one of shape "
                f"{tuple(value.shape)} that repeats a few; save tensor.contiguous()"
            )
        return (value.float() if value.is_floating_point() else value).numpy()
    try:
        return np.asarray(value)
    except (ValueError, TypeError):  # e.g. nested lists of unequal lengths
        return np.zeros(0)


def _filled_frames(
    path: Path,
    arrays: Tree,
    rotations: np.ndarray,
    translation: np.ndarray,
    has_person: Bool[np.ndarray, " time"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sort by frame; repeat the frame before where the person is missing; also return the mask."""
    frames = np.arange(len(has_person))
    column = _frame_numbers(arrays, len(has_person))
    if column is not None:
        key, ids = column
        if ids.dtype.kind not in "iu" or not len(np.unique(ids)) == len(ids) == len(has_person):
            raise FormatError(
                f"{path}: expected whole numbers in {key}, one for every frame and each once; "
                f"rows of several people need a column of ids ({', '.join(_IDS)})"
            )
        frames = ids
    count = int(frames.max()) - int(frames.min()) + 1
    limits.FRAMES.check(count, path, "frame_ids")
    NUMBERS.check(count * rotations[0].size, path, "frame_ids")
    frames, there = frames - frames.min(), np.zeros(count, bool)
    there[frames] = has_person
    source = np.full(count, -1)
    source[frames[has_person]] = np.flatnonzero(has_person)
    held = source[np.maximum.accumulate(np.where(there, np.arange(count), there.argmax()))]
    return rotations[held], translation[held], there


def _up_axis_of(path: Path, rotations: np.ndarray, given: Up | None, notes: list[str]) -> Up:
    """Find the axis that points up: the one along the pelvis' mean y axis, toward the head."""
    mean = rotations[:, 0, :, 1].mean(0)
    if given is not None:
        if mean @ to_z_up(given)[2] < -_UPRIGHT:
            notes.append(f"up axis {given}: given, although the body is upside down then")
        return given
    axis = int(np.abs(mean).argmax())
    if np.abs(mean[axis]) < _UPRIGHT:
        raise FormatError(
            f"{path}: the body is not upright along any axis, so the up axis is "
            "unknown; give it with --up"
        )
    up = signed_axis(axis, mean[axis])
    notes.append(f"{'-' if up.endswith('down') else ''}{up[0]} is up, as the body stands along it")
    return up


def _first_keys(tree: Tree) -> str:
    names = [str(key) for key in tree]
    return ", ".join(names[:12]) + (" ..." if len(names) > 12 else "") or "nothing"
