"""Opening files that may be damaged, and writing arrays in one step."""

import lzma
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, TEXT, Limit
from recon.formats.files.npz_headers import DAMAGE, check_sizes
from recon.formats.files.replacing import clear_leftovers
from recon.formats.files.replacing import replacing as replacing

_SAID = 200
"""Letters of another library's error that are repeated: some quote the whole damaged file."""


def existing(path: Path) -> Path:
    """The path of a file that is there and not empty.

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


def read_bytes(path: Path, limit: Limit = TEXT) -> bytes:
    """Contents of a file, unpacked when its name ends in .xz; `read_binary` for larger ones.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, damaged or too large for memory.
    """
    existing(path)
    if path.suffix.lower() != ".xz":
        limit.check(path.stat().st_size, path)
        return path.read_bytes()
    most = min(limit, TEXT, key=lambda one: one.high)
    try:
        with lzma.open(path) as file:
            data = file.read(int(most.high) + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise FormatError(f"{path}: expected xz-compressed data, but {error}") from error
    most.check(len(data), path)
    return data


def read_binary(path: Path) -> bytes:
    """Contents of a file whose numbers take no more memory than the file."""
    return read_bytes(path, BINARY)


def decode(data: bytes) -> str:
    """Text of a recording: UTF-8, else Latin-1 (old tools wrote the local code page)."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an .npz file; pickled objects are never opened.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, too large or needs pickle.
    """
    existing(path)
    try:
        check_sizes(path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        if foreign := [key for key, value in arrays.items() if not isinstance(value, np.ndarray)]:
            raise FormatError(f"no arrays: {', '.join(foreign)}")
        return arrays
    except DAMAGE as error:
        raise FormatError(
            f"{path}: expected an .npz file of plain arrays, but it cannot be read "
            f"({error!s:.{_SAID}})"
        ) from error


def load_array(path: Path) -> np.ndarray:
    """The array of an .npy file; pickled objects are never opened.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, too large or needs pickle.
    """
    existing(path)
    BINARY.check(path.stat().st_size, path)
    try:
        return np.load(path, allow_pickle=False)
    except DAMAGE as error:
        raise FormatError(
            f"{path}: expected an .npy file with a plain array, but it cannot be read "
            f"({error!s:.{_SAID}})"
        ) from error


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write an .npz file; readers see the old file or the whole new one."""
    clear_leftovers(path)
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]
