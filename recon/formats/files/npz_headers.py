"""Shapes and sizes of the arrays in an .npz file, from their headers: nothing else is read."""

import lzma
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

from recon.core.errors import FormatError
from recon.core.limits import PAYLOAD, Limit

DAMAGE = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, KeyError, OSError, ValueError,
    NotImplementedError, RuntimeError, MemoryError, TypeError, SyntaxError, OverflowError,
    tokenize.TokenError, AttributeError, IndexError, AssertionError,
)  # fmt: skip
"""What zipfile and numpy raise on damaged or hostile archives."""
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
_MEMBERS = 1000
"""Members an archive may have; ours have about twenty."""


def check_sizes(path: Path, limit: Limit = PAYLOAD, only: tuple[str, ...] | None = None) -> None:
    """Refuse an archive whose arrays do not fit into memory, or are larger than their members.

    Both a compressed bomb and a header that promises more than the file holds are found here,
    before memory is taken for them.

    Args:
        path: of the .npz file.
        limit: of the bytes of all arrays together.
        only: names of the arrays that are going to be read; None for all.

    Raises:
        ValueError: when they are too large or a header is damaged.
        zipfile.BadZipFile: when it is no archive; numpy and zipfile raise others for damage.
    """
    total = 0
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > _MEMBERS:
            raise FormatError(f"{path}: expected at most {_MEMBERS} arrays, got {len(members)}")
        for info in members:
            name = info.filename.removesuffix(".npy")
            if only is not None and name not in only:
                continue
            total += info.file_size
            limit.check(total, path, name)
            if not info.filename.endswith(".npy"):
                continue
            shape, dtype, place = _header(archive, info)
            stated = int(np.prod([float(n) for n in shape])) * dtype.itemsize
            if place + stated != info.file_size:
                raise FormatError(
                    f"{path}: {name} promises {dtype} {shape}, {stated} bytes, but holds "
                    f"{info.file_size - place}"
                )


def _header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype, int]:
    """Shape, type and length of the header of one array."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version not in _HEADERS:
            raise FormatError(f"{info.filename} is an array of the unknown version {version}")
        shape, _, dtype = _HEADERS[version](member)
        if dtype.hasobject:
            raise FormatError(f"{info.filename} holds pickled objects, which are never opened")
        return shape, dtype, member.tell()
