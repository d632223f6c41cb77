"""Writes a copy of a C3D file in which points have other names or another order."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Int

from recon.core.errors import FormatError
from recon.formats.texts import read_binary
from recon.mocap import c3d

_MOST = 255
"""Texts of one parameter at most."""
_UNSEEN = {
    c3d.INTEL: struct.pack("<4f", 0, 0, 0, -1),
    c3d.MIPS: struct.pack(">4f", 0, 0, 0, -1),
    c3d.DEC: bytes(12) + b"\x80\xc0\x00\x00",
}
"""A point that is not visible, in the floats of three processors."""


def write_renamed_c3d(
    path: Path, source: Path, names: tuple[str, ...], columns: Int[np.ndarray, "time points"]
) -> None:
    """Write a copy of a C3D file whose points are renamed and, frame by frame, reordered.

    Header, events, parameters, analog samples, and points that are a model's outputs keep their
    bytes. Of points, numbers and residuals are copied as they are stored.

    Args:
        path: file to write.
        source: file to copy.
        names: of the points, in the order in which they are written; the outputs follow.
        columns: which point of the source each is in every frame, in the order in which
            `read_c3d` gives them; -1 where it is not visible.

    Raises:
        ValueError: when the file is damaged, or holds poses of segments beside points.
    """
    data = read_binary(source)
    header, groups = c3d.read_head(data, source)
    # ezc3d writes this group into every file, without labels where there are no rotations
    if c3d.texts(groups.get("ROTATION", {}), "LABELS"):
        raise FormatError(f"{source}: cannot rename a C3D file of rotations; write .trc or .csv")
    old, chosen = c3d.chosen_points(header, groups)
    kept = [k for k in range(header.points) if k not in set(chosen)]
    new = [*names, *(old[k] for k in kept)]
    frames, real = header.frames, header.scale < 0
    point, start = (16 if real else 8), (header.data_start - 1) * c3d.BLOCK
    width = header.points * point + header.analog * point // 4
    rows = np.frombuffer(data, np.uint8, frames * width, start).reshape(frames, width)
    points = rows[:, : header.points * point].reshape(frames, header.points, point)
    short = struct.pack(f"{header.byte_order}4h", 0, 0, 0, -1)
    unseen = np.frombuffer(_UNSEEN[header.processor] if real else short, np.uint8)
    index = np.array(chosen)[columns]
    moved = np.where(columns[..., None] >= 0, points[np.arange(frames)[:, None], index], unseen)
    body = np.concatenate(
        (
            moved.reshape(frames, -1),
            points[:, kept].reshape(frames, -1),
            rows[:, header.points * point :],
        ),
        axis=1,
    )
    said = c3d.texts(groups.get("POINT", {}), "DESCRIPTIONS")
    beside = [said[k] if k < len(said) else "" for k in kept]
    texts = {"LABELS": new, "DESCRIPTIONS": [*[""] * len(names), *beside] if said else []}
    before = (data[0] - 1) * c3d.BLOCK
    size = len(_parameter_section(data, header, texts, len(new), 0))
    data_start = (before + size) // c3d.BLOCK + 1
    out = bytearray(data[:before]) + _parameter_section(data, header, texts, len(new), data_start)
    struct.pack_into(f"{header.byte_order}H", out, 2, len(new))
    struct.pack_into(f"{header.byte_order}H", out, 16, data_start)
    out += body.tobytes() + data[start + frames * width :]
    out += bytes(-len(out) % c3d.BLOCK)
    path.write_bytes(out)


def _parameter_section(
    data: bytes, header: c3d.Header, texts: dict[str, list[str]], count: int, start: int
) -> bytes:
    """Return the parameter section with new labels, number of points and start of data."""
    place = (data[0] - 1) * c3d.BLOCK
    entries = _parameter_entries(data, header)
    numbers = {"USED": count, "DATA_START": start}
    points = next(-number for number, name, _ in entries if number < 0 and name == "POINT")
    parts: list[bytes] = []
    for number, name, entry in entries:
        word = name.rstrip("0123456789") if number == points else ""
        if word in texts:
            if name == word and texts[word]:
                parts += _text_entries(entry, word, texts[word], header)
        elif number == points and name in numbers:
            raw = struct.pack(f"{header.byte_order}H", numbers[name])
            parts.append(_with_values(entry, raw, 2, (), header))
        else:
            parts.append(entry)
    out = bytearray(data[place : place + 4]) + b"".join(parts) + bytes(2)
    out += bytes(-len(out) % c3d.BLOCK)
    out[2] = len(out) // c3d.BLOCK
    return bytes(out)


def _parameter_entries(data: bytes, header: c3d.Header) -> list[tuple[int, str, bytes]]:
    """Return group number (negative for a group's own entry), name and bytes of all entries."""
    place, found = (data[0] - 1) * c3d.BLOCK + 4, list[tuple[int, str, bytes]]()
    while place + 2 <= len(data) and data[place] != 0:
        length, number = struct.unpack_from("bb", data, place)
        after = place + 2 + abs(length)
        name = data[place + 2 : after].decode("latin-1").strip().upper()
        step = struct.unpack_from(f"{header.byte_order}h", data, after)[0]
        end = after + step if step > 0 else _end_of_last_entry(data, after + 2, number)
        entry = bytearray(data[place:end])
        struct.pack_into(f"{header.byte_order}h", entry, 2 + abs(length), end - after)
        found.append((number, name, bytes(entry)))
        if step <= 0:
            break
        place = after + step
    return found


def _end_of_last_entry(data: bytes, place: int, number: int) -> int:
    """Return the offset at which the last parameter entry ends, computed from its contents."""
    if number > 0:
        size, rank = struct.unpack_from("bB", data, place)
        place += 2 + rank + abs(size) * int(np.prod(list(data[place + 2 : place + 2 + rank])))
    return place + 1 + data[place]


def _text_entries(entry: bytes, word: str, texts: list[str], header: c3d.Header) -> list[bytes]:
    """Return the entries of a parameter with the given texts, continued in LABELS2, ..."""
    parts: list[bytes] = []
    width = max(1, *(len(text.encode("latin-1", "replace")) for text in texts))
    for k in range(0, len(texts), _MOST):
        some = texts[k : k + _MOST]
        raw = b"".join(text.encode("latin-1", "replace").ljust(width) for text in some)
        name = word + (str(k // _MOST + 1) if k else "")
        length = struct.unpack_from("b", entry)[0]
        renamed = (
            struct.pack("bb", len(name) if length > 0 else -len(name), entry[1])
            + name.encode("ascii")
            + entry[2 + abs(length) :]
        )
        parts.append(_with_values(renamed, raw, -1, (width, len(some)), header))
    return parts


def _with_values(
    entry: bytes, raw: bytes, size: int, shape: tuple[int, ...], header: c3d.Header
) -> bytes:
    """Replace the values in a parameter's entry; keep its name, lock and description."""
    place = 2 + abs(struct.unpack_from("b", entry)[0])
    old, rank = struct.unpack_from("bB", entry, place + 2)
    dimensions = entry[place + 4 : place + 4 + rank]
    after = place + 4 + rank + abs(old) * int(np.prod(list(dimensions)))
    tail = struct.pack("bB", size, len(shape)) + bytes(shape) + raw + entry[after:]
    return entry[:place] + struct.pack(f"{header.byte_order}h", 2 + len(tail)) + tail
