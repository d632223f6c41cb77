"""Opening files that may be damaged, and writing arrays in one step."""

import lzma
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import BINARY, DEPTH, ENTRIES, MASKS, PAYLOAD, TEXT, Limit
from recon.formats.replacing import clear_leftovers
from recon.formats.replacing import replacing as replacing

DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, KeyError, OSError, ValueError,
    NotImplementedError, RuntimeError, MemoryError, TypeError, SyntaxError, OverflowError,
    tokenize.TokenError, AttributeError, IndexError, AssertionError,
)  # fmt: skip
"""What zipfile and numpy raise on damaged or hostile archives."""
HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""Readers of the headers of arrays, by version."""
_PACKED = (
    "recordings are packed to a fifth of their size, no file of zeros is one: save it unpacked"
)
_LONGEST_TEXT = 1 << 20
"""Bytes of one text in an array; the longest that are saved are names and settings."""
_MEMBERS = 1000
"""Members an archive may have; ours have about twenty."""


def packed(path: Path, limit: Limit) -> Limit:
    """The limit of what a packed file may become: fifty times its size, where that is above 64 MB.

    Zeros are packed to a thousandth, so that a small file could become as large as the largest.
    """
    most = float(max(1 << 26, 50 * path.stat().st_size))
    return limit if most >= limit.high else replace(limit, high=most, reason=_PACKED)


def check_sizes(
    path: Path, limit: Limit = PAYLOAD, only: tuple[str, ...] | None = None
) -> list[str]:
    """Refuse an archive that does not fit into memory or is damaged; gives its arrays' names.

    Both a compressed bomb and a header that promises more than the file holds are found here,
    before memory is taken for them. A single object that is no array (AMASS keeps a dictionary
    beside its arrays) is left out and stays closed.

    Args:
        path: of the .npz file.
        limit: of the bytes of all arrays together.
        only: names of the arrays that are going to be read; None for all.

    Raises:
        ValueError: when they are too large or a header is damaged.
        zipfile.BadZipFile: when it is no archive; numpy and zipfile raise others for damage.
    """
    total, names = 0, []
    # masks of a person who is not seen are zeros
    limit = limit if limit is MASKS else packed(path, limit)
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
            shape, dtype, place = _header(archive, info)
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
            # a number takes four bytes at least once it is used
            total += max(info.file_size, 4 * int(np.prod([float(n) for n in shape])))
            limit.check(total, path, name)
    return names


def _header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype, int]:
    """Shape, type and length of the header of one array."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in HEADERS:
            raise FormatError(f"{info.filename} is an array of the unknown version {version}")
        shape, _, dtype = HEADERS[version](member)
        if dtype.hasobject and shape:
            raise FormatError(f"{info.filename} holds pickled objects, which are never opened")
        return shape, dtype, member.tell()


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
    most = packed(path, min(limit, TEXT, key=lambda one: one.high))
    try:
        with lzma.open(path) as file:
            data = file.read(int(most.high) + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise FormatError(f"{path}: expected xz-compressed data, but {error}") from error
    most.check(len(data), path)
    return data


def inflated(data: bytes, path: Path) -> bytes:
    """The pickle in a file that joblib compressed (zlib or gzip); others as they are."""
    if not data.startswith((b"x\x01", b"x^", b"x\x9c", b"x\xda", b"\x1f\x8b")):
        return data
    most = packed(path, BINARY)
    content = zlib.decompressobj(32 + zlib.MAX_WBITS).decompress(data, int(most.high) + 1)
    most.check(len(content), path)
    return content


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
        names = check_sizes(path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in names}
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


def check_tree(content: Any, path: Path) -> None:
    """Refuse containers that are nested deeply, hold themselves, or have too many entries.

    A container that several others share counts for each of them, as whoever walks through the
    tree meets it that often: thirty lists of two can hold a thousand million entries.

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


def save_arrays(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write an .npz file; readers see the old file or the whole new one."""
    clear_leftovers(path)
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)  # type: ignore[arg-type]


_PIECE = 1 << 20
"""Characters looked at together."""
_LONGEST = 1000
"""Characters a number may have."""


def numbers_in(text: str | bytes, count: int, start: int = 0) -> np.ndarray:
    """An array of `count` numbers between white space, from a place in the text to its end.

    Raises:
        ValueError: when there are more or fewer, or something is no number.
    """
    values, filled = np.empty(count), 0
    while start < len(text):
        end = start + _PIECE
        stop = min(end + _LONGEST, len(text))
        while end < stop and not text[end : end + 1].isspace():
            end += 1
        words = text[start:end].split()
        if filled + len(words) > count:
            raise FormatError(f"expected {count} numbers, got more")
        values[filled : filled + len(words)] = [float(word) for word in words]
        filled, start = filled + len(words), end
    if filled < count:
        raise FormatError(f"expected {count} numbers, got {filled}")
    return values
