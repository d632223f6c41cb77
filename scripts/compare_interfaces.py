"""Names and arguments that one version of the sources offers and another does not.

    python -m scripts.compare_interfaces ../v010 .

Reads the sources of `recon`, `priors` and `observations` without importing them. Written for
docs/migration.md; private names are left out, and so are names that are only new.
"""

import argparse
import ast
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("recon", "priors", "observations")


@dataclass(frozen=True)
class Offer:
    """One public function or class of a module."""

    module: str
    name: str
    members: tuple[str, ...]
    """Arguments of a function; fields and methods of a class."""


def main() -> None:
    """Print one line for every name that somebody would miss."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    arguments = parser.parse_args()
    for line in differences(offers(arguments.old), offers(arguments.new)):
        print(line)


def offers(root: Path) -> list[Offer]:
    """All public functions and classes of the packages below a folder."""
    found: list[Offer] = []
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*.py")):
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef):
                continue
            if not node.name.startswith("_"):
                found.append(Offer(module.removesuffix(".__init__"), node.name, members(node)))
    return found


def members(node: ast.FunctionDef | ast.ClassDef) -> tuple[str, ...]:
    """Names that a caller of a function or a user of a class can write."""
    if isinstance(node, ast.FunctionDef):
        given = node.args
        return tuple(one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs))
    names = [one.target.id for one in node.body
             if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)]  # fmt: skip
    names += [one.name for one in node.body if isinstance(one, ast.FunctionDef)]
    return tuple(name for name in names if not name.startswith("_"))


def differences(old: list[Offer], new: list[Offer]) -> list[str]:
    """What became of every old offer that is not where and what it was."""
    lines: list[str] = []
    for one in old:
        there = [own for own in new if own.name == one.name]
        here = [own for own in there if own.module == one.module] or there
        if len(here) == 0:
            lines.append(f"gone: {one.module}.{one.name}")
            continue
        lost = [name for name in one.members if all(name not in own.members for own in here)]
        if here[0].module != one.module:
            places = ", ".join(own.module for own in here)
            lines.append(f"moved: {one.module}.{one.name} -> {places}")
        if len(lost) > 0:
            lines.append(f"without: {here[0].module}.{one.name}: {', '.join(lost)}")
    return lines


if __name__ == "__main__":
    main()
