"""Simulates sensors for windows of motion: noise, gaps, hidden limbs, single frames."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from priors.look.points import SeenPoints
from recon.body.model import BodyModel
from recon.core.skeleton import JOINTS, descendants

SLOTS = 32
"""Points of a window; those that a sensor lacks are never visible."""
_LIMBS = tuple(
    frozenset(descendants(JOINTS.index(name)))
    for name in ("left_hip", "right_hip", "left_collar", "right_collar", "neck")
)
"""Joints of both legs, both arms and the head."""


@dataclass(frozen=True)
class SensorSettings:
    """Settings of the simulated sensors; a share is the probability that a window is affected."""

    as_joints: float = 0.55
    """The 22 joints; else 6 to 32 points on the skin."""
    fewer: float = 0.4
    """Some joints are never measured, as in other skeletons."""
    noise: tuple[float, float] = (0.002, 0.06)
    """Least and largest standard deviation of a coordinate, metres, uniform in the logarithm."""
    placed: float = 0.015
    """Largest standard deviation by which points are away from where they are said to be, m."""
    below: float = 0.35
    """Points below a height are hidden."""
    limbs: float = 0.25
    """Some limbs are hidden, all the time or for a while."""
    gap: float = 0.35
    """Nothing, or some limbs, is seen for a while."""
    single_points: float = 0.3
    """Single points are missing in single frames."""
    single_frames: float = 0.15
    """Nothing is seen in single frames."""
    outliers: float = 0.2
    """Some points are up to half a metre away."""
    shorter: float = 0.5
    """The window is shorter than the others."""

    def points_of(
        self,
        joints: Float[Tensor, "windows time 22 3"],
        orientations: Float[Tensor, "windows time 22 3 3"],
        body: BodyModel,
        random: torch.Generator,
    ) -> SeenPoints:
        """Simulated sensor points of windows of motion at 30 Hz, with noise and gaps.

        Args:
            joints: true positions, world, metres.
            orientations: true orientations of the bones.
            body: whose skin the points lie on.
            random: on the device of the joints.
        """
        draw = _RandomNumbers(joints, random)
        count, time = joints.shape[:2]
        rows = torch.arange(count, device=joints.device)
        vertex = draw.integers(len(body.template), count, SLOTS)
        skin_bone = body.weights.argmax(-1)[vertex]
        skin_offset = body.template[vertex] - body.joint_template[skin_bone]
        slot = torch.arange(SLOTS, device=joints.device).expand(count, -1)
        of_joints = draw.with_probability(self.as_joints, count)[:, None]
        bone = slot.clamp(max=len(JOINTS) - 1).where(of_joints, skin_bone)
        offset = skin_offset.where(~of_joints[..., None], 0.0)
        shown = (slot < len(JOINTS)).where(of_joints, slot < draw.integers(27, count, 1) + 6)
        shown = shown & ~(
            draw.with_probability(self.fewer, count, 1) & draw.with_probability(0.3, count, SLOTS)
        )

        wrong = draw.uniform(count, 1, 1) * self.placed * draw.normal(count, SLOTS, 3)
        true = joints[rows[:, None], :, bone].transpose(1, 2)
        turns = orientations[rows[:, None], :, bone].transpose(1, 2)
        true = true + (turns @ (offset + wrong)[:, None, ..., None])[..., 0]
        low, high = torch.tensor(self.noise).log().tolist()
        std = (low + (high - low) * draw.uniform(count)).exp()
        places = true + std[:, None, None, None] * draw.normal(*true.shape)
        wild = draw.with_probability(self.outliers, count, 1, 1) & draw.with_probability(
            0.03, count, time, SLOTS
        )
        places = places + wild[..., None] * (draw.uniform(*true.shape) - 0.5)

        seen = shown[:, None] & self._visible_points(draw, true, bone)
        length = 20 + draw.integers(max(time - 20, 1), count)
        length = length.where(draw.with_probability(self.shorter, count), time)
        exists = torch.arange(time, device=joints.device) < length[:, None]
        return SeenPoints(places, seen & exists[..., None], bone, offset, std, exists)

    def _visible_points(
        self, draw: "_RandomNumbers", true: Tensor, bone: Tensor
    ) -> Bool[Tensor, "windows time points"]:
        """Mask of the points that remain visible after random hiding by limb, time and point."""
        count, time = true.shape[:2]
        height = 0.3 + 0.9 * draw.uniform(count, 1, 1)
        always = draw.with_probability(0.6, count, 1)
        low = (true[..., 2] < height) & (always | draw.stretches(count, time, 0.3, 2.0))[..., None]
        hidden = low & draw.with_probability(self.below, count, 1, 1)
        for share, whole, usual in ((self.limbs, 0.0, 0.6), (self.gap, 0.3, 0.0)):
            own = self._points_of_random_limbs(draw, bone, whole)
            when = draw.with_probability(usual, count, 1) | draw.stretches(count, time, 0.2, 2.0)
            hidden |= own[:, None] & when[..., None] & draw.with_probability(share, count, 1, 1)
        rate = (
            0.7
            * draw.uniform(count, 1, 1)
            * draw.with_probability(self.single_points, count, 1, 1)
        )
        hidden |= draw.uniform(*true.shape[:3]) < rate
        rate = (
            0.6
            * draw.uniform(count, 1, 1)
            * draw.with_probability(self.single_frames, count, 1, 1)
        )
        hidden |= draw.uniform(count, time, 1) < rate
        return ~hidden

    def _points_of_random_limbs(
        self, draw: "_RandomNumbers", bone: Tensor, whole: float
    ) -> Bool[Tensor, "windows points"]:
        """Mask of the points of random limbs, or with probability `whole` of all points."""
        count = len(bone)
        table = torch.tensor(
            [[joint in limb for joint in range(len(JOINTS))] for limb in _LIMBS],
            device=bone.device,
        )
        chosen = draw.with_probability(0.4, count, len(_LIMBS))
        joints = (chosen.float() @ table.float()) > 0
        return joints.gather(1, bone) | draw.with_probability(whole, count, 1)


CLEAR = SensorSettings(
    as_joints=1.0, fewer=0.0, noise=(0.01, 0.0101), placed=0.0, below=0.0, limbs=0.0, gap=0.0,
    single_points=0.0, single_frames=0.0, outliers=0.0, shorter=0.0,
)  # fmt: skip
"""All joints of whole windows with 1 cm of noise, to which checks add one difficulty each."""


@dataclass(frozen=True)
class _RandomNumbers:
    """Draws random numbers with the precision and on the device of a tensor."""

    like: Tensor
    random: torch.Generator

    def uniform(self, *size: int) -> Tensor:
        return torch.rand(size, generator=self.random, device=self.like.device)

    def normal(self, *size: int) -> Tensor:
        return torch.randn(size, generator=self.random, device=self.like.device)

    def integers(self, below: int, *size: int) -> Tensor:
        return torch.randint(below, size, generator=self.random, device=self.like.device)

    def with_probability(self, share: float, *size: int) -> Tensor:
        return self.uniform(*size) < share

    def stretches(self, count: int, time: int, least: float, most: float) -> Tensor:
        """Mask of frames at 30 Hz: one stretch of `least` to `most` seconds in every window."""
        length = 30 * (least + (most - least) * self.uniform(count, 1))
        first = (time + length) * self.uniform(count, 1) - length
        frame = torch.arange(time, device=self.like.device)
        return (frame >= first) & (frame < first + length)
