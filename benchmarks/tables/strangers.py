"""People whom the priors never saw: folds, protocols and kinds of motion."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.strangers import compare
from benchmarks.strangers.compare import Rows, Statistic, Sums
from benchmarks.strangers.fits import HUMOR, POSE
from benchmarks.tables.values import NONE, markdown, number, present, result, source, spread
from recon.benchmark.table import Interval

HEADINGS = ["fold", "noisy joints", "hidden points", "gap of 1 s", "runs, hidden legs",
            "contacts less pose prior's", "network's contacts less the fit's",
            "slip / true slip"]  # fmt: skip
PROTOCOLS = ("noisy joints", "hidden points", "gap", "hidden legs")
ALL = "all"
FILES = ("strangers_all",)
"""Result files; of a fold in several, the first one counts."""
_LATER = "*To be measured: `python -m benchmarks.strangers CORPUS FOLDS --json strangers.json`.*"
_CONTACTS = "noisy joints"
"""Protocol in which contacts and slip are compared."""


def folds() -> str:
    """Ratios of errors for every fold and over all."""
    return _measured(lambda found: markdown(HEADINGS, lines(found)))


def lines(found: Mapping[str, Any]) -> list[list[str]]:
    """One line for every fold, and one for their mean where there are several."""
    rows = {name: fold["rows"] for name, fold in found.items()}
    made = [[_name(name, found[name]), *_cells([own])] for name, own in rows.items()]
    if len(rows) > 1:
        made.append([f"**{ALL} {len(rows)}**", *_cells(list(rows.values()))])
    return made


def _name(name: str, fold: Mapping[str, Any]) -> str:
    people = ", ".join(fold["people"])
    return name if name == people else f"{name} ({people})"


def _cells(folds: Sequence[Rows]) -> Iterator[str]:
    for protocol in PROTOCOLS:
        sums = [compare.ratio(rows, protocol) for rows in folds]
        yield estimate_cell(sums, compare.quotient)
    for counted in (compare.contacts, compare.network):
        sums = [counted(rows, _CONTACTS) for rows in folds]
        yield estimate_cell(sums, compare.more_balanced, factor=100, digits=1)
    yield estimate_cell([compare.slip(rows, _CONTACTS) for rows in folds], compare.quotient)


def estimate_cell(
    sums: Sequence[Sums | None], statistic: Statistic, factor: float = 1.0, digits: int = 2
) -> str:
    """A statistic with its interval; the mean over folds where there are several."""
    present = [own for own in sums if own is not None]
    if len(present) == 0:
        return NONE
    found: Interval = (
        compare.estimated(present[0], statistic)
        if len(sums) == 1
        else compare.over_people(present, statistic)
    )
    return spread(found, factor, digits)


def people() -> str:
    """Errors themselves, of both priors, for every fold."""
    headings = ["cm: pose prior, HuMoR", "windows", *HEADINGS[1:5],
                "contacts %: pose prior, HuMoR, its network alone",
                "drift of ten own steps"]  # fmt: skip
    return _measured(
        lambda found: markdown(headings, [_errors(name, fold) for name, fold in found.items()])
    )


def _errors(name: str, fold: Mapping[str, Any]) -> list[str]:
    rows = fold["rows"]
    windows = {(row["window"], row["frames"]) for row in rows}
    counts = [counted(rows, _CONTACTS) for counted in (compare.contacts, compare.network)]
    totals = [own.sum(0) for own in counts if own is not None]
    shares = [*(total[4:] for total in totals), *(total[:4] for total in totals[1:])]
    said = ", ".join(number(float(compare.balanced(share)), 100) for share in shares) or NONE
    return [
        _name(name, fold),
        str(len(windows)),
        *(_pair(rows, protocol) for protocol in PROTOCOLS),
        said,
        number(fold["drift"], 100),
    ]


def _pair(rows: Rows, protocol: str) -> str:
    means = [_mean(rows, protocol, method) for method in (POSE, HUMOR)]
    return NONE if None in means else ", ".join(number(mean, 100, 2) for mean in means)


def _mean(rows: Rows, protocol: str, method: str) -> float | None:
    values = [
        row["error"]
        for row in rows
        if (row["protocol"], row["method"]) == (protocol, method) and row["error"] is not None
    ]
    return float(np.mean(values)) if values else None


def kinds() -> str:
    """Ratios of errors for every kind of motion, over the windows of all folds."""
    return _measured(_by_kind)


def _by_kind(found: Mapping[str, Any]) -> str:
    rows = [row for fold in found.values() for row in fold["rows"]]
    made: list[list[str]] = []
    for kind in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == kind]
        windows = {(row["window"], row["frames"]) for row in own}
        persons = sorted({row["person"] for row in own})
        made.append([f"{kind}, {len(windows)} windows of {', '.join(persons)}", *_cells([own])])
    return markdown(["kind of motion", *HEADINGS[1:]], made)


def _measured(table: Callable[[Mapping[str, Any]], str]) -> str:
    """A table of the folds that the result files have, which say how they were trained."""
    if not present(FILES):
        return _LATER
    schedule, found = result(FILES[0])["schedule"], folds_of(FILES)
    said = (
        f"HuMoR of width {schedule['width']}, {schedule['steps']} steps of "
        f"{schedule['windows']} windows from scratch."
    )
    return f"{table(found)}\n\n{said}{source(*FILES)}"


def folds_of(names: Sequence[str]) -> dict[str, Any]:
    """The folds of result files; of a fold in several, what the first of them says."""
    return {fold: own for name in reversed(names) for fold, own in result(name)["folds"].items()}
