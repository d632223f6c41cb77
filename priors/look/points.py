"""Points of the body in space as the network sees them, in a frame that walks with the person."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.core.struct import TensorStruct
from recon.method.sensor import UPRIGHT

_TRUNK_M = 0.25
"""Metres beside the middle of the standing body at which a point counts e^(-1/2) for the heading:
arms swing, and say less about where a person faces than hips and shoulders do."""
_SMOOTHED_S = 0.15
"""Seconds over which headings and places of the frames are averaged."""
REACH_M = 0.1
"""Metres that offsets of points from their joints are in for the network."""


@dataclass(frozen=True)
class SeenPoints(TensorStruct):
    """Positions of points that move with bones: joints, markers, keypoints in space.

    A point p of bone b is at x_b + R_b d: x_b and R_b are position and orientation of the joint b,
    and d is an offset in the rest frame (y up, facing z, left +x). A joint has d = 0.
    """

    positions: Float[Tensor, "clips time points 3"]
    """World (z up, ground at z = 0), metres; anything where not visible."""
    visible: Bool[Tensor, "clips time points"]
    bone: Int[Tensor, "clips points"]
    """Number of the joint whose bone carries the point."""
    offset: Float[Tensor, "clips points 3"]
    """d, metres."""
    std: Float[Tensor, " clips"]
    """Standard deviation of every coordinate, metres."""
    exists: Bool[Tensor, "clips time"]
    """False in frames that only fill a shorter clip up."""


@dataclass(frozen=True)
class WalkingFrames(TensorStruct):
    """A frame for every moment of a clip, on the ground below the person and turned with them."""

    turn: Float[Tensor, "clips time 3 3"]
    """Rotation about the vertical from this frame to the world."""
    origin: Float[Tensor, "clips time 3"]
    """Origin in the world, z = 0, metres."""

    @classmethod
    def of(cls, seen: SeenPoints, body: BodyModel, fps: float = 30.0) -> "WalkingFrames":
        """Frames in which a standing body fits points best, averaged over neighbouring moments.

        With a_p the points of the standing average body and x_p the seen ones, both horizontal and
        about their means weighted by w_p, the angle of the best rotation is that of the complex
        number Σ w_p conj(a_p) x_p (Procrustes in the plane). Its sum over neighbouring moments,
        weighted by (1 + (Δt / 0.15 s)²)^-2, also fills moments in which nothing is seen.
        """
        upright = so3.exp(cached_constant(UPRIGHT, seen.positions.device, seen.positions.dtype))
        standing = (
            body.joint_template[seen.bone] - body.joint_template[0] + seen.offset
        ) @ upright.mT
        weight = (-0.5 * standing[..., :2].square().sum(-1) / _TRUNK_M**2).exp() + 1e-3
        weight = (weight[:, None] * seen.visible).unsqueeze(-1)
        total = weight.sum(-2)
        place = seen.positions[..., :2].where(seen.visible[..., None], 0.0)
        mean = (weight * place).sum(-2) / total.clamp(min=1e-6)
        mean_standing = (weight * standing[:, None, :, :2]).sum(-2) / total.clamp(min=1e-6)
        a = weight * (standing[:, None, :, :2] - mean_standing[..., None, :])
        x = place - mean[..., None, :]
        dot = (a * x).sum((-2, -1))
        cross = (a[..., 0] * x[..., 1] - a[..., 1] * x[..., 0]).sum(-1)
        time = torch.arange(place.shape[1], device=place.device)
        apart = (time[:, None] - time) / (_SMOOTHED_S * fps)
        near = (1 + apart.square()) ** -2
        angle = torch.atan2(cross @ near, dot @ near)
        turn = so3.about_z(angle)
        # pelvis: the mean of the seen points, less its offset from the pelvis on a standing body
        middle = mean - (turn[..., :2, :2] @ mean_standing[..., None])[..., 0]
        share = total[..., 0] @ near
        origin = near @ (total * middle) / share.clamp(min=1e-6)[..., None]
        return cls(turn, torch.nn.functional.pad(origin, (0, 1)))

    def in_walking_frames(self, points: Float[Tensor, "clips time points 3"]) -> Tensor:
        """World points, expressed in the walking frame of their moment."""
        return (points - self.origin[:, :, None]) @ self.turn

    def steps_ahead(self, exists: Bool[Tensor, "clips time"]) -> Float[Tensor, "clips time 4"]:
        """How each walking frame moves to that of the next moment.

        Its horizontal shift along its own two axes, metres, then sine and cosine of its rotation
        about the vertical; zeros where the next moment does not exist.
        """
        moved = (self.origin[:, 1:] - self.origin[:, :-1])[:, :, None] @ self.turn[:, :-1]
        turned = self.turn[:, :-1].mT @ self.turn[:, 1:]
        found = torch.cat((moved[:, :, 0, :2], turned[..., 1, :1], turned[..., 0, :1]), -1)
        found = found.where(exists[:, 1:, None], 0.0)
        return torch.nn.functional.pad(found, (0, 0, 0, 1))
