"""Errors and measures in SI units: position, smoothness, contact, slip and penetration.

A plural name gives one number per sample, so that samples of several clips can be pooled as
HuMoR pools them (`mean(torch.cat(...))`); a singular name gives the average, or None where there
is nothing to average. Definitions: HuMoR (ICCV 2021) section 5 and its released evaluation.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import CONTACT_JOINTS, FEET
from recon.formats.observations import PointsFile

PENETRATION_THRESHOLDS = (0.0, 0.03, 0.06, 0.09, 0.12, 0.15)
"""Depths below the ground over which the penetration frequency is averaged, metres (HuMoR)."""


def mean(
    samples: Float[Tensor, "*shape"], where: Bool[Tensor, "*shape"] | None = None
) -> float | None:
    """Return the average of samples, or of those that a mask selects; None if there are none."""
    chosen = samples.flatten() if where is None else samples[where]
    return chosen.mean().item() if chosen.numel() > 0 else None


def point_errors(
    predicted: Float[Tensor, "*shape 3"], truth: Float[Tensor, "*shape 3"]
) -> Float[Tensor, "*shape"]:
    """Distance of every point to its true place, metres."""
    return (predicted - truth).norm(dim=-1)


def root_aligned(joints: Float[Tensor, "*frames joints 3"]) -> Float[Tensor, "*frames joints 3"]:
    """Joint positions relative to the pelvis, metres."""
    return joints - joints[..., :1, :]


def similarity_aligned(
    points: Float[Tensor, "*frames points 3"],
    target: Float[Tensor, "*frames points 3"],
    fitted: int | None = None,
) -> Float[Tensor, "*frames points 3"]:
    """Each frame's points after the similarity transform that brings them nearest to a target.

    Least squares (Umeyama 1991): R maximises tr(Rᵀ H) with H = Σ y xᵀ of the centred points and
    s = tr(Rᵀ H) / Σ |x|². The scale of points that coincide is one.

    Args:
        points: to be moved.
        target: where they should be.
        fitted: number of leading points that the transform is fitted to; None takes all.
    """
    some, wanted = points[..., :fitted, :], target[..., :fitted, :]
    centre, goal = some.mean(-2, keepdim=True), wanted.mean(-2, keepdim=True)
    x, y = some - centre, wanted - goal
    covariance = y.mT @ x
    rotation = so3.nearest_rotation(covariance)
    spread = x.square().sum((-2, -1))
    length = (rotation * covariance).sum((-2, -1))
    scale = torch.where(spread > 0, length / torch.where(spread > 0, spread, 1.0), 1.0)
    return scale[..., None, None] * ((points - centre) @ rotation.mT) + goal


def accelerations(
    points: Float[Tensor, "*batch time points 3"], fps: float
) -> Float[Tensor, "*batch inner points 3"]:
    """Second differences (p[t-1] - 2 p[t] + p[t+1]) fps², m/s²; none at the two ends."""
    return points.diff(n=2, dim=-3) * fps**2


def contact_accuracy(
    predicted: Bool[Tensor, "*frames 22"], truth: Bool[Tensor, "*frames 22"]
) -> float | None:
    """Return the share of contact labels that equal the truth, over HuMoR's nine joints."""
    joints = list(CONTACT_JOINTS)
    return mean((predicted == truth)[..., joints].double())


def contact_balanced_accuracy(
    predicted: Bool[Tensor, "*frames 22"],
    truth: Bool[Tensor, "*frames 22"],
    joints: tuple[int, ...] = CONTACT_JOINTS,
) -> float | None:
    """Return the mean of the recalls of contacts and of non-contacts; guessing gives 0.5.

    The joints are HuMoR's nine, or others such as `FEET`. The result is None if the truth has
    only contacts or only non-contacts.
    """
    chosen = list(joints)
    correct, touching = (predicted == truth)[..., chosen].double(), truth[..., chosen]
    found, spared = mean(correct, touching), mean(correct, ~touching)
    return None if found is None or spared is None else (found + spared) / 2


def slip_speed(
    joints: Float[Tensor, "*batch time 22 3"],
    contacts: Bool[Tensor, "*batch time 22"],
    fps: float,
) -> float | None:
    """Mean horizontal speed of ankles and toes from frame to frame while in contact, m/s.

    A step between two frames counts if the joint is in contact in both. Give the true contacts:
    labels made from the speeds of the reconstruction itself would leave out its slipping frames.
    """
    feet = list(FEET)
    steps = joints[..., feet, :2].diff(dim=-3).norm(dim=-1) * fps
    held = contacts[..., feet]
    return mean(steps, held[..., 1:, :] & held[..., :-1, :])


def penetration_fractions(heights: Float[Tensor, "*samples"]) -> tuple[float, ...] | None:
    """Return the shares of samples deeper below the ground than 0, 3, ..., 15 cm."""
    shares = [mean((heights < -depth).double()) for depth in PENETRATION_THRESHOLDS]
    return None if None in shares else tuple(share for share in shares if share is not None)


def penetration_frequency(heights: Float[Tensor, "*samples"]) -> float | None:
    """Share of samples below the ground, averaged over 0, 3, ..., 15 cm of depth (HuMoR)."""
    shares = penetration_fractions(heights)
    return None if shares is None else sum(shares) / len(shares)


def penetration_distance(heights: Float[Tensor, "*samples"]) -> float | None:
    """Mean depth below the ground, samples above it counting as zero, metres.

    Equals HuMoR's mean depth of the penetrating samples times their share.
    """
    return mean((-heights).clamp(min=0))


def chamfer(
    vertices: Float[np.ndarray, "vertices 3"], points: Float[np.ndarray, "points 3"]
) -> float:
    """Chamfer distance of one frame: ½ (mean_v min_p |v - p| + mean_p min_v |v - p|), metres.

    Distances are not squared. Points are compared, not surfaces, so two different samples of one
    surface have a distance above zero.

    Raises:
        ValueError: when one of them is empty.
    """
    from scipy.spatial import KDTree

    if len(vertices) == 0 or len(points) == 0:
        raise ValueError(
            "expected at least one vertex and one point, got "
            f"{len(vertices)} vertices and {len(points)} points"
        )
    to_points = KDTree(points).query(vertices)[0].mean()
    to_vertices = KDTree(vertices).query(points)[0].mean()
    return float(to_points + to_vertices) / 2


def chamfer_of_clip(motion: Motion, body: BodyModel, scans: PointsFile) -> float:
    """Mean Chamfer distance of the body from the points, over all frames that have points, metres.

    Args:
        motion: one clip (no batch axis), at any rate.
        body: whose vertices are compared.
        scans: points of every scan, in the world.

    Raises:
        ValueError: when a scan was taken outside the motion's time, there is none, or the points
            are in the frame of a camera without pose.
    """
    if scans.camera is not None and scans.camera.T_camera_world is None:
        raise ValueError(
            "expected points in the world, got points of a camera without a pose; give its pose"
        )
    frames, rows = np.unique(scans.frame, return_inverse=True)
    if len(frames) == 0:
        raise ValueError("expected scans with points, got none")
    times = motion.times.new_tensor(scans.start_time + frames / scans.fps)
    vertices = body.pose(motion.at(times, scans.fps)).vertices.detach().cpu().double().numpy()
    clouds = np.split(
        scans.points[np.argsort(rows, kind="stable")], np.cumsum(np.bincount(rows))[:-1]
    )
    return float(np.mean([chamfer(v, p) for v, p in zip(vertices, clouds, strict=True)]))
