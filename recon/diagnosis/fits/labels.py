"""Labels of a cloud: whether the parts of a fitted body lie where their labelled points are."""

import math

import numpy as np
import torch

from observations.depth import PointCloud
from observations.timing import at_observation_times
from recon.method.protocols import Estimate

_MOMENTS = 12
"""Moments that are looked at."""
_SURE = 0.5
"""Confidence of the labels that are asked."""
_LEAST = 10
"""Points of a moment that tell something."""


def label_distance(cloud: PointCloud, estimate: Estimate) -> float | None:
    """Distance of a sure point from the place that its label names on the fitted body, metres.

    Median over the points of a moment, and over some moments: labels of some parts and of some
    moments are wrong, but not those of most. None without labels or sure points.
    """
    if cloud.labels is None:
        return None
    with torch.no_grad():
        middles, _ = cloud.surfels.posed(estimate.body)
        middles, seen = at_observation_times(
            estimate.scene.to_recording(middles), estimate.motion,
            fps=cloud.fps, start_time=cloud.start_time, moments=cloud.moments,
        )  # fmt: skip
    index = torch.from_numpy(cloud.surfels.vertices)
    rest = estimate.body.model.template[index]
    sure = (cloud.labels.confidence > _SURE) & cloud.present
    told = [m for m in range(seen.start, seen.stop) if int(sure[0, m].sum()) >= _LEAST]
    found: list[float] = []
    for moment in told[:: max(math.ceil(len(told) / _MOMENTS), 1)]:
        own = sure[0, moment]
        surfel = torch.cdist(cloud.labels.places[0, moment][own].to(rest), rest).argmin(-1)
        away = middles[0, moment - seen.start][surfel] - cloud.points[0, moment][own]
        found.append(float(away.norm(dim=-1).median()))
    return float(np.median(found)) if found else None
