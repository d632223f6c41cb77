"""Lists names and arguments that one version of the sources offers and another does not.

    python -m scripts.compare_interfaces ../v010 .

Reads the sources of `recon`, `priors` and `observations` without importing them, and the table of
moved modules in docs/migration.md of the new version. Every line is a change that this table does
not announce, and that must be added there. Private names are left out, and so are new names. For
a name that is now elsewhere all places are given, some of which may be other things of that name.
"""

import argparse
import ast
import re
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("recon", "priors", "observations")
_ROW = re.compile(r"^\| `([\w.]+)` \| (.*) \|$", re.M)
_MODULE = re.compile(r"`((?:recon|priors|observations)(?:\.\w+)*)`")


@dataclass(frozen=True)
class Offer:
    """One public function, class or constant of a module."""

    module: str
    name: str
    members: tuple[str, ...] = ()
    """Arguments of a function; fields and methods of a class."""
    bases: tuple[str, ...] = ()
    """Names of the classes that a class derives from."""


def main() -> None:
    """Print one line for every public name whose loss or move is not announced."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    arguments = parser.parse_args()
    page = (arguments.new / "docs" / "migration.md").read_text(encoding="utf-8")
    table = page.split("## Modules of version 0.1.0")[1]
    for line in differences(offers(arguments.old), offers(arguments.new), moved(table)):
        print(line)


def moved(table: str) -> dict[str, tuple[str, ...]]:
    """Parse a table of moved modules in Markdown; return new modules, keyed by the old one."""
    return {old: tuple(_MODULE.findall(new)) for old, new in _ROW.findall(table)}


def offers(root: Path) -> list[Offer]:
    """List all public functions, classes and constants of the packages below a folder."""
    found: list[Offer] = []
    for path in sorted(path for one in PACKAGES for path in (root / one).rglob("*.py")):
        module = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            found += [one for one in _offered(module, node) if not one.name.startswith("_")]
    return found


def members(node: ast.FunctionDef | ast.ClassDef) -> tuple[str, ...]:
    """List the arguments of a function, or the public fields and methods of a class."""
    if isinstance(node, ast.FunctionDef):
        given = node.args
        return tuple(one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs))
    names = [one.target.id for one in node.body
             if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)]  # fmt: skip
    names += [one.name for one in node.body if isinstance(one, ast.FunctionDef)]
    return tuple(name for name in names if not name.startswith("_"))


def differences(
    old: list[Offer], new: list[Offer], table: dict[str, tuple[str, ...]]
) -> list[str]:
    """List one line for every public name that was removed, lost members or moved unannounced.

    A move is announced when the table of modules gives the new place.
    """
    lines: list[str] = []
    for one in old:
        there = [own for own in new if own.name == one.name]
        here = [own for own in there if own.module in (one.module, *table.get(one.module, ()))]
        if len(there) == 0:
            lines.append(f"gone: {one.module}.{one.name}")
            continue
        if len(here) == 0:
            places = ", ".join(own.module for own in there)
            lines.append(f"elsewhere: {one.module}.{one.name} -> {places}")
            continue
        known = {name for own in here for name in _with_inherited(own, new)}
        if lost := [name for name in one.members if name not in known]:
            lines.append(f"without: {one.module}.{one.name}: {', '.join(lost)}")
    return lines


def _offered(module: str, node: ast.stmt) -> list[Offer]:
    match node:
        case ast.FunctionDef():
            return [Offer(module, node.name, members(node))]
        case ast.ClassDef():
            bases = tuple(ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases)
            return [Offer(module, node.name, members(node), bases)]
        case ast.Assign(targets=targets):
            return [Offer(module, one.id) for one in targets if isinstance(one, ast.Name)]
        case ast.AnnAssign(target=ast.Name(id=name)):
            return [Offer(module, name)]
        case _:
            return []


def _with_inherited(one: Offer, new: list[Offer]) -> set[str]:
    """Collect the members of a class and of its base classes."""
    bases = [own for own in new if own.name in one.bases and own.name != one.name]
    return {*one.members, *(name for own in bases for name in _with_inherited(own, new))}


if __name__ == "__main__":
    main()
