"""The house rules that a machine can check."""

import ast
import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("recon", "priors", "observations")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
SURVIVES = ROOT / "recon" / "workers.py"
"""The one file that catches everything: whatever goes wrong with one of many jobs is its own."""
TREE = [
    *SOURCES,
    *(p for f in ("tests", "benchmarks", "scripts") for p in (ROOT / f).rglob("*.py")),
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
            known = ("BaseException",) if path == SURVIVES else ("Exception", "BaseException")
            assert node.type.id not in known, f"{path}:{node.lineno}"
        if isinstance(node, ast.ImportFrom):
            assert node.module != "__future__", f"{path}: shapes are checked, so no lazy ones"
    assert ast.get_docstring(tree), f"{path} does not say what it is"
    assert path.name not in ("utils.py", "helpers.py", "misc.py", "common.py")


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.name)
@pytest.mark.filterwarnings("default")
def test_examples_run(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [path.name])
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out


def test_another_package_of_the_name_is_noticed(monkeypatch):
    import recon

    monkeypatch.delattr(recon, "__distribution__")
    monkeypatch.delitem(sys.modules, "observations", raising=False)
    with pytest.raises(ImportError, match="not motion-recon"):
        __import__("observations")
