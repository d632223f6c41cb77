"""What a laboratory report says, before it is drawn."""

from collections.abc import Mapping
from dataclasses import dataclass

from recon.metrics.gait.analysis import Gait


@dataclass(frozen=True)
class PointResiduals:
    """Residuals of one source of data by the point that they belong to."""

    name: str
    """The observation, as its report names it."""
    unit: str
    values: Mapping[str, float]
    """Median or mean distance of every point, by its name."""
    measure: str
    """What the values are, for the axis of the plot."""


@dataclass(frozen=True)
class LaboratoryContents:
    """One trial: its gait and everything that is known about how good the motion is."""

    title: str
    facts: Mapping[str, str]
    """Facts about the trial in the order in which they are shown: rate, length, stature ..."""
    gait: Gait
    residuals: tuple[PointResiduals, ...]
    """Empty where no report of a fit or a conversion is known."""
    warnings: tuple[str, ...]
    """What should be read before any figure is used."""
    repairs: tuple[str, ...]
    """What was wrong with the data and was put right."""
    notes: tuple[str, ...]
    """What is worth knowing but is no fault."""
    decisions: tuple[str, ...]
    """What was read, guessed or cut in reading the recording."""
