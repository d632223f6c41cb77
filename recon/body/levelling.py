"""Finds frames in which feet stand flat, and the rotation that makes a tilted floor level."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import speeds
from recon.body.model import BodyModel
from recon.body.soles import Stance
from recon.core import rotations as so3
from recon.core.motion import Motion

_MAX_FLAT_SPEED_M_S = 0.1
"""Ankle and toe of a foot that stands flat are slower than this, m/s."""
_FLAT = 0.03
"""Metres by which the height of the ankle above the toe may differ from its height at rest."""
_MIN_POINTS = 30
_LEAST_EXTENT = 0.7
"""Metres that feet must stand apart for a slope to be seen."""
_STEEPEST = 4.0
"""Degrees; more is terrain."""
_MAX_DEVIATION_RATIO = 0.6
"""A slope must leave less than this share of the deviations of a level floor."""
_LEVEL = 0.005
"""Metres of mean deviation up to which a floor is level as it is."""
_SLOPE_PULL = 0.01
"""Metres²: worth as much as feet spread by 0.1 m, root mean square."""
_SMALL_DEVIATION = 0.003
_REWEIGHTINGS = 30


def standing_flat(feet: Float[Tensor, "time 4 3"], fps: float) -> Bool[Tensor, "time 2"]:
    """Mask of the frames in which the left and the right foot stand flat.

    Ankle and toe are slow, and the ankle is as high above the toe as it is mostly in such frames
    (a foot on its toes is not flat).

    Args:
        feet: left ankle, right ankle, left toe, right toe; metres.
        fps: frames per second.
    """
    still = (speeds(feet, fps) < _MAX_FLAT_SPEED_M_S).unflatten(-1, (2, 2)).all(-2)
    rise = feet[:, :2, 2] - feet[:, 2:, 2]
    flat = torch.zeros_like(still)
    for side in (0, 1):
        if still[:, side].any():
            usual = rise[still[:, side], side].median()
            flat[:, side] = still[:, side] & ((rise[:, side] - usual).abs() < _FLAT)
    return flat


def levelling_rotation(stance: Stance) -> Float[Tensor, "3 3"] | None:
    """Rotation that levels a tilted floor, or None where the floor is level or not one plane.

    z = a x + b y + c through the soles of firm stance, by least absolute deviations (reweighted
    least squares) with a mild pull of the slope towards zero: across the direction of a walk it
    is hardly seen. Accepted where feet stood far enough apart, the slope is small, as of a
    capture volume that was calibrated carelessly, and the soles lie on that plane much better
    than on a level one.
    """
    points = stance.lowest[stance.firm].double()
    if len(points) < _MIN_POINTS:
        return None
    middle = points.median(0).values
    ends = (points[:, :2].quantile(0.95, dim=0) - points[:, :2].quantile(0.05, dim=0)).norm()
    if float(ends) < _LEAST_EXTENT:
        return None
    x = torch.cat((points[:, :2] - middle[:2], torch.ones_like(points[:, :1])), 1)
    z = points[:, 2] - middle[2]
    pull = torch.diag(torch.tensor([_SLOPE_PULL, _SLOPE_PULL, 0.0], dtype=torch.float64))
    weight = torch.ones_like(z)
    plane = torch.zeros(3, dtype=torch.float64)
    for _ in range(_REWEIGHTINGS):
        normal = (x * weight[:, None]).mT @ x / len(z) + pull * weight.mean()
        plane = torch.linalg.solve(normal, (x * weight[:, None]).mT @ z / len(z))
        weight = 1 / (z - x @ plane).abs().clamp(min=_SMALL_DEVIATION)
    level = (z - z.median()).abs().mean()
    tilted = (z - x @ plane).abs().mean()
    slope = plane[:2].norm()
    flat = level < _LEVEL or tilted > _MAX_DEVIATION_RATIO * level
    if flat or slope > math.tan(math.radians(_STEEPEST)):
        return None
    angle = torch.atan(slope)
    axis = torch.stack((plane[1], -plane[0], torch.zeros_like(slope))) / slope
    # rotate the normal n = (-a, -b, 1) to z: the axis is n × z = (-b, a, 0)
    return so3.exp(-axis * angle).float()


def rotated_motion(motion: Motion, rotation: Float[Tensor, "3 3"], body: BodyModel) -> Motion:
    """Return a motion in world coordinates that are rotated about the origin."""
    T = torch.eye(4).to(motion.translation)
    T[:3, :3] = rotation
    return motion.carried(T, body.rest_joints(motion.shape)[..., 0, :])
