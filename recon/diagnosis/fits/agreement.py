"""How well a fitted clip agrees with what was seen, and what that says about the input."""

from collections.abc import Sequence

from observations.together import kinds
from recon.diagnosis.findings import Finding
from recon.diagnosis.fits.plausibility import distance_warnings
from recon.diagnosis.fits.silhouette import basin_findings
from recon.diagnosis.fits.summaries import ResidualSummary
from recon.method.protocols import Estimate, Sensor

_SUSPECT = 5.0
"""Multiple of the estimated standard deviation from which on a median residual is suspicious."""
_LEAST = {"pixels": 15.0, "metres": 0.06, "radians": 0.4}
"""Median residuals below these are not suspicious, whatever the noise."""


def agreement_warnings(
    summaries: Sequence[ResidualSummary], observations: Sequence[Sensor], estimate: Estimate
) -> list[Finding]:
    """Sensors whose residuals are far above their noise: model and data contradict each other."""
    warnings: list[Finding] = []
    for summary, seen in zip(summaries, observations, strict=True):
        warnings += _of(summary)
        for view in kinds.views([seen]):
            warnings += distance_warnings(summary.name, view, estimate)
        for cloud in kinds.clouds([seen]):
            warnings += basin_findings(summary.name, cloud, summary, estimate)
    return warnings


def _of(summary: ResidualSummary) -> list[Finding]:
    name, median, noise = summary.name, summary.median, summary.noise
    if median is None:
        return [Finding("unseen", f"{name}: nothing was seen at the times of the motion")]
    if median <= max(_SUSPECT * noise, _LEAST[summary.unit]):
        return []
    worst = sorted(
        ((value, point) for point, value in summary.by_point.items() if value is not None),
        reverse=True,
    )[:3]
    points = tuple(point for _, point in worst)
    where = f", most at {', '.join(points)}" if points else ""
    return [
        Finding(
            "residual",
            f"{name}: half of the data is more than {median:.3g} {summary.unit} away from the "
            f"fitted body{where}, and the data's own noise is {noise:.2g}; what was recorded is "
            "not what the file says: check which person, which points and which camera it shows",
            points,
            value=median,
        )
    ]
