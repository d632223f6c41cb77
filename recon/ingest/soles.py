"""Soles on the ground: their vertices, when a foot stands, and how high the ground is."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body import BodyModel
from recon.contacts import MAXIMUM_SPEED, speeds
from recon.motion import Motion
from recon.skeleton import FEET, joint_index

_SOLE_DEPTH = 0.015
"""Vertices within this height of a foot's lowest belong to its sole, metres."""
_SOLE_POINTS = 16
"""Vertices per foot that stand for the sole."""
_PATCH = 4
"""Vertices per foot that stand for its heel and for its ball."""
_STILL = 0.1
"""Ankle and toe of a foot that stands flat are slower than this, m/s."""
_FLAT = 0.03
"""And the ankle is as high above the toe as usual, within metres."""
_GROUND_PERCENTILE = 0.05
_CHUNK = 2000


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
    still = (speeds(feet, fps) < _STILL).unflatten(-1, (2, 2)).all(-2)
    rise = feet[:, :2, 2] - feet[:, 2:, 2]
    flat = torch.zeros_like(still)
    for side in (0, 1):
        if still[:, side].any():
            usual = rise[still[:, side], side].median()
            flat[:, side] = still[:, side] & ((rise[:, side] - usual).abs() < _FLAT)
    return flat


def ground_height(motion: Motion, body: BodyModel, soles: Soles) -> tuple[float, int]:
    """Height of the ground under one clip, metres, and the stance frames it was seen in.

    The 5th percentile of the lowest point of the soles over frames in which an ankle or a toe is
    slower than 0.25 m/s; over all frames when there is none.
    """
    lowest = []
    for first in range(0, motion.frames, _CHUNK):
        posed = body.pose(motion.window(first, first + _CHUNK))
        lowest.append(posed.points(soles.points.flatten())[..., 2].amin(-1))
    joints = body.pose(motion).joints[..., list(FEET), :]
    stance = (speeds(joints, motion.fps) < MAXIMUM_SPEED).any(-1)
    heights = torch.cat(lowest)
    chosen = heights[stance] if bool(stance.any()) else heights
    return float(chosen.quantile(_GROUND_PERCENTILE)), int(stance.sum())
