"""Residuals of a fit in numbers for its report: by point, by frame, and their quantiles."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from recon.core.residuals import Noise, Unit
from recon.method.protocols import Estimate, Sensor

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
