"""Real markers below 0.9 m hidden: runs, walks and jumps, by people and by recordings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.real import EVERYTHING, HUMOR, POSE, load_list
from benchmarks.strangers.compare import Statistic, estimated, over_people, quotient
from benchmarks.tables.values import markdown, number, result, source, spread
from recon.benchmark.table import Interval

Rows = Sequence[Mapping[str, Any]]
ROWS = ("runs", "walks", "jumps")


def means() -> str:
    """Mean errors over people of each kind of motion, with 95 % intervals.

    Where a run was ended early, recordings that are not measured are counted, too.
    """
    found = list(result("real")["recordings"].values())
    listed = load_list()
    rows = []
    for kind in ROWS:
        own = [row for row in found if row["row"] == kind]
        people = sorted({row["person"] for row in own})
        cells = [spread(mean_over_people(own, label), 1, 1) for label in (POSE, HUMOR, EVERYTHING)]
        ratio = spread(_over(_sums(own, HUMOR, POSE), quotient))
        count = f"{len(own)} of {sum(one.row == kind for one in listed)}"
        rows.append([kind, str(len(people)), count, *cells, ratio])
    headings = ["hidden markers, cm", "people", "recordings measured", "stages 1-2", "collocation",
                "nothing hidden", "collocation / stages 1-2"]  # fmt: skip
    return markdown(headings, rows) + source("real")


def recordings() -> str:
    """Each recording, those of no mean last."""
    rows = [
        [row["path"], row["person"], row["row"] + (f": {row['why']}" if row["why"] else ""),
         *(number(row["error_cm"][label]) for label in (POSE, HUMOR, EVERYTHING))]
        for row in result("real")["recordings"].values()
    ]  # fmt: skip
    headings = ["recording, cm", "person", "counted among", "stages 1-2", "collocation",
                "nothing hidden"]  # fmt: skip
    return markdown(headings, rows) + source("real")


def mean_over_people(rows: Rows, label: str) -> Interval:
    """The mean error of a kind of fit over people, centimetres."""
    return _over(_sums(rows, label, None), quotient)


def _over(sums: Sequence[Float[np.ndarray, "recordings 2"]], statistic: Statistic) -> Interval:
    """The mean over people, who are drawn again where there are several, and their recordings."""
    return estimated(sums[0], statistic) if len(sums) == 1 else over_people(sums, statistic)


def _sums(rows: Rows, label: str, other: str | None) -> list[Float[np.ndarray, "recordings 2"]]:
    """Errors of each recording beside other ones, or beside its count of one, by person."""
    by_person: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        errors = row["error_cm"]
        pair = errors[label], 1.0 if other is None else errors[other]
        by_person.setdefault(row["person"], []).append(pair)
    return [np.array(own) for own in by_person.values()]
