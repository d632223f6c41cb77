"""Documents say what the result files say, and nothing measured that they do not say."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.all import COMMANDS, placed
from benchmarks.protocol import RESULTS, ROOT, Table, shown
from benchmarks.strangers.compare import over_people, quotient
from benchmarks.tables import documents, filled, loose_numbers, used

PAGES = documents()
PROSE = [path for path in PAGES if "weights" not in path.parent.name]
"""Cards of weights keep the numbers of their training."""


@pytest.mark.parametrize("path", PAGES, ids=[path.name for path in PAGES])
def test_tables_are_those_of_the_result_files(path: Path) -> None:
    """Numbers of documents were typed by hand, and some had no result file any more."""
    text = path.read_text(encoding="utf-8")
    assert filled(text, path.name) == text, "run make tables"


def test_every_result_is_shown_or_named_with_its_benchmark() -> None:
    """Tables stood on fifteen pages; nobody found six of them."""
    shown_ones = {name for path in PAGES for name in used(path.read_text(encoding="utf-8"))}
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert shown_ones == set(used(page))
    rows = [line.split("|") for line in page.splitlines() if re.match(r"\| `[\w-]+\.json`", line)]
    named = {name for row in rows for name in re.findall(r"`([\w-]+)\.json`", row[1])}
    assert shown_ones.isdisjoint(named)
    assert {path.stem for path in RESULTS.glob("*.json")} == shown_ones | named
    stems = [ROOT / "benchmarks" / name for row in rows for name in re.findall(r"`(\w+)`", row[2])]
    assert len(stems) > 10
    assert [p.name for p in stems if not (p.is_dir() or p.with_suffix(".py").is_file())] == []


@pytest.mark.parametrize("path", PROSE, ids=[path.name for path in PROSE])
def test_no_table_of_numbers_is_typed_by_hand(path: Path) -> None:
    assert list(loose_numbers(path.read_text(encoding="utf-8"))) == []
    assert list(loose_numbers("| a | b |\n|---|---|\n| one | **1.5** ± 2 |"))


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_a_result_is_small_and_says_who_measured_it(path: Path) -> None:
    """Result files held no arguments, no commit and no data, and 3.2 MB of single windows."""
    assert path.stat().st_size <= 10_000
    table = Table.read(path)
    assert table.about
    for about in table.about:
        assert about["command"].startswith("python -m benchmarks.")
        for key in ("seed", "recon", "python", "torch", "numpy", "machine"):
            assert key in about
        if about.get("commit") is not None:
            assert {"date", "data"} <= set(about)
            assert not about["commit"].endswith("+"), "of uncommitted code"
        paths = [word for word in about["command"].split() if word.startswith("/")]
        assert paths == [], "paths of one machine"


def test_commands_are_given_their_folders() -> None:
    """`2D`, a case of clouds, was taken for a folder of runs."""
    places = {"CORPUS": Path("/data/corpus")}
    assert placed("CORPUS", places, Path("/out")) == "/data/corpus"
    assert placed("CLOUDS_MIXED", places, Path("/out")) == "/out/clouds_mixed"
    assert placed("--only", places, Path("/out")) == "--only"
    assert placed("2D", places, Path("/out")) == "2D"


def test_every_command_has_a_benchmark() -> None:
    for module, *_ in COMMANDS.values():
        stem = ROOT / "benchmarks" / module
        assert stem.with_suffix(".py").is_file() or (stem / "__main__.py").is_file(), module


TABLE = Table(
    [("x", None), ("y", 1), ("z", 2)],
    [["one", 123.44, [1.234, 1.0, 2.0]], ["two", None, "3 of 4"]],
    [{"command": "python -m benchmarks.a", "commit": "0123456789", "date": "2026-01-02"}],
    "A note.",
)


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    TABLE.write(path)
    assert Table.read(path).markdown() == TABLE.markdown()
    assert json.loads(path.read_text())["rows"][0] == ["one", 123.44, [1.234, 1.0, 2.0]]
    assert TABLE.markdown().splitlines() == [
        "| x | y | z |", "| --- | --: | --: |", "| one | 123.4 | 1.23 [1.00, 2.00] |",
        "| two | – | 3 of 4 |", "", "A note.", "",
        "*Measured by `benchmarks.a` (commit 012345678, 2026-01-02).*",
    ]  # fmt: skip


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="2 cells"):
        Table([("x", None), ("y", 1)], [["one"]])


def test_old_results_say_that_they_are_old() -> None:
    old = Table(
        [("x", None)], [["one"]], [{"command": "python -m benchmarks.c", "recon": "0.1.0"}]
    )
    assert "version 0.1.0" in old.markdown()
    assert shown(None, 2) == "–"


def test_a_changed_number_is_noticed_and_put_right(tmp_path: Path) -> None:
    TABLE.write(tmp_path / "a.json")
    text = "before\n<!-- table a -->\n| one | 999 |\n<!-- end a -->\nafter\n"
    new = filled(text, "page", tmp_path)
    assert "| one | 123.4 |" in new
    assert "999" not in new
    assert new.startswith("before\n")
    assert new.endswith("after\n")
    assert filled(new, "page", tmp_path) == new


@pytest.mark.parametrize(
    "text",
    [
        "<!-- table b -->\n<!-- end b -->",
        "<!-- table a -->\n<!-- end b -->",
        "<!-- table a -->\nno end",
        "<!-- end a -->",
    ],
)
def test_markers_without_a_table_are_refused(text: str, tmp_path: Path) -> None:
    TABLE.write(tmp_path / "a.json")
    with pytest.raises(ValueError, match="page"):
        filled(text, "page", tmp_path)


def test_other_people_are_drawn_where_ratios_are_averaged() -> None:
    """With people that stay, an interval would say nothing of anybody else."""
    errors = 0.01 * np.arange(1, 7)
    people = [np.stack([factor * errors, errors], -1) for factor in (0.6, 0.8, 1.0)]
    alone, found = (over_people(some, quotient) for some in (people[1:2], people))
    assert alone.mean == pytest.approx(0.8)
    assert (alone.low, alone.high) == pytest.approx((0.8, 0.8))  # paired: every window says so
    assert found.mean == pytest.approx(0.8)
    assert found.low < 0.7
    assert found.high > 0.9
