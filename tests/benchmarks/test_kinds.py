"""Limits by kind of motion: which windows are put together, and in which order."""

import pytest

from benchmarks.tables.kinds import COLUMNS, lines


def window(name: str, kind: str, error: float, told: str | None = None) -> dict[str, object]:
    return {"name": name, "subject": name[:2], "kind": kind, "told": told} | dict.fromkeys(
        COLUMNS, error
    )


def test_kinds_are_means_over_people_the_easiest_first() -> None:
    rows = [
        window("49_06@0.83", "other", 0.30, "cartwheel"),
        window("49_18@0.23", "other", 0.10, "balance"),
        window("07_01@0.20", "walk", 0.02),
        window("07_02@0.20", "walk", 0.04),
        window("49_01@0.20", "walk", 0.09),
    ]
    walk, other = lines(rows)
    assert walk[:2] == ["walk", "3 of 07, 49"]
    assert walk[2].startswith("6.0 [")  # (3 + 9) / 2, not 5: both people count alike
    assert other[:2] == ["other: balance; cartwheel", "2 of 49"]
    assert float(other[-1].split()[0]) == pytest.approx(20.0)
