"""Soles: their vertices, frames in which a foot stands, and the height of the ground."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.contacts import MAXIMUM_SPEED, speeds
from recon.body.model import BodyModel
from recon.body.parts import farthest_points
from recon.core.motion import Motion
from recon.core.skeleton import FEET, joint_index

_SOLE_DEPTH = 0.015
"""Vertices within this height of a foot's lowest belong to its sole, metres."""
_SOLE_POINTS = 16
"""Vertices per foot that stand for the sole."""
_PATCH = 4
"""Vertices per foot that stand for its heel and for its ball."""
_GROUND_PERCENTILE = 0.05
_CHUNK = 2000


@dataclass(frozen=True)
class Soles:
    """Vertex numbers of the soles, heels and balls of the left and the right foot."""

    points: Int[Tensor, "2 points"]
    heels: Int[Tensor, "2 patch"]
    balls: Int[Tensor, "2 patch"]

    @classmethod
    def of(cls, body: BodyModel) -> "Soles":
        """Choose vertices spread over both soles, and those at heel and ball of each foot."""
        spread, heels, balls = [], [], []
        bone = body.weights.argmax(-1)
        for side in ("left", "right"):
            ankle, toe = joint_index(f"{side}_ankle"), joint_index(f"{side}_foot")
            foot = ((bone == ankle) | (bone == toe)).nonzero()[:, 0]
            low = foot[body.template[foot, 1] < body.template[foot, 1].min() + _SOLE_DEPTH]
            place = body.template[low]
            rearmost = place[:, 2].argmin()[None]
            spread.append(low[farthest_points(place, rearmost, min(_SOLE_POINTS, len(low)))])
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


@dataclass(frozen=True)
class Stance:
    """Lowest point of each sole in a clip, and masks of frames in which a foot stands."""

    lowest: Float[Tensor, "time 2 3"]
    """Lowest point under the left and the right foot, world, metres."""
    slow: Bool[Tensor, "time 2"]
    """Ankle or toe is slower than 0.25 m/s."""
    firm: Bool[Tensor, "time 2"]
    """Ankle and toe are both slower than that."""

    @classmethod
    def of(
        cls,
        motion: Motion,
        body: BodyModel,
        soles: Soles,
        belt: Float[Tensor, " 2"] | None = None,
        frames: Bool[Tensor, " time"] | None = None,
    ) -> "Stance":
        """Compute the lowest sole points of a motion, and the frames in which feet stand still.

        Args:
            motion: one clip.
            body: whose motion it is.
            soles: of that body.
            belt: velocity of the ground they stand on, m/s; None is a floor at rest.
            frames: that count; in the others no foot stands. None counts all.
        """
        lowest = []
        for first in range(0, motion.frames, _CHUNK):
            posed = body.pose(motion.window(first, min(first + _CHUNK, motion.frames)))
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
    def standing_frames(self) -> int:
        """Number of frames in which at least one foot stands."""
        return int(self.slow.any(-1).sum())

    def ground_height(self) -> float:
        """Estimate the height of level ground below the clip, metres.

        The 5th percentile over stance frames of the sole's lowest point; over all frames when no
        foot ever stands.
        """
        heights = self.lowest[..., 2]
        chosen = heights[self.slow] if self.standing_frames > 0 else heights.amin(-1)
        return float(chosen.quantile(_GROUND_PERCENTILE))


def ground_heights(motion: Motion, body: BodyModel) -> Float[Tensor, " clips"]:
    """Estimate the height of level ground below every clip from its soles, metres."""
    body_on_cpu, clips = body.to(device="cpu"), motion.detach().to(device="cpu")
    soles = Soles.of(body_on_cpu)
    heights = [
        Stance.of(clip.window(0, int(clip.valid.sum())), body_on_cpu, soles).ground_height()
        for clip in (clips[row] for row in range(len(clips.translation)))
    ]
    return motion.translation.new_tensor(heights)
