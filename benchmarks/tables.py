"""Writes the tables of README.md, docs/ and the cards of weights from benchmarks/results.

    python -m benchmarks.tables            # or: make tables
    python -m benchmarks.tables --check    # fails where a document says something else

A table stands in a document between `<!-- table NAME -->` and `<!-- end NAME -->`, and is that of
`benchmarks/results/NAME.json`.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from benchmarks.protocol import RESULTS, ROOT, Table

_BLOCK = re.compile(r"<!-- table ([\w-]+) -->\n.*?<!-- end ([\w-]+) -->", re.S)
_MARKER = re.compile(r"<!-- (?:table|end) [\w-]+ -->")


def documents() -> list[Path]:
    """List README.md, the pages of docs/ and the cards of the weights."""
    cards = ROOT.glob("priors/weights/*.md")
    return [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md")), *sorted(cards)]


def filled(text: str, where: str, results: Path = RESULTS) -> str:
    """Return the document's text with every table replaced by that of its result file.

    Raises:
        ValueError: when a marker has no counterpart or names no result file.
    """
    names: list[str] = []

    def block(match: re.Match[str]) -> str:
        name, end = match.groups()
        file = results / f"{name}.json"
        if name != end or not file.is_file():
            raise ValueError(f"{where}: there is no {file.name}, or the table ends as {end}")
        names.append(name)
        return f"<!-- table {name} -->\n{Table.read(file).markdown()}\n<!-- end {name} -->"

    new = _BLOCK.sub(block, text)
    if len(_MARKER.findall(text)) != 2 * len(names):
        raise ValueError(f"{where}: a table marker has no counterpart")
    return new


def used(text: str) -> list[str]:
    """Return the names of the tables in a document."""
    return [name for name, _ in _BLOCK.findall(text)]


def loose_numbers(text: str) -> Iterator[str]:
    """Yield rows of Markdown tables outside of the markers that have a decimal number."""
    for line in _BLOCK.sub("", text).splitlines():
        cells = [cell.strip(" *") for cell in line.split("|")]
        if len(cells) > 2 and any(re.fullmatch(r"[-+]?\d*\.\d+.{0,8}", cell) for cell in cells):
            yield line


def main() -> None:
    """Write the tables into the documents, or say which of them differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail on differences")
    check = parser.parse_args().check
    differ: list[str] = []
    for path in documents():
        text = path.read_text(encoding="utf-8")
        new = filled(text, path.name)
        if new != text:
            differ.append(path.name)
            if not check:
                path.write_text(new, encoding="utf-8")
    if check and differ:
        sys.exit(f"tables differ from their result files in {', '.join(differ)}; run make tables")
    print(f"tables {'written' if differ else 'are as their result files'}: {differ}")


if __name__ == "__main__":
    main()
