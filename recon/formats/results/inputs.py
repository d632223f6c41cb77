"""Files and folders that a verb reads, by the arguments and settings that name them."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

_READ_TOGETHER = {".amc": "*.asf*", ".xz": "*.asf*", ".yml": "*.yml", ".yaml": "*.y*ml"}
"""Files that are read along with one of this suffix, from the same folder."""


def paths_in(value: Any) -> Iterator[Path]:
    """Every path in a value, also inside tuples and settings.

    A text counts where it is the name of a file that exists, as weights, cameras and shapes are
    given by a word or by a file. What is read along with a file, like the skeleton (.asf) of an
    .amc recording, counts, too.
    """
    match value:
        case Path():
            # FILE::MEMBER is read from FILE
            path = value if value.exists() else Path(str(value).partition("::")[0])
            yield path
            if path.is_file() and (pattern := _READ_TOGETHER.get(path.suffix.lower())) is not None:
                yield from path.parent.glob(pattern)
        case str():
            path = Path(value)
            if path.suffix and path.is_file():
                yield path
        case tuple() | list():
            for one in value:
                yield from paths_in(one)
        case _ if is_dataclass(value):
            for field in fields(value):
                yield from paths_in(getattr(value, field.name))
        case _:
            pass
