"""Ways to damage a file: of its bytes, its text, its arrays, or what is packed inside it."""

import io
import lzma
import re
import zipfile
from collections.abc import Callable

import numpy as np

Random = np.random.Generator
Mutation = Callable[[bytes, Random], bytes]

_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_EXTREMES = (
    b"1e300", b"-1e300", b"nan", b"inf", b"-inf", b"0", b"-1", b"1e-300", b"1e-320", b"", b"1e20",
    b"99999999999", b"4294967296", b"1" + b"0" * 29, b"9" * 5000, b"0x10", b"65536", b"1e5", b"-0",
    b"true", b"[]", b"1e9999", b"3.5",
)  # fmt: skip
_VALUES = (1e300, -1e300, np.nan, np.inf, -np.inf, -1.0, 1e-300, 1e20, 1e6, 0.0, 70_000.0, -2e5)
_WORDS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1_000_000, 0x7FC00000)


def _part(size: int, rng: Random) -> slice:
    first, last = sorted(int(n) for n in rng.integers(0, size + 1, 2))
    return slice(first, min(last, first + 4096))


def flip_bits(data: bytes, rng: Random) -> bytes:
    """One to eight bits are the other way."""
    out = bytearray(data)
    for place in rng.integers(0, len(out), int(rng.integers(1, 9))):
        out[place] ^= 1 << int(rng.integers(0, 8))
    return bytes(out)


def other_bytes(data: bytes, rng: Random) -> bytes:
    """One to twenty bytes are others."""
    out = bytearray(data)
    for place in rng.integers(0, len(out), int(rng.integers(1, 21))):
        out[place] = int(rng.integers(0, 256))
    return bytes(out)


def truncate(data: bytes, rng: Random) -> bytes:
    """The end is missing."""
    return data[: int(rng.integers(0, len(data)))]


def delete(data: bytes, rng: Random) -> bytes:
    """A part is missing."""
    part = _part(len(data), rng)
    return data[: part.start] + data[part.stop :]


def duplicate(data: bytes, rng: Random) -> bytes:
    """A part comes twice, or many times."""
    part = _part(len(data), rng)
    return data[: part.stop] + data[part] * int(rng.choice([1, 1, 50])) + data[part.stop :]


def splice(data: bytes, rng: Random) -> bytes:
    """A part stands at another place as well."""
    part, place = _part(len(data), rng), int(rng.integers(0, len(data)))
    return data[:place] + data[part] + data[place + part.stop - part.start :]


def swap(data: bytes, rng: Random) -> bytes:
    """Two halves stand the other way round."""
    place = int(rng.integers(0, len(data)))
    return data[place:] + data[:place]


def zeros(data: bytes, rng: Random) -> bytes:
    """A part is zero."""
    part = _part(len(data), rng)
    return data[: part.start] + bytes(part.stop - part.start) + data[part.stop :]


def word(data: bytes, rng: Random) -> bytes:
    """Two or four bytes, often of the header, are an extreme number."""
    end = len(data) if rng.random() < 0.5 else min(len(data), 600)
    size = int(rng.choice([2, 4]))
    place = int(rng.integers(0, max(end - size, 1))) & ~1
    value = int(rng.choice(_WORDS)) & ((1 << 8 * size) - 1)
    order = "little" if rng.random() < 0.8 else "big"
    return data[:place] + value.to_bytes(size, order) + data[place + size :]  # type: ignore[arg-type]


def digits(data: bytes, rng: Random) -> bytes:
    """A number in the text, often of the header, is an extreme one."""
    end = len(data) if rng.random() < 0.6 else min(len(data), 1500)
    start = int(rng.integers(0, max(end - 1, 1)))
    found = _NUMBER.search(data, start) or _NUMBER.search(data)
    if found is None:
        return other_bytes(data, rng)
    return data[: found.start()] + rng.choice(np.array(_EXTREMES)) + data[found.end() :]


def nest(data: bytes, rng: Random) -> bytes:
    """Brackets are opened a hundred thousand times."""
    place = int(rng.integers(0, len(data)))
    bracket = [b"[", b"{", b"(", b'{"a":', b"JOINT a\n{\n"][int(rng.integers(0, 5))]
    return data[:place] + bracket * int(rng.choice([2, 1000, 100_000])) + data[place:]


def change_line(data: bytes, rng: Random) -> bytes:
    """A line is missing, comes twice, or changes places with another."""
    lines = data.splitlines(keepends=True)
    a, b = (int(n) for n in rng.integers(0, len(lines), 2))
    match int(rng.integers(0, 3)):
        case 0:
            del lines[a]
        case 1:
            lines.insert(b, lines[a])
        case _:
            lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def change_array(data: bytes, rng: Random) -> bytes:
    """One array of an .npz file has an extreme number, another type or another shape."""
    with np.load(io.BytesIO(data)) as file:
        arrays: dict[str, np.ndarray] = dict(file)
    names = sorted(arrays)
    name = names[int(rng.integers(0, len(names)))]
    value = arrays[name]
    match int(rng.integers(0, 9)):
        case 0 | 1 | 2 | 3 if value.dtype.kind in "fiu" and value.size > 0:
            value = value.copy()
            extreme = float(rng.choice(_VALUES))
            if value.dtype.kind in "iu":
                extreme = float(rng.choice([-1, 0, 1_000_000, 2**31 - 1, 100]))
            with np.errstate(all="ignore"):
                value.reshape(-1)[int(rng.integers(0, value.size))] = np.array(extreme).astype(
                    value.dtype
                )
        case 4:
            kinds = ("complex128", "U8", "S3", "int8", "float16", "bool", "datetime64[s]")
            kind = kinds[int(rng.integers(0, len(kinds)))]
            with np.errstate(all="ignore"):
                try:
                    value = value.astype(kind)
                except (TypeError, ValueError):
                    value = np.zeros(value.shape, kind)
        case 5:
            value = value[:0] if value.ndim else np.zeros((0, 3))
        case 6:
            value = np.repeat(value[None], int(rng.choice([1, 2, 3])), 0)
        case 7:
            value = value.reshape(-1)[: int(rng.integers(0, max(value.size, 1)))]
        case _:
            del arrays[name]
            value = None
    if value is not None:
        arrays[name] = value
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def promise(data: bytes, rng: Random) -> bytes:
    """An array of an .npz file is said to be far larger, or unpacks to far more."""
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(data)) as old,
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        names = old.namelist()
        chosen = names[int(rng.integers(0, len(names)))]
        for name in names:
            member = old.read(name)
            if name == chosen and rng.random() < 0.5:
                member = digits(member[:128], rng) + member[128:]
            elif name == chosen:
                member = member + bytes(1 << int(rng.integers(10, 25)))
            new.writestr(name, member)
    return buffer.getvalue()


def inside_xz(mutation: Mutation) -> Mutation:
    """A mutation of what an .xz file unpacks to."""

    def mutate(data: bytes, rng: Random) -> bytes:
        return lzma.compress(mutation(lzma.decompress(data), rng), preset=0)

    mutate.__name__ = f"{mutation.__name__} inside"
    return mutate


def inside_image(data: bytes, rng: Random) -> bytes:
    """Pixels of an image are extreme, or it has another size or type."""
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert image is not None
    match int(rng.integers(0, 4)):
        case 0:
            image[:: int(rng.integers(1, 9))] = int(rng.choice([0, 255, 65535, 1]))
        case 1:
            image = image[: int(rng.integers(1, len(image)))]
        case 2:
            image = (image // 256).astype(np.uint8)
        case _:
            image = rng.integers(0, 65536, image.shape).astype(np.uint16)
    return cv2.imencode(".png", image)[1].tobytes()


BYTES: tuple[Mutation, ...] = (
    flip_bits, other_bytes, truncate, delete, duplicate, splice, swap, zeros, word,
)  # fmt: skip
TEXT: tuple[Mutation, ...] = (digits, digits, digits, nest, change_line)
ARRAYS: tuple[Mutation, ...] = (change_array, change_array, change_array, promise)
