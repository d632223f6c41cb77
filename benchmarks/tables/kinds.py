"""Limits by kind of motion: errors of windows that show the same kind."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.tables.values import markdown, present, result, source, spread
from recon.benchmark.table import interval

HEADINGS = ["kind of motion", "windows", "noisy joints cm: pose prior", "collocation",
            "hidden points cm: pose prior", "collocation"]  # fmt: skip
COLUMNS = ("noisy-joints, pose", "noisy-joints, collocation",
           "hidden-points, pose", "hidden-points, collocation")  # fmt: skip


def kinds() -> str:
    """Every kind of motion, the easiest first, with intervals over its clips."""
    if not present(["failures"]):
        return "*To be measured: `python -m benchmarks.failures CORPUS --json failures.json`.*"
    return markdown(HEADINGS, lines(result("failures")["rows"])) + source("failures")


def lines(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Means over subjects of their windows of a kind; see `benchmarks.failures`."""
    found: list[tuple[float, list[str]]] = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        clips = [row["name"].rsplit("@", 1)[0] for row in own]
        people = [row["subject"] for row in own]
        means = [interval([row[column] for row in own], clips, people) for column in COLUMNS]
        told = sorted({row["told"] for row in own if row["told"] is not None})
        name = f"{kind}: {'; '.join(told)}" if told else kind
        count = f"{len(own)} of {', '.join(sorted(set(people)))}"
        found.append((means[-1].mean, [name, count, *(spread(one, 100, 1) for one in means)]))
    return [line for _, line in sorted(found, key=lambda one: one[0])]
