"""How sure a mean over windows is: 95 % intervals by the bootstrap, over clips within subjects.

Windows of one clip are alike, and so are clips of one subject. So whole clips are drawn with
replacement within each subject, a subject's mean is that of the windows of its drawn clips, and
the subjects themselves stay: an interval says how far the number would move with other clips of
the same people, not with other people. Two methods that saw the same windows are compared by the
differences of their values window by window (paired), which is far more certain than what two
separate intervals say.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

DRAWS = 4000
LEVEL = 0.95

Values = Sequence[float | None]
"""Values of one metric, window by window; None where a window has none."""


@dataclass(frozen=True)
class Interval:
    """A mean and the interval that it lies in."""

    mean: float
    low: float
    high: float

    @property
    def sure(self) -> bool:
        """Whether the interval leaves zero out; of a difference: whether it means anything."""
        return self.low > 0 or self.high < 0


def interval(values: Values, clips: Sequence[str], subjects: Sequence[str]) -> Interval:
    """Mean over subjects of a subject's mean over windows, with its 95 % interval.

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
    groups = _by_clip(values, clips, subjects)
    if not groups:
        raise ValueError("no window has a value")
    random = np.random.default_rng(0)
    drawn = np.mean([_resampled(own, random) for own in groups.values()], axis=0)
    tail = 100 * (1 - LEVEL) / 2
    low, high = np.percentile(drawn, (tail, 100 - tail))
    mean = np.mean([own[:, 0].sum() / own[:, 1].sum() for own in groups.values()])
    return Interval(float(mean), float(low), float(high))


def paired(
    values: Values, others: Values, clips: Sequence[str], subjects: Sequence[str]
) -> Interval:
    """The mean difference `values` - `others` on the same windows, with its 95 % interval.

    Raises:
        ValueError: when the lengths differ, or no window has both values.
    """
    if len(values) != len(others):
        raise ValueError(f"expected the same windows, got {len(values)} and {len(others)} values")
    differences = [
        None if a is None or b is None else a - b for a, b in zip(values, others, strict=True)
    ]
    return interval(differences, clips, subjects)


def _by_clip(
    values: Values, clips: Sequence[str], subjects: Sequence[str]
) -> dict[str, Float[np.ndarray, "clips 2"]]:
    """The sum and number of values of each clip, by subject."""
    found: dict[str, dict[str, list[float]]] = {}
    for value, clip, subject in zip(values, clips, subjects, strict=True):
        if value is not None:
            found.setdefault(subject, {}).setdefault(clip, []).append(value)
    return {
        subject: np.array([(sum(own), len(own)) for own in rows.values()], dtype=float)
        for subject, rows in found.items()
    }


def _resampled(
    clips: Float[np.ndarray, "clips 2"], random: np.random.Generator
) -> Float[np.ndarray, " draws"]:
    """The subject's mean for each draw of as many clips as there are."""
    drawn = clips[random.integers(0, len(clips), (DRAWS, len(clips)))].sum(1)
    return drawn[:, 0] / drawn[:, 1]
