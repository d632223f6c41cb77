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
_MANY = 0.75
"""Share of the moments in which labels ought to agree with the body."""
_LEAST = 10
"""Points of a moment that tell something."""


def label_distance(cloud: PointCloud, estimate: Estimate) -> float | None:
    """Distance of a sure point from the place that its label names on the fitted body, metres.

    Median over the points of a moment, and upper quartile over some moments: labels of some parts
    and of some moments are wrong, but not those of most, and a fit may be wrong for a part of the
    clip only. None without labels or sure points.
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
        places = cloud.labels.places[0, moment][own].to(rest)
        here, points = middles[0, moment - seen.start], cloud.points[0, moment][own]
        surfel = torch.cdist(places, rest).argmin(-1)
        found.append(float((here[surfel] - points).norm(dim=-1).median()))
    return float(np.quantile(found, _MANY)) if found else None


def share_on_body(cloud: PointCloud) -> float | None:
    """Mean probability that a point lies on a body at all; None without labels."""
    if cloud.labels is None or not bool(cloud.present.any()):
        return None
    return float(cloud.labels.on_body[cloud.present].mean())
