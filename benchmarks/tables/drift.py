"""What HuMoR's networks can say of true motions: lines of a table from rows of windows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.tables.rollouts import ACROBATIC
from benchmarks.tables.values import markdown, number, result, source

HEADINGS = ["true motions", "speed m/s", "one step mm", "one step, nats", "surprise, nats",
            "errors added up, by thirds cm", "followed, by thirds cm"]  # fmt: skip


def drift() -> str:
    """Windows of acrobatics beside all others."""
    return markdown(HEADINGS, lines(result("drift")["rows"])) + source("drift")


def lines(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Means over windows, those of acrobatics apart; see `benchmarks.drift.Row`."""
    found: list[list[str]] = []
    for name, acrobatic in (("without acrobatics", False), ("acrobatics", True)):
        own = [row for row in rows if (row["subject"] == ACROBATIC) == acrobatic]
        if own:
            found.append([f"{name}, {len(own)} windows", *_cells(own)])
    return found


def _cells(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    def mean(name: str) -> float:
        return float(np.mean([row[name] for row in rows]))

    def thirds(name: str) -> str:
        values = np.mean([row[name] for row in rows], 0)
        return " ".join(number(float(value), 100, 1) for value in values)

    return [
        number(mean("speed"), 1, 2), number(mean("step"), 1000, 1), number(mean("nats"), 1, 0),
        number(mean("surprise"), 1, 0), thirds("added"), thirds("followed"),
    ]  # fmt: skip
