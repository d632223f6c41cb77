"""Reads and writes tables of text with commas, semicolons or tabs between cells."""

import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from recon.core.errors import FormatError
from recon.core.limits import SAMPLES, Limit
from recon.formats.replacing import replacing
from recon.formats.texts import decoded_text, read_bytes

_CELLS = Limit(
    "number of cells", 0.0, 8e6, "", "each takes sixty bytes while it is read: cut the recording"
)

_COMMENTS = 20
"""Most lines of comments before a table."""
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")


def read_rows(path: Path, limit: Limit) -> list[list[str]]:
    """Read the cells of every row that is not blank, stripped of white space.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, no table, or larger than the limit.
    """
    data = read_bytes(path, limit)
    _CELLS.check(sum(map(data.count, (b",", b";", b"\t", b"\n"))), path.name)
    try:
        return [row for row in _split_cells(decoded_text(data)) if any(row)]
    except csv.Error as error:
        raise FormatError(f"{path.name}: expected a comma-separated table, but {error}") from error


def _split_cells(text: str) -> list[list[str]]:
    """Split lines into cells at the separator that is found in the first line.

    It is a comma if the line has one; else a semicolon, tab or bar; else spaces between seven
    words or more. Where it is no comma, numbers with decimal commas get points.
    """
    lines = _without_comments([line for line in text.splitlines() if line.strip()])
    first = lines[0] if lines else ""
    separator = next((one for one in ";\t|" if one in first and "," not in first), ",")
    if separator == "," not in first and len(first.split()) >= _WORDS:
        lines, separator = ["|".join(line.split()) for line in lines], "|"
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    if separator == ",":
        return rows
    comma = _DECIMAL_COMMA.fullmatch
    return [[cell.replace(",", ".") if comma(cell) else cell for cell in row] for row in rows]


_WORDS = 7
"""Least number of words in a first line for spaces to separate cells: a frame and two points."""


def _without_comments(lines: list[str]) -> list[str]:
    """Remove leading comments (#), but keep the last if it is the header, as numpy writes it."""
    count = next((k for k, line in enumerate(lines) if not line.startswith("#")), 0)
    if count == 0:
        return lines
    header = lines[count - 1].lstrip("# ")
    cells = [len(re.split(r"[,;\t|]|\s+", line.strip())) for line in (header, lines[count])]
    return [header] * (cells[0] == cells[1]) + lines[count:]


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write a table atomically, with a column for every key in order of first appearance.

    Raises:
        FileNotFoundError: when the folder does not exist.
    """
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with replacing(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def refuse_repeated_columns(columns: Sequence[str], name: str) -> None:
    """Refuse a table in which two columns have the same name.

    Raises:
        ValueError: naming the column.
    """
    twice, count = Counter(columns).most_common(1)[0] if columns else ("", 0)
    if count > 1:
        raise FormatError(
            f"{name}: expected every column once, got {count} of {twice}; leave out all but one"
        )


def first_rows(path: Path, count: int = 4) -> list[list[str]]:
    """Read only the first rows of a table; none if the file is no table.

    Raises:
        FileNotFoundError: when there is no such file.
    """
    with path.open("rb") as file:
        head = b"".join(line for line, _ in zip(file, range(count + _COMMENTS), strict=False))
    try:
        return _split_cells(decoded_text(head).replace("\0", ""))[:count]
    except csv.Error:
        return []


def numbers_of_columns(
    rows: Sequence[Sequence[str]],
    columns: Sequence[int],
    name: str,
    *,
    most: int,
    least: int = 0,
) -> Float[np.ndarray, "rows columns"]:
    """Parse the numbers in some columns of a table; NaN where one is blank, missing, NA or null.

    Args:
        rows: cells of the rows below the header.
        columns: numbers of the wanted columns, from 0.
        name: of the file, for messages.
        most: largest number of cells in a row, that of the header.
        least: smallest number of cells in a row.

    Raises:
        ValueError: when a row has another number of cells, or a cell is no number.
    """
    values = np.full((len(rows), len(columns)), np.nan)
    for line, row in enumerate(rows):
        if not least <= len(row) <= most:
            raise FormatError(
                f"{name}: row {line} has {len(row)} cells, the header {most}; where numbers have "
                "decimal commas, put semicolons between cells"
            )
        for k, column in enumerate(columns):
            cell = row[column] if column < len(row) else ""
            if cell.lower() not in ("", "na", "n/a", "null", "none", "-"):
                try:
                    values[line, k] = float(cell)
                except ValueError as error:
                    raise FormatError(
                        f"{name}: expected a number in row {line}, got {cell[:40]!r}; "
                        "leave cells empty where nothing was seen"
                    ) from error
                if np.isinf(values[line, k]) and "inf" not in cell.lower():
                    raise FormatError(
                        f"{name}: the number {cell[:40]!r} in row {line} is too large"
                    )
    return values


def rows_of_whole_points(
    rows: Iterable[list[str]], first: int, width: int, name: str, notes: list[str]
) -> Iterator[list[str]]:
    """Yield every row's cells up to its last whole point, of three cells from `first` on.

    Points at the end of a row may be left out. A last row that is shorter than all others was cut
    short: its last point, maybe cut within a number, is left out, and `notes` gets a sentence.

    Args:
        rows: cells of every row, none of them empty.
        first: number of cells before the coordinates.
        width: number of cells by the header.
        name: of the file, for messages.
        notes: what was found, one sentence each.

    Raises:
        FormatError: when a row ends within a point, so that a cell before is missing.
    """
    shortest = width - 1
    for line, (cells, following) in enumerate(pairwise(chain(rows, ([],))), 1):
        end = next((k for k in range(len(cells), first, -1) if cells[k - 1].strip()), first)
        over = (end - first) % 3
        if not following and len(cells) < shortest and end > first and line > 1:
            end -= over or 3
            notes.append(
                f"the last row is cut short after {(end - first) // 3} of {(width - first) // 3} "
                "points: the others are taken as unseen in it"
            )
        elif over:
            raise FormatError(
                f"{name}: row {line} below the header has {end} cells, expected {width}, or three "
                "more or fewer for each point: behind a cell that is lost or added, coordinates "
                "would go to wrong points; mend that row or leave it out"
            )
        shortest = min(shortest, len(cells))
        yield cells[:end]


def with_missing_frames(
    values: Float[np.ndarray, "rows points 3"], index: np.ndarray, name: str
) -> tuple[Float[np.ndarray, "time points 3"], tuple[str, ...]]:
    """Insert NaN for frames that a table leaves out; also return a sentence that says so.

    Args:
        values: points of every row.
        index: frame of every row, increasing whole numbers from 0.
        name: of the file, for messages.

    Raises:
        ValueError: when these would be too many frames.
    """
    count = int(index[-1]) + 1
    if count == len(values):
        return values, ()
    SAMPLES.check(count * values.shape[1], name, "frames")
    filled = np.full((count, *values.shape[1:]), np.nan)
    filled[index.astype(np.int64)] = values
    return filled, (
        f"{count - len(values)} frame numbers between others are missing: these frames are taken "
        "as unseen",
    )
