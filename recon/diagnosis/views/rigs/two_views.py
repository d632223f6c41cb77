"""Two views that contradict each other: their clocks are told, which of their poses is wrong not.

Rays of two views through one point miss each other when a clock or a pose is wrong. Only the one
view's clock and turn against the other's can be told, and of a shift or a wrong camera nothing.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from recon.diagnosis.views.explanations import matrix_of, shifted
from recon.diagnosis.views.images import Images
from recon.diagnosis.views.rays import Rays
from recon.diagnosis.views.rigs.registration import Part

_LATEST = 0.7
"""Seconds by which the clock of one view may be off against the other's."""
_COARSE = 1 / 30
"""Seconds between the offsets from which the best one is refined."""
_ROUNDS = 8
_STEPS = (0.5, 1e-4, 1e-4, 1e-4)
"""Frames and radians to either side over which derivatives are differences."""
_UNKNOWN: dict[Part, tuple[int, ...]] = {"clock": (0,), "pose": (1, 2, 3)}


@dataclass(frozen=True)
class Agreement:
    """What would bring two views together."""

    images: Images
    """The two views, the second one corrected."""
    late: float
    """Frames by which the second view is late against the first."""
    degrees: float
    """Angle by which one of the cameras is turned."""
    remains: float
    """Median distance by which rays then miss each other's points, metres."""


def agreement(images: Images, parts: tuple[Part, ...]) -> Agreement:
    """The clock or turn of the second view, or both, with which rays of two views miss least."""
    unknown = [k for part in parts for k in _UNKNOWN[part]]
    best: tuple[float, np.ndarray] = (np.inf, np.zeros(4))
    for late in _starts(images) if "clock" in parts else (0.0,):
        values = np.array([late, 0.0, 0.0, 0.0])
        turns = [k for k in unknown if k > 0]
        for _ in range(2 if turns else 0):
            values = _stepped(images, values, turns)
        away = _typical(_misses(images, values))
        if away < best[0]:
            best = (away, values)
    values = best[1]
    most = max(abs(late) for late in _starts(images))
    for _ in range(_ROUNDS):
        values = _stepped(images, values, unknown)
        values[0] = np.clip(values[0], -most, most)
    corrected = _corrected(images, values)
    angle = float(np.degrees(np.linalg.norm(values[1:])))
    return Agreement(corrected, float(values[0]), angle, common_miss(corrected))


def common_miss(images: Images) -> float:
    """Median distance of all rays from the points that they see in common, metres."""
    rays = Rays.of(images)
    points, exists = rays.meet()
    there = exists & (rays.weight > 0)
    return float(np.median(rays.miss(points)[there])) if there.any() else 0.0


def _starts(images: Images) -> Float[np.ndarray, " offsets"]:
    step = max(_COARSE * images.fps, 1.0)
    count = int(min(_LATEST * images.fps, images.pixels.shape[1] / 2) / step)
    return np.arange(-count, count + 1) * step


def _corrected(images: Images, values: Float[np.ndarray, "4"]) -> Images:
    pose = images.pose.copy()
    pose[1, :, :3] = matrix_of(values[1:]) @ pose[1, :, :3]
    return shifted(replace(images, pose=pose), 1, float(values[0]))


def _misses(images: Images, values: Float[np.ndarray, "4"]) -> Float[np.ndarray, "moments points"]:
    """Signed distances of the two rays of every keypoint; 0 where there are no two."""
    rays = Rays.of(_corrected(images, values))
    across = np.cross(rays.direction[0], rays.direction[1])
    size = np.linalg.norm(across, axis=-1)
    there = (rays.weight > 0).all(0) & (size > 0.03)
    between = rays.origin[1] - rays.origin[0]
    return np.where(there, (between * across).sum(-1) / np.where(there, size, 1.0), 0.0)


def _typical(away: Float[np.ndarray, "moments points"]) -> float:
    """Median size of the distances that exist."""
    there = away != 0
    return float(np.median(np.abs(away[there]))) if there.any() else np.inf


def _stepped(
    images: Images, values: Float[np.ndarray, "4"], unknown: list[int]
) -> Float[np.ndarray, "4"]:
    """The values after a robust Gauss-Newton step of some of them."""
    away = _misses(images, values)
    there = away != 0
    if there.sum() < len(unknown) + 1:
        return values
    columns = []
    for k in unknown:
        step = np.zeros(4)
        step[k] = _STEPS[k]
        ahead, behind = _misses(images, values + step), _misses(images, values - step)
        columns.append((ahead - behind) / (2 * _STEPS[k]))
    jacobian = np.stack(columns, -1)
    there &= (jacobian != 0).any(-1)
    j, r = jacobian[there], away[there]
    weight = 1 / (1 + np.square(r / max(3 * float(np.median(np.abs(r))), 1e-9)))
    normal = (j * weight[:, None]).T @ j
    damped = normal + 1e-6 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(unknown))
    out = values.copy()
    out[unknown] -= np.linalg.solve(damped, j.T @ (weight * r))
    return out
