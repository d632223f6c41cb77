"""The examples run, and the documents know all of them."""

import re
import runpy
import sys

import pytest

from tests.documents.blocks import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
QUICK = ("08_own_sensor.py", "09_own_prior.py", "11_socket.py")
"""Run in every test run; the others are slow."""


@pytest.mark.parametrize(
    "path",
    [p if p.name in QUICK else pytest.param(p, marks=pytest.mark.slow) for p in EXAMPLES],
    ids=lambda path: path.name,
)
@pytest.mark.filterwarnings("default")
def test_examples_run(path, tmp_path, monkeypatch, capsys):
    """Example 11 lost moments that came while it wrote an estimate, and complained of the rest."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [path.name])
    runpy.run_path(str(path), run_name="__main__")
    said = capsys.readouterr().out
    assert said
    assert "expected" not in said


def test_examples_are_numbered_without_gaps():
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))
    for path in EXAMPLES:
        text = path.read_text(encoding="utf-8")
        assert f"    python examples/{path.name}" in text, f"{path.name}: says another name"


def test_every_example_is_in_the_navigation():
    shown = re.findall(r"examples/(\w+)\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert sorted(shown) == [path.stem for path in EXAMPLES]
