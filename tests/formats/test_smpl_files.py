"""Model files of the SMPL family, made up here: what comes out is what was put in."""

import os
import pickle
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse

from recon.core.skeleton import PARENTS
from recon.formats.smpl import load_smpl

VERTICES = 40


def parents(joints: int) -> np.ndarray:
    table = np.zeros((2, joints), np.uint32)
    table[1] = np.arange(joints)
    table[0, :22] = np.array(PARENTS, np.int64).astype(np.uint32)
    table[0, 22:] = 20
    return table


def model(joints: int = 24, shapes: int = 10) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(joints)
    weights, regressor = rng.random((VERTICES, joints)), rng.random((joints, VERTICES))
    return {
        "v_template": rng.normal(size=(VERTICES, 3)),
        "shapedirs": rng.normal(size=(VERTICES, 3, shapes)),
        "posedirs": rng.normal(size=(VERTICES, 3, 9 * (joints - 1))),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": parents(joints),
        "f": rng.integers(0, VERTICES, (30, 3)).astype(np.uint32),
    }


def write(path: Path, fields: dict[str, object], protocol: int = 2) -> Path:
    path.write_bytes(pickle.dumps(fields, protocol=protocol))
    return path


def check(path: Path, fields: dict[str, np.ndarray], shapes: int = 10) -> None:
    arrays = load_smpl(path)
    assert np.array_equal(arrays.template, fields["v_template"])
    assert np.array_equal(arrays.shape_directions, fields["shapedirs"][..., :shapes])
    assert np.array_equal(arrays.joint_regressor, fields["J_regressor"])
    assert np.array_equal(arrays.weights, fields["weights"])
    assert arrays.pose_directions is not None
    assert np.array_equal(arrays.pose_directions, fields["posedirs"])
    assert tuple(arrays.parents[:22]) == PARENTS
    assert np.array_equal(arrays.faces, fields["f"])


@pytest.mark.parametrize(
    ("joints", "stored", "shapes"),
    [(24, 10, 10), (24, 300, 300), (52, 16, 16), (55, 20, 10), (55, 400, 300), (55, 16, 16)],
)
def test_npz_round_trip_without_expressions(tmp_path, joints, stored, shapes):
    fields = model(joints, stored)
    objects = np.array([{"a": 1}], dtype=object)  # SMPL-X carries such tables; they stay closed
    np.savez(tmp_path / "body.npz", joint2num=objects, **fields)
    check(tmp_path / "body.npz", fields, shapes)


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("sparse", [scipy.sparse.csc_matrix, scipy.sparse.csr_matrix])
def test_pickle_round_trip(tmp_path, protocol, sparse):
    fields = model()
    stored = fields | {"J_regressor": sparse(fields["J_regressor"]), "bs_style": "lbs"}
    check(write(tmp_path / "body.pkl", stored, protocol), fields)


@pytest.fixture
def chumpy(monkeypatch):
    """A stand-in for chumpy that pickles as the real one does."""
    root, ch, reordering = (
        types.ModuleType(name) for name in ("chumpy", "chumpy.ch", "chumpy.reordering")
    )
    for module, name in ((ch, "Ch"), (reordering, "Select")):
        kind = type(name, (), {"__module__": module.__name__})
        setattr(module, name, kind)
    for module in (root, ch, reordering):
        monkeypatch.setitem(sys.modules, module.__name__, module)

    def wrap(kind, **state):
        wrapped = kind()
        wrapped.__dict__.update(state)
        return wrapped

    return types.SimpleNamespace(
        ch=lambda x: wrap(ch.Ch, x=x, _dirty_vars=set(), _itr=None),
        select=lambda a, idxs, shape: wrap(
            reordering.Select, a=a, idxs=idxs, preferred_shape=shape
        ),
    )


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_chumpy_wrappers_are_read_without_chumpy(tmp_path, chumpy, monkeypatch, protocol):
    fields = model()
    all_shapes = np.random.default_rng(0).normal(size=(VERTICES, 3, 300))
    picked = np.arange(all_shapes.size).reshape(all_shapes.shape)[..., :10].reshape(-1)
    fields["shapedirs"] = all_shapes[..., :10]
    stored = fields | {
        "shapedirs": chumpy.select(chumpy.ch(all_shapes), picked, (VERTICES, 3, 10)),
        "posedirs": chumpy.ch(fields["posedirs"]),
    }
    path = write(tmp_path / "body.pkl", stored, protocol)
    for name in ("chumpy", "chumpy.ch", "chumpy.reordering"):
        monkeypatch.delitem(sys.modules, name)
    check(path, fields)


class Hostile:
    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize(
    ("function", "refused"),
    [(os.system, r"(posix|nt)\.system"), (eval, r"builtin\w*\.eval"), (getattr, r"getattr")],
)
@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_hostile_pickle_is_refused_and_not_run(tmp_path, function, refused, protocol):
    target = tmp_path / "owned"
    command = f"open({str(target)!r}, 'w')" if function is eval else f"touch {target}"
    arguments = (command, "x") if function is getattr else (command,)
    path = write(tmp_path / "body.pkl", model() | {"v": Hostile(function, *arguments)}, protocol)
    with pytest.raises(ValueError, match=f"refusing to load .*{refused}"):
        load_smpl(path)
    assert not target.exists()


def test_other_modules_of_known_packages_are_refused(tmp_path):
    for line in ("cnumpy\nload\n", "cscipy.io\nloadmat\n", "cchumpy.utils\nrun\n", "cos\nabort\n"):
        path = tmp_path / "body.pkl"
        path.write_bytes(line.encode() + b".")
        with pytest.raises(ValueError, match="refusing to load"):
            load_smpl(path)


def test_zero_correctives_are_left_out(tmp_path):
    fields = model()
    fields["posedirs"][:] = 0.0
    np.savez(tmp_path / "body.npz", **fields)
    assert load_smpl(tmp_path / "body.npz").pose_directions is None
    del fields["posedirs"]
    np.savez(tmp_path / "body.npz", **fields)
    assert load_smpl(tmp_path / "body.npz").pose_directions is None


def broken(name: str, value: np.ndarray) -> dict[str, np.ndarray]:
    return model() | {name: value}


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"trans": np.zeros(3)}, "not a body model of the SMPL family: no v_template"),
        (broken("J_regressor", np.zeros((24, 3))), "J_regressor should be"),
        (broken("posedirs", np.zeros((VERTICES, 3, 93))), "STAR"),
        (broken("f", np.full((4, 3), VERTICES)), "vertices outside"),
        (broken("weights", np.full((VERTICES, 24), np.nan)), "nan or infinite"),
        (broken("kintree_table", np.zeros((2, 24), np.uint32)), "not SMPL's"),
        (broken("v_template", np.full((VERTICES, 3), "x")), "should hold numbers"),
    ],
)
def test_what_is_no_body_is_refused(tmp_path, fields, complaint):
    np.savez(tmp_path / "body.npz", **fields)
    with pytest.raises(ValueError, match=complaint):
        load_smpl(tmp_path / "body.npz")


@pytest.mark.parametrize("name", ["body.pkl", "body.npz"])
@pytest.mark.parametrize(
    "content", [b"", b"not a model", b"\x80\x02}q\x00.", b"PK\x03\x04", b"N."]
)
def test_damaged_files_are_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=name):
        load_smpl(tmp_path / name)


def test_truncated_files_are_refused(tmp_path):
    whole = write(tmp_path / "whole.pkl", model()).read_bytes()
    for part in range(1, len(whole), len(whole) // 23):
        (tmp_path / "part.pkl").write_bytes(whole[:part])
        with pytest.raises(ValueError, match=r"part\.pkl"):
            load_smpl(tmp_path / "part.pkl")


def test_a_missing_file_says_where_to_get_one(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"smpl-x\.is\.tue\.mpg\.de.*bundled body"):
        load_smpl(tmp_path / "SMPLH_NEUTRAL.npz")
    (tmp_path / "body.obj").write_text("v 0 0 0")
    with pytest.raises(ValueError, match=r"\.npz or \.pkl"):
        load_smpl(tmp_path / "body.obj")
