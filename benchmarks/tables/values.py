"""Numbers of result files, as cells of tables."""

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from benchmarks.results import RESULTS
from recon.benchmark.dataset import Splits
from recon.benchmark.table import Interval, interval, paired

SUBJECTS = ("07", "49", "d2C")
"""The test subjects over whom means are taken; 16 stands in a row of its own."""
APART = "16"
NONE = "–"


@cache
def result(name: str) -> dict[str, Any]:
    """A result file."""
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def present(names: Iterable[str]) -> list[str]:
    """Result files that have been made, out of some."""
    return [name for name in names if (RESULTS / f"{name}.json").is_file()]


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column on the left, the others on the right."""
    lines = [headings, ["---", *["--:"] * (len(headings) - 1)], *rows]
    if any(len(line) != len(headings) for line in lines):
        raise ValueError(f"a row has not {len(headings)} cells: {lines}")
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def number(value: float | None, factor: float = 1.0, digits: int = 1) -> str:
    """A value as a cell."""
    return NONE if value is None else f"{value * factor:.{digits}f}"


def mean(rows: Mapping[str, Mapping[str, Any]], metric: str) -> float | None:
    """Over the test subjects without 16, whoever else the file's own mean was taken over."""
    values = [rows[s][metric] for s in SUBJECTS if s in rows and rows[s].get(metric) is not None]
    return float(np.mean(values)) if values else None


def spread(estimate: Interval, factor: float = 1.0, digits: int = 2) -> str:
    """A mean and its 95 % interval as a cell."""
    three = (estimate.mean, estimate.low, estimate.high)
    middle, low, high = (f"{value * factor:.{digits}f}" for value in three)
    return f"{middle} [{low}, {high}]"


def belongs(window: str) -> str:
    """The subject of a window, by the committed splits."""
    return _splits().subject(window.rsplit("@", 1)[0])


@cache
def _splits() -> Splits:
    return Splits.load()


def estimated(rows: Mapping[str, Any], about: Mapping[str, Any], metric: str) -> Interval | None:
    """The mean over test subjects, where a row kept the values of its windows; else None."""
    values = rows.get("windows", {}).get(metric)
    if values is None or all(value is None for value in values):
        return None
    return interval(*_counted(about, rows, values))


def difference(
    rows: Mapping[str, Any], others: Mapping[str, Any], about: Mapping[str, Any], metric: str
) -> Interval:
    """`rows` - `others`, window by window."""
    values, clips, subjects = _counted(about, rows, rows["windows"][metric])
    return paired(values, _counted(about, others, others["windows"][metric])[0], clips, subjects)


def _counted(
    about: Mapping[str, Any], rows: Mapping[str, Any], values: Sequence[float | None]
) -> tuple[list[float | None], list[str], list[str]]:
    """Values, clips and subjects of the windows that count in means."""
    subject = dict(zip(about["names"], about["subjects"], strict=True))
    names = rows["windows"].get("names", about["names"])
    kept = [
        (value, name.rsplit("@", 1)[0], subject[name])
        for value, name in zip(values, names, strict=True)
        if subject[name] not in about["apart"]
    ]
    return [v for v, _, _ in kept], [c for _, c, _ in kept], [s for _, _, s in kept]


def source(*names: str) -> str:
    """A paragraph under a table that says where its numbers are from."""
    return "\n".join(["", "", *(_said(name) for name in names)])


def _said(name: str) -> str:
    about = result(name)["about"]
    command, link = about["command"], f"`{name}.json`"
    if about.get("commit") is None:
        splits = ", on its splits and windows" if "CORPUS" in command else ""
        return f"*{link}: measured with version {about['recon']}{splits} (`{command}`).*"
    return f"*{link}: `{command}`, commit {about['commit'][:9]}, {about['date']}.*"
