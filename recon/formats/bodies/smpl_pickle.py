"""Reads the pickles of body models without executing what is inside.

An unpickler with a list: numpy arrays and plain containers are built; scipy's sparse matrices and
chumpy's wrappers become inert records that are turned into arrays here. Any other name in the
file is refused.
"""

import pickle
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, MODEL_NUMBERS


def read_pickle(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The named arrays of a pickled dictionary, those that are there; nothing is run.

    Raises:
        ValueError: when the file is damaged, or names anything that is not on the list.
    """
    content = read_tree(path)
    return {name: _array(content[name], name, path) for name in names if name in content}


def read_tree(path: Path) -> dict[Any, Any]:
    """A pickled dictionary of arrays, plain containers and inert records; nothing is run.

    Raises:
        ValueError: when the file is damaged, or names anything that is not on the list.
    """
    try:
        # Python 2 wrote most of these files: its strings are bytes, kept one to one by latin-1
        BINARY.check(path.stat().st_size, path)
        with path.open("rb") as file:
            content = _Unpickler(file, encoding="latin1").load()
    except _RefusedError as error:
        raise FormatError(
            f"{path}: refusing to load {error.name}, which no body model and no list of poses "
            "contains; nothing in the file was run"
        ) from None
    except (
        pickle.UnpicklingError, EOFError, AttributeError, IndexError, KeyError, TypeError,
        ValueError, MemoryError, OverflowError, RuntimeError, ImportError, AssertionError,
        SystemError,
    ) as error:  # fmt: skip
        # the pickle documentation names these for damaged files
        raise FormatError(
            f"{path}: expected a pickled dictionary of arrays, but {error!r:.200}"
        ) from error
    if not isinstance(content, dict):
        raise FormatError(f"{path}: expected a dictionary of arrays, got {type(content).__name__}")
    return content


def _array(value: object, name: str, path: Path) -> np.ndarray:
    try:
        array = _plain(value)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise FormatError(f"{path}: cannot read {name}: {error!r:.200}") from error
    if isinstance(array, np.ndarray):
        MODEL_NUMBERS.check(array.size, path, name)
        return array
    raise FormatError(f"{path}: {name} should be an array, is {type(value).__name__}")


class _Inert:
    """Stands for an object of a library that is not needed; keeps its state and does nothing."""

    state: Mapping[str, Any]

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict):
            raise TypeError(f"expected the state of an object as a dictionary, got {type(state)}")
        self.state = state


class _Chumpy(_Inert):
    """chumpy.Ch holds its array as `x`; chumpy's Select picks entries `idxs` of another, `a`."""

    def value(self) -> object:
        if "x" in self.state:
            return _plain(self.state["x"])
        picked = np.asarray(_plain(self.state["a"])).reshape(-1)[np.asarray(self.state["idxs"])]
        return picked.reshape(tuple(self.state.get("preferred_shape", picked.shape)))


class _CompressedColumns(_Inert):
    """scipy.sparse.csc_matrix."""

    def value(self) -> np.ndarray:
        rows, columns = (int(size) for size in self.state["_shape"])
        return _dense(self.state, columns, rows).T


class _CompressedRows(_Inert):
    """scipy.sparse.csr_matrix."""

    def value(self) -> np.ndarray:
        rows, columns = (int(size) for size in self.state["_shape"])
        return _dense(self.state, rows, columns)


def _dense(state: Mapping[str, Any], lines: int, length: int) -> np.ndarray:
    """Compressed lines as a full matrix; entries named twice add up."""
    MODEL_NUMBERS.check(lines * length, "a sparse matrix", "its shape")
    if min(lines, length) < 0:
        raise FormatError(f"a sparse matrix of shape {lines} x {length}")
    dense = np.zeros((lines, length))
    starts = np.asarray(state["indptr"], np.int64)
    line = np.repeat(np.arange(lines), np.diff(starts))
    np.add.at(dense, (line, np.asarray(state["indices"])), np.asarray(state["data"]))
    return dense


def _plain(value: object) -> object:
    if isinstance(value, _Chumpy | _CompressedColumns | _CompressedRows):
        return value.value()
    return value


def _latin_bytes(text: str, encoding: str = "latin1") -> bytes:
    """How Python 3 pickles bytes for Python 2; no other codec is looked up."""
    if encoding not in ("latin1", "latin-1"):
        raise FormatError(f"unexpected text encoding {encoding!r}")
    return text.encode("latin-1")


def _empty(kind: type, shape: tuple[int, ...], code: object) -> np.ndarray:
    """What numpy begins an array with, which is of size zero; a larger one only takes memory."""
    if kind is not np.ndarray or tuple(shape) != (0,):
        raise TypeError(f"unexpected array of shape {shape}, {code!r:.20}")
    return np.ndarray.__new__(np.ndarray, (0,), "b")


def _some_bytes(value: object = b"", *encoding: str) -> bytes:
    """Bytes of bytes or text; of a number they would only take memory."""
    if isinstance(value, str):
        return _latin_bytes(value, *encoding)
    if not isinstance(value, bytes | bytearray | list | tuple):
        raise TypeError(f"unexpected bytes of {type(value).__name__}")
    return bytes(value)


def _bare(kind: type, base: type, state: object) -> object:
    """copyreg._reconstructor for records without a built-in base."""
    if not issubclass(kind, _Inert) or base is not object:
        raise TypeError(f"unexpected record of type {kind.__name__}")
    del state
    return kind.__new__(kind)


def _numpy_names() -> dict[tuple[str, str], object]:
    """What numpy's own pickles refer to, under the module names of numpy 1 and 2."""
    frombuffer = np.zeros(1).__reduce_ex__(5)[0]
    scalar = np.float64(0).__reduce__()[0]
    names: dict[tuple[str, str], object] = {
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }
    for core in ("numpy.core", "numpy._core"):
        names[f"{core}.multiarray", "_reconstruct"] = _empty
        names[f"{core}.multiarray", "scalar"] = scalar
        names[f"{core}.numeric", "_frombuffer"] = frombuffer
    return names


def _builtin_names() -> dict[tuple[str, str], object]:
    """Plain containers and numbers, under the names of Python 2 and 3."""
    kinds = (object, set, frozenset, dict, list, tuple, slice, int, float, bool)
    modules = ("builtins", "__builtin__")
    names: dict[tuple[str, str], object] = {
        (module, kind.__name__): kind for module in modules for kind in kinds
    }
    return names | {(m, kind): _some_bytes for m in modules for kind in ("bytes", "bytearray")}


_ALLOWED: dict[tuple[str, str], object] = {
    **_numpy_names(),
    **_builtin_names(),
    ("_codecs", "encode"): _latin_bytes,
    ("copy_reg", "_reconstructor"): _bare,
    ("copyreg", "_reconstructor"): _bare,
    ("collections", "OrderedDict"): OrderedDict,
    ("chumpy.ch", "Ch"): _Chumpy,
    ("chumpy", "Ch"): _Chumpy,
    ("chumpy.reordering", "Select"): _Chumpy,
    ("scipy.sparse.csc", "csc_matrix"): _CompressedColumns,
    ("scipy.sparse._csc", "csc_matrix"): _CompressedColumns,
    ("scipy.sparse.csr", "csr_matrix"): _CompressedRows,
    ("scipy.sparse._csr", "csr_matrix"): _CompressedRows,
}


class _RefusedError(Exception):
    """A pickle named something that is not on the list."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class _Unpickler(pickle.Unpickler):
    """Knows the names in `_ALLOWED` and no others."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        try:
            return _ALLOWED[module_name, global_name]
        except KeyError:
            raise _RefusedError(f"{module_name}.{global_name}") from None
