"""Detects body fits to point clouds that converged to a wrong posture or heading."""

import math

import numpy as np
import torch
from jaxtyping import Bool, Float

from observations.depth import PointCloud
from recon.core.camera import Camera
from recon.core.raster import are_facing_eye
from recon.diagnosis.findings import Finding
from recon.method.protocols import Estimate
from recon.method.timing import at_observation_times

_MAX_FRAMES = 12
"""Largest number of frames of a cloud that are compared with the fit."""
_MIN_LABEL_CONFIDENCE = 0.5
"""Confidence above which a point's body-part label is used."""
_FRAME_QUANTILE = 0.75
"""Quantile over frames of the median label distance: a fit may be wrong in a quarter of a clip
only."""
_MIN_LABELLED = 10
"""Number of confidently labelled points that a frame must have to be used."""


def distance_from_labelled_places(cloud: PointCloud, estimate: Estimate) -> float | None:
    """Return how far (m) labelled points are from their labelled place on the fitted body.

    This is the median over the points of a frame, and the upper quartile over up to twelve frames:
    some labels are wrong, and a fit may be wrong in part of the clip only. None without labels, or
    without enough confident ones.
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
    sure = (cloud.labels.confidence > _MIN_LABEL_CONFIDENCE) & cloud.present
    usable = [m for m in range(seen.start, seen.stop) if int(sure[0, m].sum()) >= _MIN_LABELLED]
    found: list[float] = []
    for moment in usable[:: max(math.ceil(len(usable) / _MAX_FRAMES), 1)]:
        own = sure[0, moment]
        places = cloud.labels.places[0, moment][own].to(rest)
        here, points = middles[0, moment - seen.start], cloud.points[0, moment][own]
        surfel = torch.cdist(places, rest).argmin(-1)
        found.append(float((here[surfel] - points).norm(dim=-1).median()))
    return float(np.quantile(found, _FRAME_QUANTILE)) if found else None


_MAX_RAY_DISTANCE_M = 0.06
"""Distance (m) from a point of the surface to the nearest ray of a measured point up to which it
counts as covered; clouds of 500 points are about as dense."""
_MAX_SHARE_OUTSIDE = 0.25
"""Share of the surface facing the sensor that may lie outside the cloud's outline. Right fits to
validation people have 1 %, those to people whose lower half is hidden 47 %."""
_MAX_FAR_M = 0.06
"""Distance (m) from the body that the 90th percentile of the points may have without sensor noise;
right fits have 2 cm."""
_MAX_FAR_STDS = 2.0
"""Standard deviations of the sensor's noise by which the 90th percentile may be farther; of the
absolute values of normal deviations it is 1.64."""
_MAX_LABEL_M = 0.075
"""Limit (m) on `distance_from_labelled_places`, in addition to the sensor's noise. On validation
windows right fits have 3 to 5 cm, and up to 7 cm with 5 cm of sensor noise; a fit that is 12 cm
wrong has 11 cm."""
_ON_BODY = 0.8
"""Mean probability that points lie on a body, below which they are taken to show something else.
People have 0.99, tables and chairs 0.3 to 0.7; a box of the size of a person passes for one."""


def basin_findings(
    name: str,
    cloud: PointCloud,
    quantiles: tuple[float, ...] | None,
    estimate: Estimate,
) -> list[Finding]:
    """Return a warning where a body fitted to a cloud seems to have a wrong posture or heading.

    Args:
        name: name of the sensor, for the message.
        cloud: point cloud of one clip.
        quantiles: 50th, 90th and 99th percentile of the residuals (m); None without residuals.
        estimate: fitted motion and scene.
    """
    if quantiles is None:
        return []
    cloud = cloud.labelled()  # a cloud that has labels already stays as it is
    outside, ninth_decile = uncovered_surface_share(cloud, estimate) or 0.0, quantiles[1]
    labelled = distance_from_labelled_places(cloud, estimate) or 0.0
    on_body = 1.0
    if cloud.labels is not None and bool(cloud.present.any()):
        on_body = float(cloud.labels.on_body[cloud.present].mean())
    noise = 0.0 if cloud.std is None else float(cloud.std[0].median())
    reasons = {
        f"a tenth of the points is more than {100 * ninth_decile:.0f} cm away from it": (
            ninth_decile > math.hypot(_MAX_FAR_M, _MAX_FAR_STDS * noise)
        ),
        f"{100 * outside:.0f} % of its surface lies where the sensor saw no body": (
            outside > _MAX_SHARE_OUTSIDE
        ),
        f"half of the points lie more than {100 * labelled:.0f} cm from the part of it that they "
        "look like, in a quarter of the moments": labelled > math.hypot(_MAX_LABEL_M, noise),
        "the points look like furniture or something else that is no body": (on_body < _ON_BODY),
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
            value=max(ninth_decile, outside, labelled),
        )
    ]


def uncovered_surface_share(cloud: PointCloud, estimate: Estimate) -> float | None:
    """Return the share of the fitted surface facing the sensor that no cloud point covers.

    This is the median over up to twelve frames; None without a sensor's pose or where nothing was
    seen. Parts of the body behind an occluder count as outside; those beyond the image's borders
    do not.
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
    for moment in full[:: max(math.ceil(len(full) / _MAX_FRAMES), 1)]:
        camera, row = cloud.camera.at(range(moment, moment + 1)), moment - seen.start
        eye = camera.T_world_camera[0, 0, :3, 3]
        shown = are_facing_eye(middles[0, row], normals[0, row], eye) & _in_image(
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
    """Return a mask of the points that lie in front of the sensor and within its image."""
    seen = camera.project(places[None, None])
    return (seen.in_front & camera.in_image(seen.pixels))[0, 0]


def _share_far_from_rays(
    surface: Float[torch.Tensor, "surfels 3"], points: Float[torch.Tensor, "points 3"]
) -> float:
    """Return the share of surface points that are far from the rays of all cloud points."""
    from scipy.spatial import KDTree

    tree = KDTree(torch.nn.functional.normalize(points, dim=-1).numpy())
    distance = surface.norm(dim=-1, keepdim=True)
    angle, _ = tree.query((surface / distance).numpy())
    return float((angle * distance[:, 0].numpy() > _MAX_RAY_DISTANCE_M).mean())
