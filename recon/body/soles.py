"""Soles on the ground: their vertices, when a foot stands, and how high the ground is."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.contacts import MAXIMUM_SPEED, speeds
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import FEET, joint_index

_SOLE_DEPTH = 0.015
"""Vertices within this height of a foot's lowest belong to its sole, metres."""
_SOLE_POINTS = 16
"""Vertices per foot that stand for the sole."""
_PATCH = 4
"""Vertices per foot that stand for its heel and for its ball."""
_MAX_FLAT_SPEED_M_S = 0.1
"""Ankle and toe of a foot that stands flat are slower than this, m/s."""
_FLAT = 0.03
"""Metres by which the height of the ankle above the toe may differ from its height at rest."""
_GROUND_PERCENTILE = 0.05
_CHUNK = 2000

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


@dataclass(frozen=True)
class Soles:
    """Vertices under the feet, left and right."""

    points: Int[Tensor, "2 points"]
    heels: Int[Tensor, "2 patch"]
    balls: Int[Tensor, "2 patch"]

    @classmethod
    def of(cls, body: BodyModel) -> "Soles":
        """Points spread over the sole, and those nearest the heel and the ball of the foot."""
        spread, heels, balls = [], [], []
        bone = body.weights.argmax(-1)
        for side in ("left", "right"):
            ankle, toe = joint_index(f"{side}_ankle"), joint_index(f"{side}_foot")
            foot = ((bone == ankle) | (bone == toe)).nonzero()[:, 0]
            low = foot[body.template[foot, 1] < body.template[foot, 1].min() + _SOLE_DEPTH]
            place = body.template[low]
            spread.append(low[_spread(place, min(_SOLE_POINTS, len(low)))])
            rigid = low[bone[low] == ankle]
            along = body.template[rigid, 2].argsort()
            heels.append(rigid[along[:_PATCH]])
            balls.append(rigid[along[-_PATCH:]])
        count = min(map(len, spread))
        return cls(
            points=torch.stack([points[:count] for points in spread]),
            heels=torch.stack(heels),
            balls=torch.stack(balls),
        )


def _spread(points: Float[Tensor, "points 3"], count: int) -> list[int]:
    """Farthest point sampling, from the rearmost on."""
    chosen = [int(points[:, 2].argmin())]
    distance = (points - points[chosen[0]]).norm(dim=-1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = distance.minimum((points - points[chosen[-1]]).norm(dim=-1))
    return chosen


def standing_flat(feet: Float[Tensor, "time 4 3"], fps: float) -> Bool[Tensor, "time 2"]:
    """Frames in which the left and right foot stand flat.

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


@dataclass(frozen=True)
class Stance:
    """Soles of one clip, and the frames in which they carry weight."""

    lowest: Float[Tensor, "time 2 3"]
    """Lowest point under the left and the right foot, world, metres."""
    slow: Bool[Tensor, "time 2"]
    """Ankle or toe is slower than 0.25 m/s."""
    firm: Bool[Tensor, "time 2"]
    """Ankle and toe are."""

    @classmethod
    def of(
        cls,
        motion: Motion,
        body: BodyModel,
        soles: Soles,
        belt: Float[Tensor, " 2"] | None = None,
        frames: Bool[Tensor, " time"] | None = None,
    ) -> "Stance":
        """The soles of a motion's feet, and the frames in which they stand still.

        Args:
            motion: one clip.
            body: whose motion it is.
            soles: of that body.
            belt: velocity of the ground they stand on, m/s; None is a floor at rest.
            frames: that count; in the others no foot stands. None counts all.
        """
        lowest = []
        for first in range(0, motion.frames, _CHUNK):
            posed = body.pose(motion.window(first, first + _CHUNK))
            points = posed.points(soles.points.flatten()).unflatten(-2, soles.points.shape)
            deepest = points[..., 2].argmin(-1)[..., None, None]
            lowest.append(points.take_along_dim(deepest, -2).squeeze(-2))
        joints = body.pose(motion).joints[..., list(FEET), :]
        if belt is not None:
            moved = (torch.arange(motion.frames) / motion.fps)[:, None] * belt
            joints = joints - torch.nn.functional.pad(moved, (0, 1))[:, None]
        slow = (speeds(joints, motion.fps) < MAXIMUM_SPEED).unflatten(-1, (2, 2))
        if frames is not None:
            slow = slow & frames[:, None, None]
        return cls(torch.cat(lowest), slow.any(-2), slow.all(-2))

    @property
    def frames(self) -> int:
        """Frames in which a foot carries weight."""
        return int(self.slow.any(-1).sum())

    def height(self) -> float:
        """Height of level ground, metres.

        The 5th percentile over stance frames of the sole's lowest point; over all frames when no
        foot ever stands.
        """
        heights = self.lowest[..., 2]
        chosen = heights[self.slow] if self.frames > 0 else heights.amin(-1)
        return float(chosen.quantile(_GROUND_PERCENTILE))


def levelling(stance: Stance) -> Float[Tensor, "3 3"] | None:
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
    # the normal (-a, -b, 1) goes to z: about n × z = (-b, a, 0)
    return so3.exp(-axis * angle).float()


def turned(motion: Motion, rotation: Float[Tensor, "3 3"], body: BodyModel) -> Motion:
    """A motion in a world that is rotated about its origin."""
    T = torch.eye(4).to(motion.translation)
    T[:3, :3] = rotation
    return motion.carried(T, body.rest_joints(motion.shape)[..., 0, :])
