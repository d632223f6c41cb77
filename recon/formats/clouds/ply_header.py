"""Counts in the header of a PLY file, compared with what the file can hold before it is read."""

from pathlib import Path

from recon.core.errors import FormatError
from recon.core.limits import BINARY, CLOUD

_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8,
    "float64": 8,
}  # fmt: skip
_LONGEST = 1 << 16
"""Bytes a header may have."""


def check_counts(path: Path) -> None:
    """Refuse a file whose header promises more than its size allows.

    Raises:
        ValueError: when it has no header of a PLY file, or is cut short or too large.
    """
    BINARY.check(path.stat().st_size, path)
    with path.open("rb") as file:
        head = file.read(_LONGEST)
    end = head.find(b"end_header")
    if not head.startswith(b"ply") or end < 0:
        raise FormatError(f"{path}: expected a PLY file, with a header from 'ply' to 'end_header'")
    words = [line.split() for line in head[:end].decode("latin-1").splitlines()]
    text = ["format", "ascii"] in [line[:2] for line in words]
    needed, count = 0, 0
    for line in words:
        if line[:1] == ["element"]:
            if len(line) != 3 or not line[2][:20].isdecimal():
                raise FormatError(
                    f"{path}: damaged PLY file, got the line {' '.join(line)[:60]!r}"
                )
            count = int(line[2][:20])
            CLOUD.check(count, path, f"element {line[1][:20]}")
        elif line[:1] == ["property"] and len(line) >= 3:
            # a list has its length at least; a number of a text file a digit and a space
            kind = line[2] if line[1] == "list" else line[1]
            if kind not in _BYTES:
                raise FormatError(f"{path}: damaged PLY file, no type is called {kind[:20]!r}")
            needed += count * (2 if text else _BYTES[kind])
    if needed > path.stat().st_size + 1:
        raise FormatError(
            f"{path}: the PLY header promises {needed} bytes or more; the file has "
            f"{path.stat().st_size} and is cut short or damaged"
        )
