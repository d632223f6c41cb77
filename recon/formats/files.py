"""Opening files that may be damaged, and writing arrays in one step."""

import lzma
import zipfile
import zlib
from pathlib import Path

import numpy as np

from recon.replacing import clear_leftovers
from recon.replacing import replacing as replacing

TEXT_LIMIT = 1 << 30
"""Bytes a compressed recording may unpack to; more is taken for a bomb."""
ARRAY_LIMIT = 1 << 33
"""Bytes the arrays of one file may unpack to."""


def existing(path: Path) -> Path:
    """The path of a file that is there and not empty.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty or no file.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise ValueError(f"{path}: expected a file, got a directory or device")
    if path.stat().st_size == 0:
        raise ValueError(f"{path}: the file is empty")
    return path


def read_bytes(path: Path) -> bytes:
    """Contents of a file, unpacked when its name ends in .xz.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, damaged or unreasonably large.
    """
    existing(path)
    if path.suffix.lower() != ".xz":
        if path.stat().st_size > TEXT_LIMIT:
            raise ValueError(f"{path}: larger than {TEXT_LIMIT >> 20} MiB; cut the recording")
        return path.read_bytes()
    try:
        with lzma.open(path) as file:
            data = file.read(TEXT_LIMIT + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(f"{path}: expected xz-compressed data, but {error}") from error
    if len(data) > TEXT_LIMIT:
        raise ValueError(f"{path}: unpacks to more than {TEXT_LIMIT >> 20} MiB; cut the recording")
    return data


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
        with zipfile.ZipFile(path) as archive:
            if sum(info.file_size for info in archive.infolist()) > ARRAY_LIMIT:
                raise ValueError(f"{path}: unpacks to more than {ARRAY_LIMIT >> 30} GiB")
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        if foreign := [key for key, value in arrays.items() if not isinstance(value, np.ndarray)]:
            raise ValueError(f"no arrays: {', '.join(foreign)}")
        return arrays
    except (
        zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, KeyError, OSError, ValueError,
        NotImplementedError, RuntimeError, MemoryError, TypeError, SyntaxError, OverflowError,
    ) as error:  # fmt: skip
        # zipfile and numpy raise all of these on damaged or hostile archives
        raise ValueError(
            f"{path}: expected an .npz file of plain arrays, but it cannot be read ({error})"
        ) from error


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write an .npz file; readers see the old file or the whole new one."""
    clear_leftovers(path)
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]
