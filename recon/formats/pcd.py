"""Reads .pcd files of the Point Cloud Library: text, binary or compressed binary."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import CLOUD, KEYPOINTS
from recon.formats.texts import parsed_numbers, read_binary

_KINDS = {"F": "f", "I": "i", "U": "u"}


def read_pcd(path: Path) -> Float[np.ndarray, "points 3"]:
    """Read the finite points of a file, in its own unit and axes; NaN points are left out.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged or has no fields x, y and z.
    """
    data = read_binary(path)
    header, body = _header(path, data)
    try:
        names = header["FIELDS"]
        sizes = [int(size) for size in header["SIZE"]]
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(names))]
        formats = [
            f"<{_KINDS[kind]}{size}" for kind, size in zip(header["TYPE"], sizes, strict=True)
        ]
        count = int(header["POINTS"][0])
        CLOUD.check(count, path, "POINTS")
        KEYPOINTS.check(sum(counts), path, "COUNT, fields of a point: ")
        columns = [names.index(axis) for axis in "xyz"]
        if count < 0 or min(counts) < 1 or any(counts[column] != 1 for column in columns):
            raise FormatError("POINTS or COUNT of its header are impossible numbers")
        keyword = header["DATA"][0]
        if keyword == "ascii":
            points = _values_of_text(body, names, counts, columns, count)
        elif keyword == "binary":
            layout = np.dtype(
                [(f"f{k}", f, (n,)) for k, (f, n) in enumerate(zip(formats, counts, strict=True))]
            )
            rows = np.frombuffer(body, layout, count)
            points = np.stack([rows[f"f{column}"][:, 0] for column in columns], 1)
        elif keyword == "binary_compressed":
            expected = count * sum(s * n for s, n in zip(sizes, counts, strict=True))
            points = _values_by_field(
                _decompressed(body, expected), formats, sizes, counts, columns, count
            )
        else:
            raise FormatError(f"data kind {keyword!r}")
    except (KeyError, IndexError, ValueError, TypeError, OverflowError) as error:
        raise FormatError(
            f"{path}: expected a PCD file with fields x y z as ascii, binary or "
            f"binary_compressed data, but it is damaged or lacks them ({error})"
        ) from error
    points = points.astype(np.float64)
    return points[np.isfinite(points).all(1)]


def _header(path: Path, data: bytes) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in header:
        end = data.find(b"\n", place)
        if end < 0 or end - place > 10_000 or len(header) > 50:
            raise FormatError(f"{path}: expected a PCD file, but it has no DATA line")
        words = data[place:end].decode("latin-1").split("#")[0].split()
        if words:
            header[words[0].upper()] = words[1:]
        place = end + 1
    return header, data[place:]


def _values_of_text(
    body: bytes, names: list[str], counts: list[int], columns: list[int], count: int
) -> np.ndarray:
    values = parsed_numbers(body, count * sum(counts)).reshape(count, sum(counts))
    first = np.cumsum([0, *counts[:-1]])
    assert len(names) == len(counts)
    return values[:, first[columns]]


def _values_by_field(
    body: bytes, formats: list[str], sizes: list[int], counts: list[int], columns: list[int],
    count: int,
) -> np.ndarray:  # fmt: skip
    """Read columns from decompressed data, which holds one field after the other."""
    starts = np.cumsum([0, *(s * n * count for s, n in zip(sizes, counts, strict=True))])
    return np.stack(
        [np.frombuffer(body, formats[k], count, int(starts[k])).astype(float) for k in columns], 1
    )


def _decompressed(body: bytes, expected: int) -> bytes:
    """Decompress LZF data: runs of literal bytes and references to earlier output."""
    packed, size = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
    if size < expected:
        raise FormatError(
            f"its header promises {expected} bytes of points, but {size} were compressed"
        )
    source, out, place = body[8 : 8 + packed], bytearray(), 0
    if len(source) != packed:
        raise FormatError("the compressed data is cut off")
    while place < len(source):
        control = source[place]
        place += 1
        if control < 32:
            out += source[place : place + control + 1]
            place += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += source[place]
            place += 1
        back = len(out) - ((control & 31) << 8) - source[place] - 1
        place += 1
        if back < 0 or len(out) > size:
            raise FormatError("the compressed data is damaged")
        # the copied range may reach past the end of `out`: the part that exists then repeats
        pattern = out[back : back + length + 2]
        out += (pattern * ((length + 2) // len(pattern) + 1))[: length + 2]
    if len(out) != size:
        raise FormatError(f"expected {size} bytes after decompression, got {len(out)}")
    return bytes(out)
