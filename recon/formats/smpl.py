"""Reads a user's model files of SMPL, SMPL-H and SMPL-X (.npz or .pkl).

The files are licensed by the Max Planck Society and are never shipped or downloaded here. Nothing
inside a file is ever executed (`recon.formats.pickles`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, MODEL_LENGTH, MODEL_NUMBERS, MODEL_WEIGHT, Limit
from recon.core.skeleton import JOINTS, PARENTS
from recon.formats.opening import DAMAGE, check_sizes, existing_file
from recon.formats.pickles import plain_array, read_tree

_NEEDED = ("v_template", "shapedirs", "J_regressor", "weights", "kintree_table", "f")
_USED = (*_NEEDED, "posedirs")
_RANGES: dict[str, Limit] = {
    "v_template": MODEL_LENGTH, "shapedirs": MODEL_LENGTH, "posedirs": MODEL_LENGTH,
    "J_regressor": MODEL_WEIGHT, "weights": MODEL_WEIGHT,
}  # fmt: skip
_SUM = 0.05
"""Greatest deviation from one of the sum of the weights of a vertex, or of a joint."""
_SMPLX_JOINTS = 55
_SMPLX_SHAPES = 300
"""SMPL-X stores 300 shape directions before those of the expression; version 1.0 stores 10."""
_MISSING = (
    "{path}: no such body model file. SMPL-family files are licensed by the Max Planck Society "
    "and cannot come with this package: register and download SMPL at https://smpl.is.tue.mpg.de, "
    "SMPL-H (16 shapes, .npz) at https://mano.is.tue.mpg.de or SMPL-X at "
    "https://smpl-x.is.tue.mpg.de and give the path of the file, or leave the path out to use the "
    "free bundled body"
)


@dataclass(frozen=True)
class SmplArrays:
    """The arrays of a body model's file; metres, y up, facing z."""

    template: np.ndarray
    """(V, 3) surface of the mean shape."""
    shape_directions: np.ndarray
    """(V, 3, S) change per unit of each shape coefficient; expressions are left out."""
    pose_directions: np.ndarray | None
    """(V, 3, 9 (J-1)) change per entry of the joints' rotations minus identity; None if zero."""
    joint_regressor: np.ndarray
    """(J, V) weights by which each joint is a mean of vertices."""
    weights: np.ndarray
    """(V, J) skinning weights."""
    parents: np.ndarray
    """(J,) parent of each joint, -1 for the root; the first 22 are the body's."""
    faces: np.ndarray
    """(F, 3) vertex numbers."""

    def body_model_arrays(self) -> dict[str, np.ndarray]:
        """Reduce the model to 22 joints; name its arrays as in `recon.body.model.BodyModel`.

        Joints are regressed from the shaped surface; skinning weights of further joints are added
        to their nearest ancestor among the 22.
        """
        count = len(JOINTS)
        ancestor = list(range(len(self.parents)))
        for joint in range(count, len(ancestor)):
            ancestor[joint] = ancestor[int(self.parents[joint])]
        weights = np.zeros((len(self.template), count))
        np.add.at(weights.T, ancestor, self.weights.T)
        regressor, poses = self.joint_regressor[:count], self.pose_directions
        no_change = np.zeros(self.shape_directions.shape[-1])
        known = {
            "template": self.template,
            "shape_directions": self.shape_directions,
            "joint_template": regressor @ self.template,
            "joint_directions": np.einsum("jv,vdk->jdk", regressor, self.shape_directions),
            "weights": weights,
            "faces": self.faces,
            "male": no_change,
            "female": no_change,
        }
        if poses is not None:
            known["pose_directions"] = poses[..., : 9 * (count - 1)].transpose(2, 0, 1)
        return known


def load_smpl(path: str | Path) -> SmplArrays:
    """Read a body model of the SMPL family from a user's file, .npz or .pkl.

    Raises:
        FileNotFoundError: when there is no such file; the message says where to get one.
        ValueError: when it is damaged, no SMPL-family body, or holds anything but plain data.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(_MISSING.format(path=path))
    match existing_file(path).suffix.lower():
        case ".npz":
            fields = _read_npz(path)
        case ".pkl":
            tree = read_tree(path)
            fields = {name: plain_array(tree[name], name, path) for name in _USED if name in tree}
        case other:
            raise FormatError(f"{path}: expected a body model, .npz or .pkl, got {other!r}")
    return _checked_arrays(fields, path)


def _checked_arrays(fields: Mapping[str, np.ndarray], path: Path) -> SmplArrays:
    """Check shapes and ranges of a model's arrays, and convert them to double precision."""
    if missing := [name for name in _NEEDED if name not in fields]:
        raise FormatError(
            f"{path}: not a body model of the SMPL family: no {', '.join(missing)}; "
            f"it holds {', '.join(sorted(fields)[:20]) or 'nothing'}"
        )
    numbers = {name: _checked_numbers(fields[name], name, path) for name in _NEEDED}
    template, weights = numbers["v_template"], numbers["weights"]
    if template.ndim != 2 or weights.ndim != 2 or numbers["shapedirs"].ndim != 3:
        raise FormatError(f"{path}: v_template, weights, shapedirs should have 2, 2, 3 dimensions")
    vertices, joints = weights.shape
    expected = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, numbers["shapedirs"].shape[2]),
        "J_regressor": (joints, vertices),
        "kintree_table": (2, joints),
        "f": (len(numbers["f"]), 3),
    }
    for name, shape in expected.items():
        if numbers[name].shape != shape:
            raise FormatError(f"{path}: {name} should be {shape}, is {numbers[name].shape}")
    for name in ("weights", "J_regressor"):
        off = float(np.abs(numbers[name].sum(1) - 1).max())
        if not off < _SUM:
            raise FormatError(f"{path}: rows of {name} should sum to 1, one is {off:.3g} away")
    faces = numbers["f"].astype(np.int64)
    if len(faces) == 0 or faces.min() < 0 or faces.max() >= vertices:
        raise FormatError(f"{path}: faces name vertices outside 0..{vertices - 1}")
    return SmplArrays(
        template=template,
        shape_directions=_without_expressions(numbers["shapedirs"], joints),
        pose_directions=_pose_correctives(fields, vertices, joints, path),
        joint_regressor=numbers["J_regressor"],
        weights=weights,
        parents=_parents(numbers["kintree_table"], path),
        faces=faces,
    )


def _checked_numbers(array: np.ndarray, name: str, path: Path) -> np.ndarray:
    if array.dtype.kind not in "fiu":
        raise FormatError(f"{path}: {name} should hold numbers, holds {array.dtype}")
    MODEL_NUMBERS.check(array.size, path, name)
    array = np.ascontiguousarray(array, np.float64)
    if not np.isfinite(array).all():
        raise FormatError(f"{path}: {name} holds nan or infinite numbers")
    if name in _RANGES:
        _RANGES[name].check(array, path, name)
    return array


def _parents(table: np.ndarray, path: Path) -> np.ndarray:
    """Read each joint's parent from `kintree_table`, where 4294967295 (unsigned -1) means none."""
    parents = table[0].astype(np.int64)
    parents[0] = -1
    if tuple(parents[: len(JOINTS)]) != tuple(PARENTS):
        raise FormatError(
            f"{path}: its first {len(JOINTS)} joints are not SMPL's; a model of a hand, a head or "
            "an animal cannot be used as a body"
        )
    if (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, len(parents))).any():
        raise FormatError(f"{path}: a joint comes before its parent in kintree_table")
    return parents


def _without_expressions(directions: np.ndarray, joints: int) -> np.ndarray:
    count = directions.shape[2]
    if joints == _SMPLX_JOINTS:
        count = 10 if count == 20 else min(count, _SMPLX_SHAPES)
    return np.ascontiguousarray(directions[:, :, :count])


def _pose_correctives(
    fields: Mapping[str, np.ndarray], vertices: int, joints: int, path: Path
) -> np.ndarray | None:
    if "posedirs" not in fields:
        return None
    directions = _checked_numbers(fields["posedirs"], "posedirs", path)
    shape = (vertices, 3, 9 * (joints - 1))
    if directions.shape != shape:
        raise FormatError(
            f"{path}: posedirs should be {shape}, is {directions.shape}; models with other "
            "correctives (STAR) are not supported"
        )
    return directions if directions.any() else None


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read only the needed arrays of an .npz model, and none of its pickled objects."""
    try:
        check_sizes(path, BINARY, _USED)
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in _USED if name in file.files}
    except DAMAGE as error:
        raise FormatError(
            f"{path}: expected an .npz body model of plain arrays, but {error}"
        ) from error
