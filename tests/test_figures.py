"""`scripts.figures` counts a small checkout right, and tells which figure is too much."""

import ast
import json
import os
import subprocess
import sys
from textwrap import dedent

import pytest

from scripts.figures import MEANINGS, ROOT, counted, exceeded, protocols, statements, table

CHECKOUT = {
    "recon/__init__.py": '''
        """One line."""

        from types import SimpleNamespace as _Record

        import numpy as _np


        class Joints3D:
            def __init__(self, *data, fps): ...


        class BodyModel:
            @staticmethod
            def load():
                joints = _Record(numpy=lambda: _np.zeros((30, 22, 3)))
                return _Record(pose=lambda motion: _Record(joints=joints))


        class Motion:
            @staticmethod
            def create(*data, fps): ...


        def __getattr__(name):
            if name != "fit":
                raise AttributeError(name)
            import recon.fitting.solver

            return recon.fitting.solver.fit


        def __dir__():
            return [*globals(), "fit"]
        ''',
    "recon/__main__.py": 'print("usage: recon [-h] {fit,demo} ...")\n',
    "recon/fitting/__init__.py": "",
    "recon/fitting/solver.py": """
        from typing import Protocol


        class Prior(Protocol): ...


        def fit(seen):
            return [_step(x) for x in (1, 2)]


        def _step(x):
            return (lambda: x)()


        def never(): ...
        """,
    "recon/unused.py": "x = 1\n",
    "tests/test_it.py": "a = 1\nb = 2\n",
    "benchmarks/run.py": "a = 1\n",
    "benchmarks/results.py": "",
    "benchmarks/results/run.json": "{}",
    "docs/migration.md": "not counted",
    "docs/start/one.md": "| two | words |",
    "README.md": "three words here",
    "CHANGELOG.md": "not counted",
}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A repository of CHECKOUT's files with one more that git does not track."""
    patch = pytest.MonkeyPatch()
    # within a hook of git these name the repository of the hook
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        patch.delenv(name)
    root = tmp_path_factory.mktemp("checkout")
    for name, text in CHECKOUT.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(dedent(text).removeprefix("\n"), encoding="utf-8", newline="\n")
    subprocess.run(["git", "init", "--quiet"], cwd=root, check=True)
    subprocess.run(["git", "add", "."], cwd=root, check=True)
    (root / "recon" / "untracked.py").write_text("y = 2\n", encoding="utf-8")
    yield root.resolve()
    patch.undo()


def test_figures_of_a_small_checkout(checkout):
    lines = {
        name: len((checkout / name).read_text(encoding="utf-8").splitlines())
        for name in CHECKOUT
        if name.startswith("recon/")
    }
    loaded = ("recon/__init__.py", "recon/fitting/__init__.py", "recon/fitting/solver.py")
    assert counted(checkout) == {
        "statements": 30,
        "statements_all": 31,
        "docstring_percent": round(100 / sum(lines.values()), 1),
        "first_fit_modules": 3,
        "first_fit_lines": sum(lines[name] for name in loaded),
        # recon.__getattr__, recon.Joints3D.__init__, the body of Prior, fit and _step
        "first_fit_functions": 5,
        "first_fit_files": 2,
        "files": 5,
        "longest_file": lines["recon/__init__.py"],
        "median_file": 1,
        "folders": 2,
        "levels": 2,
        "protocols": 1,
        "names": 4,
        "verbs": 2,
        "words": 8,
        "result_bytes": 2,
        "benchmark_lines": 1,
        "test_lines": 2,
    }


def test_docstrings_are_no_statements():
    source = '''
"""Of a module."""
SIZE = 3
"""Of a constant."""
def f():
    """Of a function."""
    if SIZE:
        return 1
    "".join([])
'''
    assert statements(ast.parse(source)) == 6


@pytest.mark.parametrize(
    ("bases", "is_one"),
    [("Protocol", 1), ("Protocol[T]", 1), ("typing.Protocol", 1), ("A, Protocol", 1), ("A", 0)],
)
def test_protocols_are_told_by_their_base(bases, is_one):
    assert protocols(ast.parse(f"class One({bases}): ...")) == is_one


def test_a_figure_above_its_ceiling_is_told():
    limits = {"files": {"ceiling": 3, "asked": 2}, "folders": {"ceiling": 2}}
    assert exceeded({"files": 3, "folders": 1}, limits) == []
    (told,) = exceeded({"files": 4, "folders": 2}, limits)
    assert told.startswith("files: 4 is above the ceiling of 3")
    assert table({"files": 1234}, limits).splitlines()[1].split()[:3] == ["1,234", "3", "2"]


def test_the_gate_fails_by_its_exit_status(checkout, tmp_path):
    """With the ceilings of the project a small checkout passes; below zero nothing does."""
    gate = ["-m", "scripts.figures", "--json", "--gate", "--root", str(checkout)]
    passed = subprocess.run([sys.executable, *gate], cwd=ROOT, capture_output=True, check=True)
    assert json.loads(passed.stdout).keys() == MEANINGS.keys()
    limits = tmp_path / "limits.toml"
    limits.write_text("files = { ceiling = 4 }\n", encoding="utf-8")
    failed = subprocess.run(
        [sys.executable, *gate, "--limits", str(limits)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert failed.returncode == 1
    assert "files: 5 is above the ceiling of 4" in failed.stderr
    limits.write_text("fles = { ceiling = 4 }\n", encoding="utf-8")
    refused = subprocess.run(
        [sys.executable, *gate, "--limits", str(limits)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "no figure is called fles" in refused.stderr
