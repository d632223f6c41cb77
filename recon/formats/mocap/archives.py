"""Packed recordings: .tar, .tar.gz or .tar.xz of BVH files, read one by one without unpacking."""

import lzma
import tarfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from recon.core.errors import FormatError
from recon.core.limits import TEXT
from recon.core.units import Axis
from recon.formats.files.opening import decode, existing
from recon.formats.mocap.bvh import parse_bvh
from recon.formats.mocap.recording import SkeletonRecording


def iterate_texts(path: Path) -> Iterator[tuple[str, str]]:
    """Name and text of every .bvh file in an archive, in its order; nothing touches the disk.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged.
    """
    existing(path)
    try:
        with tarfile.open(path, "r|*") as archive:
            for member in archive:
                if not member.isfile() or not member.name.lower().endswith(".bvh"):
                    continue
                TEXT.check(member.size, f"{path}::{member.name}")
                file = archive.extractfile(member)
                assert file is not None  # regular files always open
                yield member.name, decode(file.read())
    except (tarfile.TarError, lzma.LZMAError, zlib.error, EOFError, OSError) as error:
        raise FormatError(f"{path}: expected a tar archive, but {error}") from error


def read_member(
    path: Path, member: str | None, *, unit: str | None = None, up: Axis | None = None
) -> SkeletonRecording:
    """One recording of an archive; it may be left unnamed when it is the only one.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when there is no such recording, or it is damaged.
    """
    seen: dict[str, str] = {}
    for name, text in iterate_texts(path):
        if member in (name, Path(name).name, Path(name).stem):
            return parse_bvh(text, name, unit=unit, up=up)
        seen[name] = text if not seen else ""
    if member is None and len(seen) == 1:
        name, text = seen.popitem()
        return parse_bvh(text, name, unit=unit, up=up)
    some = ", ".join(list(seen)[:3])
    raise FormatError(
        f"{path}: holds {len(seen)} BVH files ({some}, ...); choose one as {path.name}::NAME"
    )
