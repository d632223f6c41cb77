"""Weights that were trained again, beside those that are shipped."""

from typing import Any

from benchmarks.real import HUMOR
from benchmarks.tables.real import ROWS, mean_over_people
from benchmarks.tables.values import markdown, number, result, source, spread

AGAIN = "_retrained"
"""The ending of the names of result files that were measured with the weights trained again."""
_MEASURED = (
    ("humor", "noisy joints", "joints_all", "noisy joints"),
    ("humor_hidden", "occluded points", "observed_hidden", "hidden points"),
)


def beside() -> str:
    """Errors of the default method with both."""
    rows: list[list[str]] = []
    for name, protocol, metric, told in _MEASURED:
        both = [_of(own, protocol) for own in (name, name + AGAIN)]
        for subject in ("mean", *sorted(set(both[0]) - {"mean", "windows"})):
            cells = [number(row[subject][metric], 100, 2) for row in both]
            rows.append([f"test, {told}, {subject}", *cells])
    real = [list(result(own)["recordings"].values()) for own in ("real", "real" + AGAIN)]
    for kind in ROWS:
        some = [[row for row in found if row["row"] == kind] for found in real]
        cells = [spread(mean_over_people(own, HUMOR), 1, 1) for own in some]
        rows.append([f"recordings, {kind}, markers below 0.9 m hidden", *cells])
    table = markdown(["cm", "shipped", "trained anew"], rows)
    names = [*(name for name, *_ in _MEASURED), "real"]
    return table + source(*(own for name in names for own in (name, name + AGAIN)))


def _of(name: str, protocol: str) -> dict[str, Any]:
    return result(name)["tables"]["60 frames"][protocol]["HuMoR"]
