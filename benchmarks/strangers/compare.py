"""HuMoR against the pose prior on strangers: ratios of errors and contacts, with 95 % intervals.

Within a fold whole clips are drawn again; where there are fewer than `FEWEST`, its windows are,
which share no frame. Over all folds the folds are drawn again, too: how the mean would move with
other people is what leave-one-person-out is for.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.protocol import Cell, Table, spread
from benchmarks.strangers.fits import HUMOR, POSE
from recon.benchmark.table import DRAWS, LEVEL, MeanWithInterval

Row = Mapping[str, Any]
"""Fields of `benchmarks.strangers.fits.Row`, as the folder of the folds keeps them."""
Rows = Sequence[Row]
Sums = Float[np.ndarray, "units sums"]
"""Sums over the windows of every unit that is drawn."""
Statistic = Callable[[Float[np.ndarray, "*draws sums"]], Float[np.ndarray, "*draws"]]

FEWEST = 4
"""Clips below which windows are drawn."""


def ratio(rows: Rows, protocol: str) -> Sums | None:
    """Sums of an error under HuMoR and under the pose prior; None where no window has it."""
    return _by_unit(rows, protocol, lambda pose, humor: (humor["error"], pose["error"]))


def slip(rows: Rows, protocol: str) -> Sums | None:
    """Sums of slip under HuMoR and of the truth."""
    return _by_unit(rows, protocol, lambda _, humor: (humor["slip"], humor["slip_truth"]))


def contacts(rows: Rows, protocol: str) -> Sums | None:
    """Counts of contacts by the motion under HuMoR, then by that under the pose prior."""
    return _by_unit(rows, protocol, lambda pose, humor: (humor["labels"], pose["labels"]))


def network(rows: Rows, protocol: str) -> Sums | None:
    """Counts of contacts by HuMoR's network, then by the motion that was found with its help."""
    return _by_unit(rows, protocol, lambda _, humor: (humor["network"], humor["labels"]))


def quotient(sums: Float[np.ndarray, "*draws 2"]) -> Float[np.ndarray, "*draws"]:
    """First sum over second."""
    return sums[..., 0] / sums[..., 1]


def balanced(counts: Float[np.ndarray, "*draws 4"]) -> Float[np.ndarray, "*draws"]:
    """Balanced accuracy of counts of `Row.network`; of one kind alone where there is no other."""
    right = np.stack((counts[..., 0], counts[..., 2]), -1)
    all_of_it = np.stack((counts[..., 1], counts[..., 3]), -1)
    shares = np.divide(right, all_of_it, out=np.full_like(right, np.nan), where=all_of_it > 0)
    return np.nanmean(shares, -1)


def more_balanced(counts: Float[np.ndarray, "*draws 8"]) -> Float[np.ndarray, "*draws"]:
    """Balanced accuracy of the first four counts less that of the others."""
    return balanced(counts[..., :4]) - balanced(counts[..., 4:])


def estimated(sums: Sums, statistic: Statistic) -> MeanWithInterval:
    """A statistic of one fold."""
    drawn = _resampled(sums, statistic, np.random.default_rng(0))
    return _estimate(float(statistic(sums.sum(0))), drawn)


def over_people(folds: Sequence[Sums], statistic: Statistic) -> MeanWithInterval:
    """The mean of a statistic over folds."""
    random = np.random.default_rng(0)
    each = np.stack([_resampled(sums, statistic, random) for sums in folds])
    who = random.integers(0, len(folds), (len(folds), DRAWS))
    drawn = np.take_along_axis(each, who, 0).mean(0)
    return _estimate(float(np.mean([statistic(sums.sum(0)) for sums in folds])), drawn)


def _by_unit(
    rows: Rows, protocol: str, compared: Callable[[Row, Row], tuple[Any, Any]]
) -> Sums | None:
    """Sums over windows of what is compared in the rows by the pose prior and by HuMoR."""
    found: dict[tuple[str, int], dict[str, Row]] = {}
    for row in rows:
        if row["protocol"] == protocol:
            found.setdefault((row["window"], row["frames"]), {})[row["method"]] = row
    pairs = {window: compared(by[POSE], by[HUMOR]) for window, by in found.items()}
    kept = [(window, own) for window, own in pairs.items() if None not in own]
    if len(kept) == 0:
        return None
    clips = [name.rsplit("@", 1)[0] for (name, _), _ in kept]
    units = clips if len(set(clips)) >= FEWEST else [str(window) for window, _ in kept]
    sums: dict[str, np.ndarray] = {}
    for unit, (_, own) in zip(units, kept, strict=True):
        sums[unit] = sums.get(unit, 0.0) + np.array(own, dtype=float).ravel()
    return np.stack(list(sums.values()))


def _resampled(
    sums: Sums, statistic: Statistic, random: np.random.Generator
) -> Float[np.ndarray, " draws"]:
    drawn = random.integers(0, len(sums), (DRAWS, len(sums)))
    return statistic(sums[drawn].sum(1))


def _estimate(mean: float, drawn: Float[np.ndarray, " draws"]) -> MeanWithInterval:
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.nanpercentile(drawn, (tail, 100 - tail))
    return MeanWithInterval(mean, float(low), float(high))


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
    return {"strangers": Table([("fold", None), *COLUMNS], folds, note=note)}


def _name(name: str, fold: Mapping[str, Any]) -> str:
    people = ", ".join(fold["people"])
    return name if name == people else f"{name} ({people})"


def _cells(folds: Sequence[Rows]) -> Iterator[Cell]:
    for protocol in PROTOCOLS:
        yield _compared([ratio(rows, protocol) for rows in folds], quotient)
    for counted in (contacts, network):
        sums = [counted(rows, _CONTACTS) for rows in folds]
        yield _compared(sums, more_balanced, factor=100)
    yield _compared([slip(rows, _CONTACTS) for rows in folds], quotient)


def _compared(sums: Sequence[Sums | None], statistic: Statistic, factor: float = 1.0) -> Cell:
    """A statistic with its interval; the mean over folds where there are several."""
    present = [own for own in sums if own is not None]
    if len(present) == 0:
        return None
    if len(sums) == 1:
        return spread(estimated(present[0], statistic), factor)
    return spread(over_people(present, statistic), factor)
