"""Documents with tables between markers."""

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from benchmarks.results import ROOT

Table = Callable[[], str]
"""Makes the markdown between two markers."""

_BLOCK = re.compile(r"<!-- table ([\w-]+) -->\n.*?<!-- end ([\w-]+) -->", re.S)
_MARKER = re.compile(r"<!-- (?:table|end) [\w-]+ -->")


def documents() -> list[Path]:
    """README.md, the pages of docs/ and the cards of the weights."""
    cards = [*ROOT.glob("priors/weights/*.md"), *ROOT.glob("weights-nc/*.md")]
    return [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md")), *sorted(cards)]


def filled(text: str, tables: Mapping[str, Table], where: str) -> str:
    """The document with every table as its result files have it.

    Raises:
        ValueError: when a marker has no counterpart or names no table.
    """
    names: list[str] = []

    def block(match: re.Match[str]) -> str:
        name, end = match.groups()
        if name != end or name not in tables:
            raise ValueError(f"{where}: no table is called {name}, or it ends as {end}")
        names.append(name)
        return f"<!-- table {name} -->\n{tables[name]().strip()}\n<!-- end {name} -->"

    new = _BLOCK.sub(block, text)
    if len(_MARKER.findall(text)) != 2 * len(names):
        raise ValueError(f"{where}: a table marker has no counterpart")
    return new


def used(text: str) -> list[str]:
    """Names of the tables in a document."""
    return [name for name, _ in _BLOCK.findall(text)]


def loose_numbers(text: str) -> Iterator[str]:
    """Rows of markdown tables outside of the markers of which a cell is a decimal number."""
    for line in _BLOCK.sub("", text).splitlines():
        cells = [cell.strip(" *") for cell in line.split("|")]
        if len(cells) > 2 and any(re.fullmatch(r"[-+]?\d*\.\d+.{0,8}", cell) for cell in cells):
            yield line
