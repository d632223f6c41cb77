"""HuMoR against the pose prior on strangers: ratios of errors and contacts, with 95 % intervals.

Within a fold whole clips are drawn again; where there are fewer than `FEWEST`, its windows are,
which share no frame. Over all folds the folds are drawn again, too: how the mean would move with
other people is what leave-one-person-out is for.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.strangers.fits import HUMOR, POSE
from recon.benchmark.table import DRAWS, LEVEL, Interval

Rows = Sequence[Mapping[str, Any]]
"""Fields of `benchmarks.strangers.fits.Row`, as the folder of the folds keeps them."""
Sums = Float[np.ndarray, "units sums"]
"""Sums over the windows of every unit that is drawn."""
Statistic = Callable[[Float[np.ndarray, "*draws sums"]], Float[np.ndarray, "*draws"]]

FEWEST = 4
"""Clips below which windows are drawn."""


def ratio(rows: Rows, protocol: str, field: str = "error") -> Sums | None:
    """Sums of an error under HuMoR and under the pose prior; None where no window has it."""
    pairs = [(b[field], a[field]) for _, a, b in _pairs(rows, protocol)]
    return _by_unit(rows, protocol, [None if None in pair else pair for pair in pairs])


def slip(rows: Rows, protocol: str) -> Sums | None:
    """Sums of slip under HuMoR and of the truth."""
    pairs = [(b["slip"], b["slip_truth"]) for _, _, b in _pairs(rows, protocol)]
    return _by_unit(rows, protocol, [None if None in pair else pair for pair in pairs])


def contacts(rows: Rows, protocol: str) -> Sums | None:
    """Counts of contacts by the motion under HuMoR, then by that under the pose prior."""
    return _counts(
        rows, protocol, [(b["labels"], a["labels"]) for _, a, b in _pairs(rows, protocol)]
    )


def network(rows: Rows, protocol: str) -> Sums | None:
    """Counts of contacts by HuMoR's network, then by the motion that was found with its help."""
    return _counts(
        rows, protocol, [(b["network"], b["labels"]) for _, _, b in _pairs(rows, protocol)]
    )


def _counts(rows: Rows, protocol: str, pairs: Sequence[tuple[Any, Any]]) -> Sums | None:
    counts = [None if None in (own, other) else (*own, *other) for own, other in pairs]
    return _by_unit(rows, protocol, counts)


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


def estimated(sums: Sums, statistic: Statistic) -> Interval:
    """A statistic of one fold."""
    drawn = _resampled(sums, statistic, np.random.default_rng(0))
    return _estimate(float(statistic(sums.sum(0))), drawn)


def over_people(folds: Sequence[Sums], statistic: Statistic) -> Interval:
    """The mean of a statistic over folds."""
    random = np.random.default_rng(0)
    each = np.stack([_resampled(sums, statistic, random) for sums in folds])
    who = random.integers(0, len(folds), (len(folds), DRAWS))
    drawn = np.take_along_axis(each, who, 0).mean(0)
    return _estimate(float(np.mean([statistic(sums.sum(0)) for sums in folds])), drawn)


def _pairs(
    rows: Rows, protocol: str
) -> list[tuple[tuple[str, int], Mapping[str, Any], Mapping[str, Any]]]:
    """Each window of a protocol with its row by the pose prior and that by HuMoR."""
    found: dict[tuple[str, int], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        if row["protocol"] == protocol:
            found.setdefault((row["window"], row["frames"]), {})[row["method"]] = row
    return [(window, by[POSE], by[HUMOR]) for window, by in found.items()]


def _by_unit(rows: Rows, protocol: str, values: Sequence[tuple[float, ...] | None]) -> Sums | None:
    windows = [window for window, _, _ in _pairs(rows, protocol)]
    kept = [(name, own) for name, own in zip(windows, values, strict=True) if own is not None]
    if len(kept) == 0:
        return None
    clips = [name.rsplit("@", 1)[0] for (name, _), _ in kept]
    units = clips if len(set(clips)) >= FEWEST else [str(window) for window, _ in kept]
    sums: dict[str, np.ndarray] = {}
    for unit, (_, own) in zip(units, kept, strict=True):
        sums[unit] = sums.get(unit, 0.0) + np.array(own, dtype=float)
    return np.stack(list(sums.values()))


def _resampled(
    sums: Sums, statistic: Statistic, random: np.random.Generator
) -> Float[np.ndarray, " draws"]:
    drawn = random.integers(0, len(sums), (DRAWS, len(sums)))
    return statistic(sums[drawn].sum(1))


def _estimate(mean: float, drawn: Float[np.ndarray, " draws"]) -> Interval:
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.nanpercentile(drawn, (tail, 100 - tail))
    return Interval(mean, float(low), float(high))
