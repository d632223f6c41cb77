"""Draw texts of the project at random, for readers who say in their own words what each means.

    python -m scripts.texts
    python -m scripts.texts --count 70 --seed 4547c9f

The seed is the hash of the last commit unless another is given, so that nobody chooses what is
read. Texts are drawn in equal numbers from five kinds: docstrings, comments, messages of errors,
names of definitions with their first lines, paragraphs of the documents.
"""

import argparse
import ast
import io
import random
import re
import subprocess
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("recon", "priors", "observations", "training")
MIN_WORDS = 4
"""Texts with fewer words say nothing that could be misunderstood."""

FIRST_LINES = 6
"""Lines of a body that are shown with the name of its function or class."""

Place = tuple[str, str]
"""The place of a text (file and line or name), and the text."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=70, help="how many texts to draw")
    parser.add_argument("--seed", help="default: the hash of the last commit")
    arguments = parser.parse_args()
    seed = arguments.seed or _git("rev-parse", "--short=7", "HEAD").strip()
    print(f"{arguments.count} texts, seed {seed}")
    for number, (place, text) in enumerate(drawn(arguments.count, seed), 1):
        print(f"\n[{number}] {place}\n{text}")


def drawn(count: int, seed: str) -> list[Place]:
    """Draw texts without repetition, in turns from every kind; a seed always draws the same."""
    order = random.Random(seed)
    kinds = [order.sample(texts, len(texts)) for texts in _texts_by_kind()]
    turns = [kind[k] for k in range(count) for kind in kinds if k < len(kind)]
    return turns[:count]


def docstrings(name: str) -> Iterator[Place]:
    """Yield the first paragraphs of the docstrings of a file."""
    for node in ast.walk(_tree(name)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            text = (ast.get_docstring(node) or "").split("\n\n")[0]
            if len(text.split()) >= MIN_WORDS:
                yield f"{name}, docstring of {getattr(node, 'name', 'the module')}", text


def comments(name: str) -> Iterator[Place]:
    """Yield comments with the line of code that follows them."""
    lines = _text(name).splitlines()
    for token in tokenize.generate_tokens(io.StringIO(_text(name)).readline):
        row = token.start[0]
        plain = token.type == tokenize.COMMENT and not re.search(
            r"fmt:|noqa|pyright", token.string
        )
        if plain and len(token.string.split()) >= MIN_WORDS:
            yield f"{name}:{row}", "\n".join(lines[row - 1 : row + 1])


def messages(name: str) -> Iterator[Place]:
    """Yield the texts of errors that a file raises, as they are written."""
    for node in ast.walk(_tree(name)):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
            text = ast.unparse(node.exc.args[0])
            if len(text.split()) >= MIN_WORDS and "(lambda:" not in text:
                yield f"{name}:{node.lineno}", text


def definitions(name: str) -> Iterator[Place]:
    """Yield functions and classes by signature and first lines, without docstring and imports."""
    lines = _text(name).splitlines()
    for node in ast.walk(_tree(name)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            told = ast.get_docstring(node) is not None
            head = lines[node.lineno - 1 : node.body[0].lineno - 1]
            kept = [s for s in node.body[told:] if not isinstance(s, ast.Import | ast.ImportFrom)]
            body = lines[kept[0].lineno - 1 : kept[-1].end_lineno] if kept else []
            yield f"{name}:{node.lineno}", "\n".join([*head, *body[:FIRST_LINES]])


def paragraphs(name: str) -> Iterator[Place]:
    """Yield paragraphs and lists of a page, without headings, tables and code."""
    text = re.sub(r"```.*?```", "", _text(name), flags=re.DOTALL)
    for part in map(str.strip, text.split("\n\n")):
        other = part.startswith(("#", "|", "<", "!", ":::"))
        if not other and len(part.split()) >= MIN_WORDS:
            yield name, part


@cache
def _texts_by_kind() -> list[list[Place]]:
    names = _git("ls-files").split("\n")
    code = [name for name in names if name.endswith(".py") and name.split("/")[0] in PACKAGES]
    pages = [n for n in names if n.endswith(".md") and n.split("/")[0] in ("docs", "README.md")]
    return [
        [one for name in code for one in docstrings(name)],
        [one for name in code for one in comments(name)],
        [one for name in code for one in messages(name)],
        [one for name in code for one in definitions(name)],
        [one for name in pages for one in paragraphs(name)],
    ]


@cache
def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@cache
def _tree(name: str) -> ast.Module:
    return ast.parse(_text(name))


def _git(*words: str) -> str:
    return subprocess.run(
        ["git", *words], cwd=ROOT, check=True, capture_output=True, encoding="utf-8"
    ).stdout


if __name__ == "__main__":
    main()
