"""Reads arrays from .npz and .npy files that may be damaged or hostile."""

import lzma
import tokenize
import zipfile
import zlib
from collections.abc import Container
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, MASKS, PAYLOAD, Limit

DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, KeyError, OSError, ValueError,
    NotImplementedError, RuntimeError, MemoryError, TypeError, SyntaxError, OverflowError,
    tokenize.TokenError, AttributeError, IndexError, AssertionError,
)  # fmt: skip
"""Exceptions that zipfile and numpy raise on damaged or hostile archives."""
HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""NumPy's readers of the headers of arrays, by version of the format .npy."""
_PACKED = (
    "recordings shrink to a fifth when compressed; this file seems to hold only zeros: save it "
    "uncompressed"
)
_LONGEST_TEXT = 1 << 20
"""Most bytes of one text in an array; recon saves names and settings as texts."""
_MEMBERS = 1000
"""Most arrays that an archive may have; those of recon have about twenty."""


def limit_when_unpacked(path: Path, limit: Limit) -> Limit:
    """Return the limit of a file's unpacked bytes: fifty times its size, but 64 MB at least.

    Zeros are packed to a thousandth of their size, so that a small file could fill the memory.
    """
    most = float(max(1 << 26, 50 * path.stat().st_size))
    return limit if most >= limit.high else replace(limit, high=most, reason=_PACKED)


def check_sizes(
    path: Path, limit: Limit = PAYLOAD, only: tuple[str, ...] | None = None
) -> list[str]:
    """Return the names of an archive's arrays; refuse one that is damaged or too large for memory.

    Both a compressed bomb and a header that promises more than the file holds are found here,
    before memory is taken for them. A single object that is no array (AMASS keeps a dictionary
    beside its arrays) is left out and never unpickled.

    Args:
        path: of the .npz file.
        limit: for the bytes of all arrays together.
        only: names of the arrays that will be read; None for all.

    Raises:
        ValueError: when they are too large or a header is damaged.
        zipfile.BadZipFile: when it is no archive; numpy and zipfile raise others for damage.
    """
    total, names = 0, []
    # empty masks pack so well that a limit of 50 times the file's size would refuse sound files
    limit = limit if limit is MASKS else limit_when_unpacked(path, limit)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > _MEMBERS:
            raise FormatError(f"{path}: expected at most {_MEMBERS} arrays, got {len(members)}")
        for info in members:
            name = info.filename.removesuffix(".npy")
            if only is not None and name not in only:
                continue
            if not info.filename.endswith(".npy"):
                names.append(name)
                total += info.file_size
                limit.check(total, path, name)
                continue
            shape, dtype, place = _shape_dtype_header(archive, info)
            if dtype.hasobject:
                continue
            if dtype.kind in "US" and dtype.itemsize > _LONGEST_TEXT:
                raise FormatError(f"{path}: expected short texts, got one of {dtype} in {name}")
            names.append(name)
            stated = int(np.prod([float(n) for n in shape])) * dtype.itemsize
            if place + stated != info.file_size:
                raise FormatError(
                    f"{path}: {name} promises {dtype} {shape}, {stated} bytes, but holds "
                    f"{info.file_size - place}"
                )
            # every number is later stored in at least four bytes
            total += max(info.file_size, 4 * int(np.prod([float(n) for n in shape])))
            limit.check(total, path, name)
    return names


def _shape_dtype_header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype, int]:
    """Read shape and dtype of one array in an archive, and the length of its header in bytes."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in HEADERS:
            raise FormatError(f"{info.filename} is an array of the unknown version {version}")
        shape, _, dtype = HEADERS[version](member)
        if dtype.hasobject and shape:
            raise FormatError(f"{info.filename} holds pickled objects, which are never opened")
        return shape, dtype, member.tell()


_QUOTED = 200
"""Most characters of another library's error in ours: some quote the whole damaged file."""


def files_of(folder: Path, endings: Container[str] | None = None) -> list[Path]:
    """List files directly in a folder, sorted by name, without hidden ones that systems add.

    Args:
        folder: an existing folder.
        endings: of the files to list, in lower case with a dot; None takes all.
    """
    seen = (one for one in folder.iterdir() if one.is_file() and not one.name.startswith("."))
    return sorted(one for one in seen if endings is None or one.suffix.lower() in endings)


def existing_file(path: Path) -> Path:
    """Return the given path after a check that it is an existing file with contents.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty or no file.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise FormatError(f"{path}: expected a file, got a directory or device")
    if path.stat().st_size == 0:
        raise FormatError(f"{path}: the file is empty")
    return path


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read all arrays of an .npz file; pickled objects are never opened.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, too large or needs pickle.
    """
    existing_file(path)
    try:
        names = check_sizes(path)
        with np.load(path, allow_pickle=False) as file:
            if not names and file.files:
                raise FormatError(
                    f"{', '.join(file.files)}: Python objects, which are never opened; save each "
                    "as a plain array"
                )
            arrays = {key: file[key] for key in names}
        if foreign := [key for key, value in arrays.items() if not isinstance(value, np.ndarray)]:
            raise FormatError(f"{', '.join(foreign)} are not arrays")
        return arrays
    except DAMAGE as error:
        raise FormatError(
            f"{path}: expected an .npz file of plain arrays, but it cannot be read "
            f"({error!s:.{_QUOTED}})"
        ) from error


def load_array(path: Path) -> np.ndarray:
    """Read the array of an .npy file; pickled objects are never opened.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, too large or needs pickle.
    """
    existing_file(path)
    BINARY.check(path.stat().st_size, path)
    try:
        return np.load(path, allow_pickle=False)
    except DAMAGE as error:
        raise FormatError(
            f"{path}: expected an .npy file with a plain array, but it cannot be read "
            f"({error!s:.{_QUOTED}})"
        ) from error
