"""The table of a benchmark: means over subjects with confidence intervals, by method."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.benchmark.protocols import BenchProtocol
from recon.formats.reports import versions
from recon.formats.writing import write_report

DRAWS = 4000
LEVEL = 0.95

Values = Sequence[float | None]
"""Values of one metric, window by window; None where a window has none."""


@dataclass(frozen=True)
class MeanWithInterval:
    """A mean over subjects with the two ends of its 95 % confidence interval."""

    mean: float
    low: float
    high: float

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval excludes zero, so that a difference is significant."""
        return self.low > 0 or self.high < 0


def mean_with_interval(
    values: Values, clips: Sequence[str], subjects: Sequence[str]
) -> MeanWithInterval:
    """Mean over subjects of each subject's mean over windows, with a 95 % interval.

    Args:
        values: of one metric, window by window.
        clips: the clip of every window.
        subjects: the subject of every window.

    Raises:
        ValueError: when the lengths differ, or no window has a value.
    """
    if not len(values) == len(clips) == len(subjects):
        raise ValueError(
            f"expected one clip and one subject per value, got {len(values)} values, "
            f"{len(clips)} clips, {len(subjects)} subjects"
        )
    groups = _sums_and_counts_by_subject(values, clips, subjects)
    if not groups:
        raise ValueError("expected a value in at least one window, got none")
    random = np.random.default_rng(0)
    drawn = np.mean([_bootstrap_means(own, random) for own in groups.values()], axis=0)
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(drawn, (tail, 100 - tail))
    mean = np.mean([own[:, 0].sum() / own[:, 1].sum() for own in groups.values()])
    return MeanWithInterval(float(mean), float(low), float(high))


def paired_difference(
    values: Values, other: Values, clips: Sequence[str], subjects: Sequence[str]
) -> MeanWithInterval:
    """Mean difference of two methods on the same windows, with a 95 % interval.

    Raises:
        ValueError: when the lengths differ, or no window has both values.
    """
    if len(values) != len(other):
        raise ValueError(f"expected the same windows, got {len(values)} and {len(other)} values")
    differences = [
        None if a is None or b is None else a - b for a, b in zip(values, other, strict=True)
    ]
    return mean_with_interval(differences, clips, subjects)


def _sums_and_counts_by_subject(
    values: Values, clips: Sequence[str], subjects: Sequence[str]
) -> dict[str, Float[np.ndarray, "clips 2"]]:
    """Return, by subject, an array with the sum and the count of the values of each clip."""
    found: dict[str, dict[str, list[float]]] = {}
    for value, clip, subject in zip(values, clips, subjects, strict=True):
        if value is not None:
            found.setdefault(subject, {}).setdefault(clip, []).append(value)
    return {
        subject: np.array([(sum(own), len(own)) for own in rows.values()], dtype=float)
        for subject, rows in found.items()
    }


def _bootstrap_means(
    clips: Float[np.ndarray, "clips 2"], random: np.random.Generator
) -> Float[np.ndarray, " draws"]:
    """Draw one subject's clips with replacement; return the mean value of every draw."""
    drawn = clips[random.integers(0, len(clips), (DRAWS, len(clips)))].sum(1)
    return drawn[:, 0] / drawn[:, 1]


@dataclass(frozen=True)
class BenchTable:
    """The metrics of every method on the windows of a protocol, in SI units."""

    protocol: BenchProtocol
    source: str
    """Which windows these are, for people."""
    names: tuple[str, ...]
    """Clip and first second of every window."""
    subjects: tuple[str, ...]
    """The subject of every window."""
    counted: tuple[str, ...]
    """Subjects over whom means are taken."""
    values: Mapping[str, Mapping[str, Sequence[float | None]]]
    """Values of every window, by method and metric."""
    feet: Mapping[str, float | None]
    """Balanced accuracy of the contacts of ankles and toes, by method, over all windows of a
    subject together and then over subjects; None where a method gives joints alone."""
    data: str
    """SHA-256 of the motion files that were read, with their names."""

    def mean(self, method: str, metric: str) -> MeanWithInterval | None:
        """Mean of a metric over the counted subjects, with its 95 % interval.

        Whole clips are drawn again within each subject (`recon.benchmark.table`). None where no
        window has a value.
        """
        chosen = [i for i, subject in enumerate(self.subjects) if subject in self.counted]
        values = [self.values[method][metric][i] for i in chosen]
        if all(value is None for value in values):
            return None
        clips = [self.names[i].rsplit("@", 1)[0] for i in chosen]
        return mean_with_interval(values, clips, [self.subjects[i] for i in chosen])

    def by_subject(self, method: str, metric: str) -> dict[str, float | None]:
        """Mean of a metric over each subject's windows; None if no window has a value."""
        rows = tuple(zip(self.subjects, self.values[method][metric], strict=True))
        found: dict[str, float | None] = {}
        for subject in sorted(set(self.subjects)):
            own = [value for name, value in rows if name == subject and value is not None]
            found[subject] = sum(own) / len(own) if own else None
        return found

    def rows(self) -> dict[str, dict[str, str]]:
        """Return the cells of the printed table as texts, by method and column heading.

        The first two columns have intervals; those of all metrics are in `as_json`.
        """
        found: dict[str, dict[str, str]] = {}
        columns = tuple(self.protocol.columns.items())
        for method in self.values:
            found[method] = {
                heading: _interval_as_text(
                    self.mean(method, metric), factor, self._has_intervals and column < 2
                )
                for column, (metric, (heading, factor)) in enumerate(columns)
            }
            right = self.feet[method]
            found[method]["feet right, bal. %"] = "–" if right is None else f"{100 * right:.1f}"
            metric, (_, factor) = columns[0]
            if len(set(self.subjects)) > 1:
                for subject, value in self.by_subject(method, metric).items():
                    apart = "" if subject in self.counted else ", apart"
                    told = "–" if value is None else f"{factor * value:.2f}"
                    found[method][f"{subject}{apart}"] = told
        return found

    @property
    def _has_intervals(self) -> bool:
        """Whether every subject has several clips, which an interval needs."""
        clips = set(zip(self.subjects, (n.rsplit("@", 1)[0] for n in self.names), strict=True))
        counts = [sum(own == subject for own, _ in clips) for subject in self.counted]
        return min(counts) > 1

    def as_json(self) -> dict[str, Any]:
        """All numbers: settings, means with intervals, and the values of every window."""
        return {
            "protocol": self.protocol.name,
            "about": self.protocol.about,
            "source": self.source,
            "data": self.data,
            "versions": versions(),
            "windows": {"names": self.names, "subjects": self.subjects, "counted": self.counted},
            "methods": {method: self._method_as_json(method) for method in self.values},
        }

    def _method_as_json(self, method: str) -> dict[str, Any]:
        rows = self.values[method]
        return {
            "mean": {
                metric: _interval_as_numbers(self.mean(method, metric), self._has_intervals)
                for metric in rows
            },
            "feet_balanced": self.feet[method],
            "subjects": {metric: self.by_subject(method, metric) for metric in rows},
            "windows": rows,
        }

    def save(self, path: Path | str, *, overwrite: bool = False) -> None:
        """Write all numbers of the table as JSON.

        Raises:
            FileExistsError: when it is there and recon did not write it, unless `overwrite`.
        """
        write_report(Path(path), self.as_json(), overwrite=overwrite)

    def __str__(self) -> str:
        """The first column of the table, a line per method."""
        metric, (heading, _) = next(iter(self.protocol.columns.items()))
        lines = [f"  {name}: {row[heading]}" for name, row in self.rows().items()]
        return "\n".join([f"{self.protocol.name}, {self.source}: {heading} ({metric})", *lines])


def _interval_as_text(found: MeanWithInterval | None, factor: float, with_interval: bool) -> str:
    if found is None:
        return "–"
    mean = f"{factor * found.mean:.2f}"
    if not with_interval or found.low == found.high:
        return mean
    return f"{mean} [{factor * found.low:.2f}, {factor * found.high:.2f}]"


def _interval_as_numbers(
    found: MeanWithInterval | None, with_interval: bool
) -> dict[str, float | None] | None:
    if found is None:
        return None
    low, high = (found.low, found.high) if with_interval else (None, None)
    return {"mean": found.mean, "low": low, "high": high}
