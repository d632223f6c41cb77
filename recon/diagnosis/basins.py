"""Detects fits to clouds that ended in a wrong local minimum: by labels, outline and surface."""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float

from observations.depth import PointCloud
from recon.core.camera import Camera
from recon.core.raster import faces_eye
from recon.diagnosis.findings import Finding
from recon.method.protocols import Estimate
from recon.method.timing import at_observation_times

_MOMENTS = 12
"""Frames of the cloud that are looked at."""
_SURE = 0.5
"""Confidence of the labels that are asked."""
_MANY = 0.75
"""Share of the frames in which labels ought to agree with the body."""
_MIN_LABELLED = 10
"""Labelled points that a frame must have to be used."""


def label_distance(cloud: PointCloud, estimate: Estimate) -> float | None:
    """Distance of a confidently labelled point from the labelled place on the fitted body, metres.

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
    usable = [m for m in range(seen.start, seen.stop) if int(sure[0, m].sum()) >= _MIN_LABELLED]
    found: list[float] = []
    for moment in usable[:: max(math.ceil(len(usable) / _MOMENTS), 1)]:
        own = sure[0, moment]
        places = cloud.labels.places[0, moment][own].to(rest)
        here, points = middles[0, moment - seen.start], cloud.points[0, moment][own]
        surfel = torch.cdist(places, rest).argmin(-1)
        found.append(float((here[surfel] - points).norm(dim=-1).median()))
    return float(np.quantile(found, _MANY)) if found else None


_BESIDE = 0.06
"""Metres at the body within which a point of the cloud stands for a place of the surface; clouds
of half a thousand points are about as dense."""
_STICKING_OUT = 0.25
"""Share of the surface facing the sensor that may lie outside the cloud's outline. Fits of
validation people that are right have 1 %, those whose lower half is hidden 47 %."""
_FAR_POINTS = 0.06
"""Metres that the farthest tenth of the points may be away from the body; right fits have 2 cm."""
_NOISY = 2.0
"""Multiple of the sensor's standard deviation that the farthest tenth may be away in addition; a
tenth of normal deviations is larger than 1.6."""
_ELSEWHERE = 0.075
"""Metres, in addition to the sensor's noise, that points may lie away from the places that their
labels name in a quarter of the moments. On validation windows right fits have 3 to 5 cm, and up to
7 cm before a sensor with 5 cm of noise; a fit that is 12 cm wrong has 11 cm."""
_NO_BODY = 0.8
"""Mean probability of lying on a body below which points are taken to show something else. People
have 0.99, tables and chairs 0.3 to 0.7; a box of the size of a person passes for one."""


def basin_findings(
    name: str,
    cloud: PointCloud,
    quantiles: tuple[float, ...] | None,
    estimate: Estimate,
) -> list[Finding]:
    """A warning where a fit to depth seems to be in a wrong local minimum of posture or heading.

    Args:
        name: of the sensor, for the message.
        cloud: of one clip.
        quantiles: of its residuals, the 50th, 90th and 99th percentile; None where there are none.
        estimate: the fit.
    """
    if quantiles is None:
        return []
    cloud = cloud.labelled()  # labels the points unless the first guess did
    outside, far = share_outside(cloud, estimate) or 0.0, quantiles[1]
    labelled = label_distance(cloud, estimate) or 0.0
    on_body = 1.0
    if cloud.labels is not None and bool(cloud.present.any()):
        on_body = float(cloud.labels.on_body[cloud.present].mean())
    noise = 0.0 if cloud.std is None else float(cloud.std[0].median())
    reasons = {
        f"a tenth of the points is more than {100 * far:.0f} cm away from it": (
            far > math.hypot(_FAR_POINTS, _NOISY * noise)
        ),
        f"{100 * outside:.0f} % of its surface lies where the sensor saw no body": (
            outside > _STICKING_OUT
        ),
        f"half of the points lie more than {100 * labelled:.0f} cm from the part of it that they "
        "look like, in a quarter of the moments": labelled > math.hypot(_ELSEWHERE, noise),
        "the points look like furniture or something else that is no body": (on_body < _NO_BODY),
    }
    said = [reason for reason, holds in reasons.items() if holds]
    if not said:
        return []
    return [
        Finding(
            "wrong basin",
            f"{name}: the fitted body does not agree with what the sensor saw: "
            f"{', and '.join(said)}. The posture or the heading may be a wrong one, much is "
            f"hidden, or the {'scale or up axis' if cloud.camera is None else 'depth scale'} is "
            "wrong; look at the result (recon view --obs), or add 2D keypoints",
            value=max(far, outside, labelled),
        )
    ]


def share_outside(cloud: PointCloud, estimate: Estimate) -> float | None:
    """Share of the visible surface that no point of the cloud covers.

    Median over some moments; None without a sensor or where nothing was seen. Parts of the body
    behind an occluder count as outside, too; those beyond the image's borders do not.
    """
    if cloud.camera is None:
        return None
    with torch.no_grad():
        middles, normals = cloud.surfels.posed(estimate.body)
        clock = {"fps": cloud.fps, "start_time": cloud.start_time,
                 "moments": cloud.points.shape[-3]}  # fmt: skip
        middles, seen = at_observation_times(
            estimate.scene.to_recording(middles), estimate.motion, **clock
        )
        normals, _ = at_observation_times(
            estimate.scene.to_recording_directions(normals), estimate.motion, **clock
        )
    full = [m for m in range(seen.start, seen.stop) if bool(cloud.present[0, m].any())]
    shares: list[float] = []
    for moment in full[:: max(math.ceil(len(full) / _MOMENTS), 1)]:
        camera, row = cloud.camera.at(range(moment, moment + 1)), moment - seen.start
        eye = camera.T_world_camera[0, 0, :3, 3]
        shown = faces_eye(middles[0, row], normals[0, row], eye) & _in_image(
            camera, middles[0, row]
        )
        if not bool(shown.any()):
            continue
        points = cloud.points[0, moment][cloud.present[0, moment]]
        shares.append(_share_far_from_rays(middles[0, row][shown] - eye, points - eye))
    return float(np.median(shares)) if shares else None


def _in_image(
    camera: Camera, places: Float[torch.Tensor, "surfels 3"]
) -> Bool[torch.Tensor, " surfels"]:
    """Whether points lie in front of the sensor and within its image."""
    seen = camera.project(places[None, None])
    return (seen.in_front & camera.in_image(seen.pixels))[0, 0]


def _share_far_from_rays(
    surface: Float[torch.Tensor, "surfels 3"], points: Float[torch.Tensor, "points 3"]
) -> float:
    """Share of the surface for which no point is near the line of sight from the origin."""
    from scipy.spatial import KDTree

    tree = KDTree(torch.nn.functional.normalize(points, dim=-1).numpy())
    distance = surface.norm(dim=-1, keepdim=True)
    angle, _ = tree.query((surface / distance).numpy())
    return float((angle * distance[:, 0].numpy() > _BESIDE).mean())
