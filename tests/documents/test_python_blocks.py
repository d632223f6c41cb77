"""Python of the documents: names and arguments exist, and pages run from top to bottom."""

import ast
import importlib
import inspect
from dataclasses import fields

import pytest

import recon
from recon.fitting.settings import ReadOptions
from tests.documents.blocks import PAGES, ROOT, Block, blocks
from tests.documents.readers import names_of_readers

PYTHON = [block for page in PAGES for block in blocks(page, "python")]
READING = [one.name for one in fields(ReadOptions)]
RUN = [page for page in PAGES if blocks(page, "python")]
QUICK = [ROOT / "README.md", ROOT / "docs" / "plugins.md", ROOT / "docs" / "sensors" / "points.md"]
"""Pages that are run in every test run; the others are slow."""


@pytest.mark.parametrize("block", PYTHON, ids=str)
def test_names_and_arguments_of_blocks_exist(block: Block) -> None:
    """Blocks named functions that had been moved or never were."""
    for node in ast.walk(ast.parse(block.code)):
        match node:
            case ast.ImportFrom(module=str(module), names=names):
                home = importlib.import_module(module)
                missing = [one.name for one in names if not hasattr(home, one.name)]
                assert missing == [], f"{block}: {module} has no {missing}"
            case ast.Attribute(value=ast.Name(id="recon"), attr=name):
                assert hasattr(recon, name), f"{block}: recon has no {name}"
            case ast.Call(func=ast.Attribute(value=ast.Name(id="recon"), attr=name)):
                known = inspect.signature(getattr(recon, name)).parameters
                given = {one.arg for one in node.keywords if one.arg is not None}
                if "how" in known or "reading" in known:  # what `recon.fit` takes, and readers
                    known = {*known, *inspect.signature(recon.fit).parameters, *READING}
                assert given <= set(known), f"{block}: recon.{name} takes no {given - set(known)}"
            case _:
                pass


@pytest.mark.parametrize(
    "page",
    [p if p in QUICK else pytest.param(p, marks=pytest.mark.slow) for p in RUN],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_pages_run(page, tmp_path, monkeypatch):
    """All Python blocks of a page in their order, with what `readers` gives them."""
    monkeypatch.chdir(tmp_path)
    space = names_of_readers(tmp_path)
    for block in blocks(page, "python"):
        exec(compile(block.code, str(block), "exec"), space)
