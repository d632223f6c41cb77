"""The code blocks of the documents."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(ROOT.glob("docs/**/*.md")),
    *sorted(ROOT.glob("priors/weights/*.md")),
)
_BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^ *```$", re.S | re.M)


@dataclass(frozen=True)
class Block:
    """One fenced block of code, and where it begins."""

    page: Path
    line: int
    language: str
    code: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks(page: Path, language: str) -> list[Block]:
    """The blocks of one language on a page, in their order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        if match.group(2) == language:
            line = text.count("\n", 0, match.start()) + 2
            found.append(Block(page, line, language, match.group(3)))
    return found


def commands(block: Block) -> list[list[str]]:
    """The words of every command of a shell block, without comments, line breaks, redirections."""
    lines = block.code.replace("\\\n", " ").replace("&&", "\n").splitlines()
    words = [shlex.split(re.split(r" [<>] ", line)[0], comments=True) for line in lines]
    return [one for one in words if one]
