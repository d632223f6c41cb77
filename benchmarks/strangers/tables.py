"""Tables of people whom the priors never saw: folds, errors and kinds of motion."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.protocol import DASH, Cell, Table, number, spread
from benchmarks.strangers import compare
from benchmarks.strangers.compare import Rows, Statistic, Sums
from benchmarks.strangers.fits import HUMOR, POSE

COLUMNS = (
    ("noisy joints", 2), ("hidden points", 2), ("gap of 1 s", 2), ("runs, hidden legs", 2),
    ("contacts less pose prior's", 1), ("network's contacts less the fit's", 1),
    ("slip / true slip", 2),
)  # fmt: skip
PROTOCOLS = ("noisy joints", "hidden points", "gap", "hidden legs")
_CONTACTS = "noisy joints"
"""Protocol in which contacts and slip are compared."""


def tables(found: Mapping[str, Any], note: str) -> dict[str, Table]:
    """All tables of the folds that are measured."""
    rows = {name: fold["rows"] for name, fold in found.items()}
    folds = [[_name(name, found[name]), *_cells([own])] for name, own in rows.items()]
    if len(rows) > 1:
        folds.append([f"**all {len(rows)}**", *_cells(list(rows.values()))])
    errors = ("windows", "noisy joints", "hidden points", "gap of 1 s", "runs, hidden legs",
              "contacts %: pose prior, HuMoR, its network alone",
              "drift of ten own steps")  # fmt: skip
    people = [_errors(name, fold) for name, fold in found.items()]
    columns = [(head, 1 if head.startswith("drift") else 0) for head in errors]
    return {
        "strangers": Table([("fold", None), *COLUMNS], folds, note=note),
        "strangers-people": Table([("cm: pose prior, HuMoR", None), *columns], people, note=note),
        "strangers-kinds": Table([("kind of motion", None), *COLUMNS], _by_kind(rows), note=note),
    }


def _by_kind(folds: Mapping[str, Rows]) -> list[list[Cell]]:
    """Ratios of errors for every kind of motion, over the windows of all folds."""
    rows = [row for own in folds.values() for row in own]
    made: list[list[Cell]] = []
    for kind in sorted({row["kind"] for row in rows}):
        own = [row for row in rows if row["kind"] == kind]
        windows = {(row["window"], row["frames"]) for row in own}
        persons = sorted({row["person"] for row in own})
        made.append([f"{kind}, {len(windows)} windows of {', '.join(persons)}", *_cells([own])])
    return made


def _name(name: str, fold: Mapping[str, Any]) -> str:
    people = ", ".join(fold["people"])
    return name if name == people else f"{name} ({people})"


def _cells(folds: Sequence[Rows]) -> Iterator[Cell]:
    for protocol in PROTOCOLS:
        yield _estimate([compare.ratio(rows, protocol) for rows in folds], compare.quotient)
    for counted in (compare.contacts, compare.network):
        sums = [counted(rows, _CONTACTS) for rows in folds]
        yield _estimate(sums, compare.more_balanced, factor=100)
    yield _estimate([compare.slip(rows, _CONTACTS) for rows in folds], compare.quotient)


def _estimate(sums: Sequence[Sums | None], statistic: Statistic, factor: float = 1.0) -> Cell:
    """A statistic with its interval; the mean over folds where there are several."""
    present = [own for own in sums if own is not None]
    if len(present) == 0:
        return None
    if len(sums) == 1:
        return spread(compare.estimated(present[0], statistic), factor)
    return spread(compare.over_people(present, statistic), factor)


def _errors(name: str, fold: Mapping[str, Any]) -> list[Cell]:
    """Errors themselves, of both priors."""
    rows = fold["rows"]
    windows = {(row["window"], row["frames"]) for row in rows}
    counts = [counted(rows, _CONTACTS) for counted in (compare.contacts, compare.network)]
    totals = [own.sum(0) for own in counts if own is not None]
    shares = [*(total[4:] for total in totals), *(total[:4] for total in totals[1:])]
    said = ", ".join(f"{100 * float(compare.balanced(share)):.1f}" for share in shares)
    pairs = [_pair(rows, protocol) for protocol in PROTOCOLS]
    return [_name(name, fold), len(windows), *pairs, said or DASH, number(fold["drift"], 100)]


def _pair(rows: Rows, protocol: str) -> str:
    own = [row for row in rows if row["protocol"] == protocol and row["error"] is not None]
    errors = ([row["error"] for row in own if row["method"] == m] for m in (POSE, HUMOR))
    means = [100 * float(np.mean(one)) for one in errors if one]
    return ", ".join(f"{mean:.2f}" for mean in means) if len(means) == 2 else DASH
