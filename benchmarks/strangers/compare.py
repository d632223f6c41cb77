"""Compares HuMoR with the pose prior on unseen people: ratios of errors and contacts.

For 95 % intervals, whole clips are resampled within a fold, or windows, which share no frame, if
there are fewer clips than `FEWEST`. Over all folds the folds are resampled, too, since the
interval is to show how the mean would change with other people.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.protocol import Cell, Table, spread
from benchmarks.strangers.fits import HUMOR, POSE
from recon.benchmark.table import DRAWS, LEVEL, MeanWithInterval

Row = Mapping[str, Any]
"""Fields of `benchmarks.strangers.fits.Row`, as read from the folder of the folds."""
Rows = Sequence[Row]
Sums = Float[np.ndarray, "units sums"]
"""Sums over the windows of every unit that is resampled."""
Statistic = Callable[[Float[np.ndarray, "*draws sums"]], Float[np.ndarray, "*draws"]]

FEWEST = 4
"""Number of clips below which windows are resampled."""


def ratio(rows: Rows, protocol: str) -> Sums | None:
    """Return sums of an error under HuMoR and under the pose prior; None if no window has it."""
    return _by_unit(rows, protocol, lambda pose, humor: (humor["error"], pose["error"]))


def slip(rows: Rows, protocol: str) -> Sums | None:
    """Return sums of slip of the motion under HuMoR and of the truth."""
    return _by_unit(rows, protocol, lambda _, humor: (humor["slip"], humor["slip_truth"]))


def contacts(rows: Rows, protocol: str) -> Sums | None:
    """Return counts of contacts from the motion under HuMoR, then under the pose prior."""
    return _by_unit(rows, protocol, lambda pose, humor: (humor["labels"], pose["labels"]))


def network(rows: Rows, protocol: str) -> Sums | None:
    """Return counts of contacts by HuMoR's network, then from the motion fitted with its help."""
    return _by_unit(rows, protocol, lambda _, humor: (humor["network"], humor["labels"]))


def quotient(sums: Float[np.ndarray, "*draws 2"]) -> Float[np.ndarray, "*draws"]:
    """Return the first sum divided by the second."""
    return sums[..., 0] / sums[..., 1]


def balanced(counts: Float[np.ndarray, "*draws 4"]) -> Float[np.ndarray, "*draws"]:
    """Return balanced accuracy from counts of `Row.network`; of one class if only it occurs."""
    right = np.stack((counts[..., 0], counts[..., 2]), -1)
    all_of_it = np.stack((counts[..., 1], counts[..., 3]), -1)
    shares = np.divide(right, all_of_it, out=np.full_like(right, np.nan), where=all_of_it > 0)
    return np.nanmean(shares, -1)


def more_balanced(counts: Float[np.ndarray, "*draws 8"]) -> Float[np.ndarray, "*draws"]:
    """Return balanced accuracy of the first four counts minus that of the others."""
    return balanced(counts[..., :4]) - balanced(counts[..., 4:])


def estimated(sums: Sums, statistic: Statistic) -> MeanWithInterval:
    """Return a statistic of one fold with its interval."""
    drawn = _resampled(sums, statistic, np.random.default_rng(0))
    return _estimate(float(statistic(sums.sum(0))), drawn)


def over_people(folds: Sequence[Sums], statistic: Statistic) -> MeanWithInterval:
    """Return the mean of a statistic over folds, with its interval."""
    random = np.random.default_rng(0)
    each = np.stack([_resampled(sums, statistic, random) for sums in folds])
    who = random.integers(0, len(folds), (len(folds), DRAWS))
    drawn = np.take_along_axis(each, who, 0).mean(0)
    return _estimate(float(np.mean([statistic(sums.sum(0)) for sums in folds])), drawn)


def _by_unit(
    rows: Rows, protocol: str, compared: Callable[[Row, Row], tuple[Any, Any]]
) -> Sums | None:
    """Sum over windows what `compared` takes from the rows of the pose prior and of HuMoR."""
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
_CONTACT_PROTOCOL = "noisy joints"
"""Protocol in which contacts and slip are compared."""


def tables(found: Mapping[str, Any], note: str) -> dict[str, Table]:
    """Build the table of all folds that are measured."""
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
        sums = [counted(rows, _CONTACT_PROTOCOL) for rows in folds]
        yield _compared(sums, more_balanced, factor=100)
    yield _compared([slip(rows, _CONTACT_PROTOCOL) for rows in folds], quotient)


def _compared(sums: Sequence[Sums | None], statistic: Statistic, factor: float = 1.0) -> Cell:
    """Return a statistic with its interval; the mean over folds where there are several."""
    present = [own for own in sums if own is not None]
    if len(present) == 0:
        return None
    if len(sums) == 1:
        return spread(estimated(present[0], statistic), factor)
    return spread(over_people(present, statistic), factor)
