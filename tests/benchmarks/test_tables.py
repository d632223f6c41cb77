"""Documents say what the result files say, and nothing measured that they do not say."""

import re
from pathlib import Path

import pytest

from benchmarks.all import COMMANDS, placed
from benchmarks.results import RESULTS, ROOT
from benchmarks.tables.catalogue import TABLES
from benchmarks.tables.page import documents, filled, loose_numbers, used
from benchmarks.tables.values import markdown, mean, number, result, source

PAGES = documents()
PROSE = [path for path in PAGES if "weights" not in path.parent.name]
"""Cards of weights keep the numbers of their training."""


@pytest.mark.parametrize("path", PAGES, ids=[path.name for path in PAGES])
def test_tables_are_those_of_the_result_files(path: Path) -> None:
    """Numbers of documents were typed by hand, and some had no result file any more."""
    text = path.read_text(encoding="utf-8")
    assert filled(text, TABLES, path.name) == text, "run make tables"


def test_every_table_stands_in_a_document() -> None:
    shown = [name for path in PAGES for name in used(path.read_text(encoding="utf-8"))]
    assert set(shown) == set(TABLES)


def test_one_page_leads_to_all_tables() -> None:
    """Six of the fifteen pages with tables were linked from the page of results."""
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    index = text.split("## All tables")[1].split("\n## ")[0]
    pages = [path for path in PROSE if used(path.read_text(encoding="utf-8"))]
    missing = [p.name for p in pages if p.name != "results.md" and f"]({p.name}" not in index]
    assert missing == []
    cells = [line.split("|")[2] for line in index.splitlines() if line.startswith("| [")]
    named = {name.split()[0] for cell in cells for name in re.findall(r"`([^`]+)`", cell)}
    assert len(named) > 40
    gone = [name for name in named if not _is_benchmark(name)]
    assert gone == [], "named in the index, and no benchmark"


def _is_benchmark(name: str) -> bool:
    stem = ROOT / "benchmarks" / Path(*name.split("."))
    return stem.is_dir() or stem.with_suffix(".py").is_file() or name == "anchor_..."


@pytest.mark.parametrize("path", PROSE, ids=[path.name for path in PROSE])
def test_no_table_of_numbers_is_typed_by_hand(path: Path) -> None:
    assert list(loose_numbers(path.read_text(encoding="utf-8"))) == []
    assert list(loose_numbers("| a | b |\n|---|---|\n| one | **1.5** ± 2 |"))


def test_result_files_of_tables_have_their_command() -> None:
    """Result files held no arguments, no commit and no data."""
    for name in sorted(path.stem for path in RESULTS.glob("*.json")):
        about = result(name).get("about", {})
        if name not in COMMANDS:
            assert "commit" in about, f"{name}: no command of benchmarks.all makes it"
            continue
        assert about["command"].startswith("python -m benchmarks.")
        for key in ("seed", "recon", "python", "torch", "numpy", "machine"):
            assert key in about, f"{name} does not say {key}"
        if "commit" in about:
            assert {"date", "data"} <= set(about), name
            assert not about["commit"].endswith("+"), f"{name}: of uncommitted code"
        paths = [word for word in about["command"].split() if word.startswith("/")]
        assert paths == [], f"{name}: paths of one machine"


def test_commands_are_given_their_folders() -> None:
    places = {"CORPUS": "/data/corpus"}
    assert placed("CORPUS", places, Path("/out")) == "/data/corpus"
    assert placed("STUDY", places, Path("/out")) == "/out/study"
    assert placed("--only", places, Path("/out")) == "--only"


def test_a_changed_number_is_noticed_and_put_right() -> None:
    tables = {"a": lambda: markdown(["x", "y"], [["one", number(1.234, 100, 1)]])}
    text = "before\n<!-- table a -->\n| one | 999 |\n<!-- end a -->\nafter\n"
    new = filled(text, tables, "page")
    assert "| one | 123.4 |" in new
    assert "999" not in new
    assert new.startswith("before\n")
    assert new.endswith("after\n")
    assert filled(new, tables, "page") == new


@pytest.mark.parametrize(
    "text",
    [
        "<!-- table b -->\n<!-- end b -->",
        "<!-- table a -->\n<!-- end b -->",
        "<!-- table a -->\nno end",
        "<!-- end a -->",
    ],
)
def test_markers_without_a_table_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="page"):
        filled(text, {"a": lambda: "", "c": lambda: ""}, "page")


def test_means_leave_16_out_whatever_a_file_averaged() -> None:
    rows = {s: {"e": v} for s, v in {"07": 1.0, "16": 100.0, "49": 2.0, "d2C": 3.0}.items()}
    assert mean({**rows, "mean": {"e": 26.5}}, "e") == 2.0
    assert mean({"07": {"e": None}}, "e") is None
    assert number(None) == "–"


def test_old_results_say_that_they_are_old() -> None:
    line = source("fuzz")
    if "commit" not in result("fuzz")["about"]:
        assert "version 0.1.0" in line
    else:
        assert "commit" in line
