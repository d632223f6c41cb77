"""The house rules that a machine can check."""

import ast
import re
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("recon", "priors", "observations")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
SURVIVES = {
    ROOT / "recon" / "batch" / "workers.py": ("BaseException",),
    ROOT / "recon" / "cli" / "films.py": ("BaseException",),
    ROOT / "recon" / "live" / "lines.py": ("BaseException",),
    ROOT / "recon" / "live" / "stream.py": ("BaseException",),
}
"""Files that catch what is not known, and what not even they catch: whatever goes wrong with one
of many jobs, with one moment of a stream, or with a picture beside a result, is its own."""
TREE = [
    *SOURCES,
    *(p for f in ("benchmarks", "scripts", "examples", "tests") for p in (ROOT / f).rglob("*.py")),
]


@pytest.mark.parametrize("path", TREE, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_library_code_keeps_its_manners(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in ("print", "exit", "quit"), f"{path}:{node.lineno}"
        if isinstance(node, ast.ExceptHandler) and isinstance(node.type, ast.Name):
            refused = SURVIVES.get(path, ("Exception", "BaseException"))
            assert node.type.id not in refused, f"{path}:{node.lineno}"
        if isinstance(node, ast.ImportFrom):
            assert node.module != "__future__", f"{path}: shapes are checked, so no lazy ones"
    assert path.name not in ("utils.py", "helpers.py", "misc.py", "common.py")


def test_a_program_runs_when_all_of_it_is_defined():
    for path in [*TREE, *(ROOT / "training").rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        if re.search("^if __name__ == ", text, re.M):
            assert ast.unparse(ast.parse(text).body[-1]).startswith("if __name__ == "), path


def test_another_package_of_the_name_is_noticed(monkeypatch):
    import recon

    monkeypatch.delattr(recon, "__distribution__")
    monkeypatch.delitem(sys.modules, "observations", raising=False)
    with pytest.raises(ImportError, match="not motion-recon"):
        __import__("observations")


def _children(folder: Path) -> list[str]:
    """Modules and packages in a folder of a package."""
    modules = [p.stem for p in folder.glob("*.py") if not p.stem.startswith("__")]
    return modules + [p.name for p in folder.iterdir() if (p / "__init__.py").is_file()]


FOLDERS = sorted({path.parent for path in SOURCES})
FLAT = 25
"""Modules and packages that a room may list before it needs rooms of its own."""
DEEPEST = 1
"""Levels of folders below a package."""


def _path(folder: Path) -> str:
    return str(folder.relative_to(ROOT))


@pytest.mark.parametrize("folder", FOLDERS, ids=_path)
def test_a_room_lists_what_a_reader_can_take_in(folder):
    """`recon/` once listed 80 flat modules, which hid what belongs together."""
    children = _children(folder)
    assert len(children) <= FLAT, f"{folder}: {len(children)} entries; make rooms by idea"
    assert len(set(children)) == len(children), f"{folder}: a module and a package of one name"
    assert (folder / "__init__.py").is_file()


def test_a_room_is_flat_until_it_is_full():
    """A limit of 15 entries made 75 folders, 12 of them with three files or fewer."""
    divided = {
        _path(folder)
        for folder in FOLDERS
        if folder.parent != ROOT
        and any(other.parent == folder for other in FOLDERS)
        and sum(folder in path.parents for path in SOURCES) <= FLAT
    }
    assert not divided, "make no rooms in a small one"


def test_no_folder_lies_deep():
    deep = {_path(f) for f in FOLDERS if len(f.relative_to(ROOT).parts) > 1 + DEEPEST}
    assert deep == set(), "one level below a package at most"


def test_the_import_contract_is_the_list_of_rooms():
    """It once named 72 modules, as the listing did not say which way imports go."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        (contract,) = tomllib.load(file)["tool"]["importlinter"]["contracts"]
    named = [room for line in contract["layers"] for room in line.split(" | ")]
    rooms = {f"recon.{p.parent.name}" for p in (ROOT / "recon").glob("*/__init__.py")}
    assert len(contract["layers"]) <= 18
    assert sorted(named) == sorted({"priors", "observations", "training"} | rooms)


def _imported(path: Path) -> set[str]:
    """Modules of ours that a file imports, those of type checking apart."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    apart = {
        id(inside)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inside in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and id(node) not in apart:
            assert node.module is not None, f"{path}:{node.lineno}: imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in MODULES else node.module for name in names}
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name in MODULES}


def _name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {_name(path) for path in SOURCES}


@pytest.mark.parametrize("folder", FOLDERS, ids=_path)
def test_no_entries_of_a_folder_import_each_other_in_a_circle(folder):
    """Of every folder's modules and packages; six circles once held the rooms together."""
    here = _name(folder / "__init__.py")
    graph = {name: set() for name in _children(folder)}
    for path in folder.rglob("*.py"):
        if path.parent == folder and path.stem.startswith("__"):
            continue
        own = path.relative_to(folder).parts[0].removesuffix(".py")
        inside = {name for name in _imported(path) if name.startswith(f"{here}.")}
        graph[own] |= {name.removeprefix(f"{here}.").split(".")[0] for name in inside} - {own}
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"{here}: a circle of imports: {' <- '.join(error.args[1])}")


def _exists(dotted: str) -> bool:
    """Whether a dotted name is a module of ours, or a name that one of them defines."""
    if dotted in MODULES:
        return True
    module, _, name = dotted.rpartition(".")
    if module not in MODULES:
        return False
    path = ROOT / Path(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return any(getattr(node, "name", None) == name for node in tree.body)


def test_the_map_of_modules_names_what_exists():
    """Where to find what: a stranger took six minutes to find where the ground is estimated."""
    text = (ROOT / "docs" / "modules.md").read_text(encoding="utf-8")
    rows = text.split("## Where to find")[1].split("\n## ")[0]
    named = re.findall(r"`((?:recon|priors|observations)\.[\w.]+)`", rows)
    assert len(named) > 15
    assert [name for name in named if not _exists(name)] == []


def test_the_map_of_modules_has_every_room():
    text = (ROOT / "docs" / "modules.md").read_text(encoding="utf-8")
    told = set(re.findall(r"^\* `([\w.]+)`: ", text, flags=re.MULTILINE))
    rooms = [ROOT / "priors", ROOT / "observations"]
    rooms += [path.parent for path in (ROOT / "recon").glob("*/__init__.py")]
    assert {_name(room / "__init__.py") for room in rooms} <= told


def test_a_public_class_has_a_name_of_its_own():
    """`Clip` was four classes, `Windows`, `Place`, `Piece`, `Parts` and `View` were two each."""
    places: dict[str, list[str]] = {}
    for path in SOURCES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(_name(path))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
