"""Reads pickles of arrays without running their code: only listed functions are called."""

import pickle
import struct
import zlib
from collections import OrderedDict
from collections.abc import Mapping
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, DEPTH, ENTRIES, MODEL_NUMBERS
from recon.formats.opening import DAMAGE, HEADERS, limit_when_unpacked


def read_tree(path: Path) -> dict[Any, Any]:
    """Read a pickled dictionary of arrays and plain containers without running its code.

    Raises:
        ValueError: when the file is damaged, or names anything that is not on the list.
    """
    with path.open("rb") as file:
        content = read_pickle(file, path)
    if not isinstance(content, dict):
        raise FormatError(f"{path}: expected a dictionary of arrays, got {type(content).__name__}")
    return content


def read_pickle(file: BinaryIO, path: Path) -> object:
    """Read the pickle at the position of an open file, without running its code.

    From an .npy file of objects, return the objects in lists.

    Raises:
        ValueError: when the file is damaged, or names anything that is not on the list.
    """
    try:
        BINARY.check(path.stat().st_size, path)
        data = _decompressed(file.read(), path)
        kind = _JoblibUnpickler if b"joblib.numpy_pickle" in data else _Unpickler
        source = BytesIO(data)
        if array := data.startswith(_MAGIC):
            HEADERS[np.lib.format.read_magic(source)](source)
        # most files are from Python 2, whose strings are bytes: latin-1 decodes them without loss
        content = kind(source, encoding="latin1").load()
        if array and isinstance(content, np.ndarray):
            content = content.tolist()
    except _ForbiddenNameError as error:
        raise FormatError(
            f"{path}: refusing to load {error}, which no body model and no list of poses "
            "contains; nothing in the file was run"
        ) from None
    except (
        *DAMAGE, pickle.UnpicklingError, SystemError, ImportError, NameError, struct.error,
    ) as error:  # fmt: skip
        # errors that damaged pickles raise, according to the documentation of `pickle`
        raise FormatError(
            f"{path}: expected a pickled dictionary of arrays, but {error!r:.200}"
        ) from error
    if isinstance(content, dict | list | tuple):
        check_tree_limits(content, path)
    return content


def plain_array(value: object, name: str, path: Path) -> np.ndarray:
    """Convert a value of an unpickled tree to an array, also chumpy's and scipy's records.

    Raises:
        ValueError: when it is no array, damaged, or has more numbers than a body model.
    """
    try:
        array = _unwrapped(value)
    except (
        KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError,
    ) as error:  # fmt: skip
        raise FormatError(f"{path}: cannot read {name}: {error!r:.200}") from error
    if isinstance(array, np.ndarray):
        MODEL_NUMBERS.check(array.size, path, name)
        return array
    raise FormatError(f"{path}: {name} should be an array, is {type(value).__name__}")


class _InertObject:
    """Placeholder for a pickled object of any library: keeps its state and runs nothing."""

    state: Mapping[str, Any]

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict):
            raise TypeError(f"expected the state of an object as a dictionary, got {type(state)}")
        self.state = state


class _Chumpy(_InertObject):
    """A pickled chumpy.Ch with its array `x`, or chumpy's Select of entries `idxs` of `a`."""

    def value(self) -> object:
        if "x" in self.state:
            return _unwrapped(self.state["x"])
        picked = np.asarray(_unwrapped(self.state["a"])).reshape(-1)[
            np.asarray(self.state["idxs"])
        ]
        return picked.reshape(tuple(self.state.get("preferred_shape", picked.shape)))


class _CompressedRows(_InertObject):
    """A pickled scipy.sparse.csr_matrix; repeated entries add up."""

    def value(self) -> np.ndarray:
        return self._dense_matrix(*(int(size) for size in self.state["_shape"]))

    def _dense_matrix(self, lines: int, length: int) -> np.ndarray:
        """Expand compressed rows to the full matrix."""
        MODEL_NUMBERS.check(lines * length, "a sparse matrix", "its shape")
        if min(lines, length) < 0:
            raise FormatError(f"a sparse matrix has the negative shape {lines} x {length}")
        dense = np.zeros((lines, length))
        starts = np.asarray(self.state["indptr"], np.int64)
        if len(starts) != lines + 1 or starts[-1] != len(self.state["data"]):
            raise FormatError(f"the row pointers of a sparse matrix do not fit its {lines} rows")
        line = np.repeat(np.arange(lines), np.diff(starts))
        columns, numbers = np.asarray(self.state["indices"]), np.asarray(self.state["data"])
        np.add.at(dense, (line, columns), numbers)
        return dense


class _CompressedColumns(_CompressedRows):
    """A pickled scipy.sparse.csc_matrix."""

    def value(self) -> np.ndarray:
        rows, columns = (int(size) for size in self.state["_shape"])
        return self._dense_matrix(columns, rows).T


def _unwrapped(value: object) -> object:
    return value.value() if isinstance(value, _Chumpy | _CompressedRows) else value


def _latin_bytes(text: str, encoding: str = "latin1") -> bytes:
    """Replacement for codecs.encode, by which Python 3 pickles bytes: allows latin-1 alone."""
    if encoding not in ("latin1", "latin-1"):
        raise FormatError(f"expected text in latin-1, got the encoding {encoding!r}")
    return text.encode("latin-1")


def _empty_array(kind: type, shape: tuple[int, ...], type_code: object) -> np.ndarray:
    """Replacement for the function that makes the empty array which numpy's pickles then fill.

    Only size zero is allowed.
    """
    if kind is not np.ndarray or tuple(shape) != (0,):
        raise TypeError(f"expected an array that begins empty, got {shape}, {type_code!r:.20}")
    return np.ndarray.__new__(np.ndarray, (0,), "b")


def _safe_bytes(value: object = b"", *encoding: str) -> bytes:
    """Replacement for `bytes` that refuses numbers, which would allocate memory."""
    if isinstance(value, str):
        return _latin_bytes(value, *encoding)
    if not isinstance(value, bytes | bytearray | list | tuple):
        raise TypeError(f"expected bytes or a list of them, got {type(value).__name__}")
    return bytes(value)


def _inert_record(kind: type, base: type, state: object) -> object:
    """Replacement for copyreg._reconstructor that makes nothing but an `_InertObject`."""
    if not issubclass(kind, _InertObject) or base is not object:
        raise TypeError(f"expected a record without code, got one of the type {kind.__name__}")
    del state
    return kind.__new__(kind)


def _torch_storage(data: bytes) -> Any:
    """Replacement for the function with which torch reads the numbers of a pickled tensor."""
    import torch

    if data.startswith(b"PK"):
        raise _ForbiddenNameError("a tensor stored as a zip archive within a pickle")
    return torch.load(BytesIO(data), map_location="cpu", weights_only=True)


def _array_of_tensor(
    storage: Any, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *rest: object
) -> np.ndarray:
    """Replacement for the function that builds a pickled torch tensor; returns an array."""
    import torch

    del rest
    numbers = torch.empty(0, dtype=storage.dtype).set_(storage)
    if prod(shape) > len(numbers):
        raise _ForbiddenNameError(f"a tensor of shape {shape} with only {len(numbers)} numbers")
    return numbers.as_strided(shape, strides, offset).numpy()


class _JoblibArray(_InertObject):
    """Joblib's record of an array, whose bytes follow the record in the file."""

    def read(self, file: BytesIO) -> np.ndarray:
        """Read the array's numbers from the file, which is positioned behind this record."""
        shape, dtype = tuple(map(int, self.state["shape"])), self.state["dtype"]
        if not isinstance(dtype, np.dtype) or dtype.hasobject:
            raise _ForbiddenNameError("an array of pickled objects")
        MODEL_NUMBERS.check(prod(shape), "an array of joblib", "its shape")
        if self.state.get("numpy_array_alignment_bytes") is not None:
            file.read(file.read(1)[0])
        flat = np.frombuffer(file.read(prod(shape) * dtype.itemsize), dtype)
        return flat.reshape(shape, order="F" if self.state["order"] == "F" else "C").copy()


_MAGIC = b"\x93NUMPY"
_NUMPY = ("numpy.core", "numpy._core")
"""Packages in NumPy 1 and 2 whose functions pickled arrays name."""
_BUILTINS = ("__builtin__", "builtins")
"""Names of the module of built-in types in Python 2 and 3."""
_CONTAINERS = (object, set, frozenset, dict, list, tuple, slice, int, float, bool)
_ALLOWED: dict[tuple[str, str], object] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    **{(f"{core}.multiarray", "_reconstruct"): _empty_array for core in _NUMPY},
    **{(f"{core}.multiarray", "scalar"): np.float64(0).__reduce__()[0] for core in _NUMPY},
    **{(f"{core}.numeric", "_frombuffer"): np.zeros(1).__reduce_ex__(5)[0] for core in _NUMPY},
    **{(module, kind.__name__): kind for module in _BUILTINS for kind in _CONTAINERS},
    **{(module, kind): _safe_bytes for module in _BUILTINS for kind in ("bytes", "bytearray")},
    ("_codecs", "encode"): _latin_bytes,
    ("copy_reg", "_reconstructor"): _inert_record,
    ("copyreg", "_reconstructor"): _inert_record,
    ("collections", "OrderedDict"): OrderedDict,
    ("joblib.numpy_pickle", "NumpyArrayWrapper"): _JoblibArray,
    ("torch.storage", "_load_from_bytes"): _torch_storage,
    ("torch._utils", "_rebuild_tensor_v2"): _array_of_tensor,
    ("chumpy.ch", "Ch"): _Chumpy,
    ("chumpy", "Ch"): _Chumpy,
    ("chumpy.reordering", "Select"): _Chumpy,
    ("scipy.sparse.csc", "csc_matrix"): _CompressedColumns,
    ("scipy.sparse._csc", "csc_matrix"): _CompressedColumns,
    ("scipy.sparse.csr", "csr_matrix"): _CompressedRows,
    ("scipy.sparse._csr", "csr_matrix"): _CompressedRows,
}
"""Allowed classes and functions in pickles, or their replacements, by module and name."""


class _ForbiddenNameError(Exception):
    """A pickle names a class or function that is not allowed."""


class _Unpickler(pickle.Unpickler):
    """An unpickler that allows only the names in `_ALLOWED`."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        if (module_name, global_name) not in _ALLOWED:
            raise _ForbiddenNameError(f"{module_name}.{global_name}")
        return _ALLOWED[module_name, global_name]


_PythonUnpickler: Any = vars(pickle)["_Unpickler"]
"""The unpickler in Python; the one in C reads ahead, past the bytes of joblib's arrays."""


class _JoblibUnpickler(_PythonUnpickler):
    """An unpickler of the names in `_ALLOWED` that also reads joblib's arrays."""

    def __init__(self, file: BytesIO, *, encoding: str) -> None:
        super().__init__(file, encoding=encoding)
        self.array_source = file

    find_class = _Unpickler.find_class

    def load_build(self) -> None:
        super().load_build()
        if isinstance(self.stack[-1], _JoblibArray):
            self.stack[-1] = self.stack[-1].read(self.array_source)

    dispatch: ClassVar = {**_PythonUnpickler.dispatch, pickle.BUILD[0]: load_build}


def _decompressed(data: bytes, path: Path) -> bytes:
    """Decompress a file that joblib compressed (zlib or gzip); other data stay as they are."""
    if not data.startswith((b"x\x01", b"x^", b"x\x9c", b"x\xda", b"\x1f\x8b")):
        return data
    most = limit_when_unpacked(path, BINARY)
    content = zlib.decompressobj(32 + zlib.MAX_WBITS).decompress(data, int(most.high) + 1)
    most.check(len(content), path)
    return content


def check_tree_limits(content: Any, path: Path) -> None:
    """Refuse containers that are nested deeply, hold themselves, or have too many entries.

    A container that several others share counts for each of them, as a walk through the tree
    meets it that often: thirty lists of two entries can make a thousand million.

    Raises:
        ValueError: when there are more entries or levels than `recon.core.limits` allows.
    """
    level, count, depth = {id(content): (content, 1)}, 0, 0
    while level:
        depth, count = depth + 1, count + sum(times * len(one) for one, times in level.values())
        DEPTH.check(depth, path)
        ENTRIES.check(count, path)
        below: dict[int, tuple[Any, int]] = {}
        for one, times in level.values():
            for child in one.values() if isinstance(one, Mapping) else one:
                if isinstance(child, Mapping | list | tuple | set | frozenset):
                    below[id(child)] = (child, below.get(id(child), (child, 0))[1] + times)
        level = below
