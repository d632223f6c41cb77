"""How well a fitted clip agrees with what was seen, and what that says about the input."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from recon.core.residuals import Noise, Unit
from recon.diagnosis.findings import Finding
from recon.method.protocols import Estimate
from recon.method.sensor import Sensor

_QUANTILES = (0.5, 0.9, 0.99)


@dataclass(frozen=True)
class ResidualSummary:
    """How far one sensor's data are from the fitted body, in the sensor's own unit."""

    name: str
    unit: Unit
    noise: float
    """Standard deviation of a coordinate that the fit assumed."""
    median: float | None
    """Median length of all residuals; None where nothing was seen at the motion's times."""
    quantiles: tuple[float, ...] | None
    """The 50th, 90th and 99th percentile."""
    by_point: dict[str, float | None]
    """Median of every named point; empty for clouds, whose points have no names."""
    by_frame: tuple[float | None, ...]
    """Median of every moment of the observation."""

    def report(self) -> dict[str, Any]:
        """The record as it stands in a report's list `residuals`."""
        return asdict(self)


def summarise(name: str, seen: Sensor, noise: Noise, estimate: Estimate) -> ResidualSummary:
    """Numbers about the residuals of the first clip for its report."""
    with torch.no_grad():
        residuals = seen.residuals(estimate)
    lengths = residuals.distances[0].double().cpu().numpy()
    lengths[~residuals.seen[0].cpu().numpy()] = np.nan
    flat = lengths[np.isfinite(lengths)]
    names = seen.point_names(estimate.body.model)
    return ResidualSummary(
        name=name,
        unit=residuals.unit,
        noise=noise.own,
        median=float(np.median(flat)) if len(flat) > 0 else None,
        quantiles=tuple(np.quantile(flat, _QUANTILES).tolist()) if len(flat) > 0 else None,
        by_point=dict(zip(names, _medians(lengths.T), strict=True)) if names else {},
        by_frame=tuple(_medians(lengths)),
    )


def _medians(rows: Float[np.ndarray, "rows samples"]) -> list[float | None]:
    """Median of the finite values of every row."""
    known = [row[np.isfinite(row)] for row in rows]
    return [float(np.median(row)) if len(row) > 0 else None for row in known]


_SUSPECT = 5.0
"""Multiple of the estimated standard deviation from which on a median residual is suspicious."""
_MIN_SUSPICIOUS_RESIDUAL = {"pixels": 15.0, "metres": 0.06, "radians": 0.4}
"""Median residuals below these are not suspicious, whatever the noise."""


def residual_warnings(summaries: Sequence[ResidualSummary]) -> list[Finding]:
    """Sensors whose residuals are far above their noise: model and data contradict each other."""
    return [said.of(one.name) for one in summaries for said in _doubts_about(one)]


def _doubts_about(summary: ResidualSummary) -> list[Finding]:
    median, noise = summary.median, summary.noise
    if median is None:
        return [Finding("unseen", "nothing was seen at the times of the motion")]
    if median <= max(_SUSPECT * noise, _MIN_SUSPICIOUS_RESIDUAL[summary.unit]):
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
            f"half of the data is more than {median:.3g} {summary.unit} away from the fitted "
            f"body{where}, and the data's own noise is {noise:.2g}; what was recorded is not what "
            "the file says: check which person, which points and which camera it shows",
            points,
            value=median,
        )
    ]
