"""A motion in features that hardly depend on the body's shape: the input of the HUMOS encoder.

Per frame: which way the body faces, the orientation of every bone seen from there, the place of
the pelvis in lengths of leg, and how high the lowest point of the body is. HUMOS has the height
of the pelvis in place of that; ours puts feet on the ground whatever the length of the legs.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import conv1d, pad

from recon.body.model import BodyModel, PosedBody
from recon.body.motion_files import leg_length
from recon.body.sampled import SampledSurface
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import LEGS, PARENTS
from recon.core.struct import TensorStruct
from recon.physics.energies import lowest_point

BONES = 22
NUMBERS = 6 * BONES + 5
"""Numbers of a frame: 6D orientations, direction (2), place (2), clearance."""

_LEVER_OF_DIRECTION = 0.4
_LEVER_OF_PLACE = 0.85
_LEVER_OF_CLEARANCE = 2.0
_LEAST_LEVER = 0.08
"""Metres by which an error of one moves what hangs from a bone, about; twice for the ground."""
_LEGS = 1.5
"""Factor of the bones of the legs in the encoded errors, as feet must not slip."""
_SMOOTHING = 4.0
"""Frames (20 Hz) over which the direction is averaged: it is undefined for who lies on a side."""


@dataclass(frozen=True)
class BodyFrames(TensorStruct):
    """Poses of all frames, relative to the first frame's pelvis position and heading."""

    orientations: Float[Tensor, "*batch time 22 3 3"]
    """Orientation of every bone relative to the rest pose, in a frame that turns with the body's
    heading."""
    direction: Float[Tensor, "*batch time 2"]
    """Cosine and sine of the heading, counted from that of the first frame."""
    place: Float[Tensor, "*batch time 2"]
    """Place of the pelvis on the ground, in lengths of leg."""
    clearance: Float[Tensor, "*batch time"]
    """Height of the body's lowest point, in lengths of leg."""

    @classmethod
    def of(
        cls, motion: Motion, body: BodyModel
    ) -> tuple["BodyFrames", Float[Tensor, "*batch 4 4"]]:
        """Return the features of a motion's frames, and T_world_frames of its first frame."""
        posed = body.pose(motion)
        heading = _headings(motion)
        turn = rotation_about_vertical(heading)
        seen = turn.mT[..., None, :, :] @ posed.orientations
        first = turn[..., 0, :, :]
        pelvis = posed.joints[..., 0, :]
        start = pelvis[..., :1, :] * pelvis.new_tensor([1.0, 1.0, 0.0])
        legs = leg_length(body, motion.shape)[..., None]
        relative = (heading[..., None, :] @ first[..., None, :2, :2])[..., 0, :]
        frames = cls(
            orientations=seen,
            direction=relative,
            place=((pelvis - start) @ first)[..., :2] / legs[..., None],
            clearance=lowest_heights(posed) / legs,
        )
        return frames, so3.rigid(first, start[..., 0, :])

    def motion(
        self,
        shape: Float[Tensor, "*batch shape"],
        body: BodyModel,
        fps: float,
        base: Float[Tensor, "*batch 4 4"],
    ) -> Motion:
        """Return the motion of a body of given shape; `base` is T_world_frames of its start."""
        turn = base[..., None, :3, :3] @ rotation_about_vertical(self.direction)
        world = turn[..., None, :, :] @ self.orientations
        local = world[..., list(PARENTS[1:]), :, :].mT @ world[..., 1:, :, :]
        rotations = torch.cat((world[..., :1, :, :], local), -3)
        legs = leg_length(body, shape)[..., None]
        place = pad(self.place * legs[..., None], (0, 1))
        pelvis = place @ base[..., :3, :3].mT + base[..., None, :3, 3]
        flat = pelvis * pelvis.new_tensor([1.0, 1.0, 0.0])
        rest = body.rest_joints(shape)[..., None, 0, :]
        down = Motion.create(flat - rest, rotations, shape, fps)
        height = self.clearance * legs - lowest_heights(body.pose(down)) + base[..., None, 2, 3]
        return down.replace(translation=down.translation + pad(height[..., None], (2, 0)))

    def joints(
        self, shape: Float[Tensor, "*batch shape"], body: BodyModel
    ) -> Float[Tensor, "*batch time 22 3"]:
        """Joint positions, metres: z relative to the pelvis, x and y to the first frame's pelvis.

        Orientations are those of bones, not of joints beside their parents: what hangs from a
        joint does not turn with its error.
        """
        rest = body.rest_joints(shape)
        bones = rest[..., 1:, :] - rest[..., PARENTS[1:], :]
        turned = self.orientations[..., list(PARENTS[1:]), :, :] @ bones[..., None, :, :, None]
        from_pelvis = _bones_above_joints().to(rest) @ turned[..., 0]
        world = from_pelvis @ rotation_about_vertical(self.direction).mT
        legs = leg_length(body, shape)[..., None, None]
        return world + pad(self.place * legs, (0, 1))[..., None, :]

    def pack(self) -> Float[Tensor, "*batch time numbers"]:
        """Return one vector per frame with all features in metres (angles times lever lengths)."""
        columns = so3.to_6d(self.orientations).flatten(-2)
        rest = torch.cat((self.direction, self.place, self.clearance[..., None]), -1)
        return torch.cat((columns, rest), -1) * _metres_per_feature().to(columns)

    @classmethod
    def unpack(cls, rows: Float[Tensor, "*batch time numbers"]) -> "BodyFrames":
        """Return the frames of packed rows (inverse of `pack`), with exact rotation matrices."""
        rows = rows / _metres_per_feature().to(rows)
        angle = rows[..., -5:-3]
        length = angle.square().sum(-1, keepdim=True).clamp(min=1e-6).sqrt()
        return cls(
            orientations=so3.from_6d(rows[..., :-5].unflatten(-1, (BONES, 6))),
            direction=angle / length,
            place=rows[..., -3:-1],
            clearance=rows[..., -1],
        )


def lowest_heights(posed: PosedBody) -> Float[Tensor, "*batch time"]:
    """Height of the lowest point of the body in every frame, metres."""
    vertices = SampledSurface.of(posed.model).vertices
    return lowest_point(posed.points(vertices)[..., 2])


def _headings(motion: Motion) -> Float[Tensor, "*batch time 2"]:
    """Cosine and sine of the direction the body faces (0: +y), averaged over a fifth of a second.

    Padding counts as its last frame; who turns somersaults keeps the direction of before.
    """
    right = -motion.rotations[..., 0, :2, 0]
    width = max(1.0, _SMOOTHING * motion.fps / 20)
    reach = int(2 * width)
    steps = torch.arange(-reach, reach + 1, dtype=right.dtype, device=right.device)
    window = (-0.5 * (steps / width).square()).exp()
    rows = right.reshape(-1, motion.frames, 2).mT.reshape(-1, 1, motion.frames)
    padded = pad(rows, (reach, reach), mode="replicate")
    mean = conv1d(padded, (window / window.sum())[None, None])
    mean = mean.reshape(-1, 2, motion.frames).mT.reshape(right.shape)
    length = mean.square().sum(-1, keepdim=True).sqrt()
    fallback = mean.new_tensor([1.0, 0.0])
    return torch.where(length > 1e-6, mean / length.clamp(min=1e-6), fallback)


def rotation_about_vertical(direction: Float[Tensor, "*shape 2"]) -> Float[Tensor, "*shape 3 3"]:
    """Return the rotation matrix about the vertical for a given (cosine, sine)."""
    c, s = direction.unbind(-1)
    zero, one = torch.zeros_like(c), torch.ones_like(c)
    return torch.stack((c, -s, zero, s, c, zero, zero, zero, one), -1).unflatten(-1, (3, 3))


@lru_cache(maxsize=1)
def _bones_above_joints() -> Float[Tensor, "22 21"]:
    """Matrix (joint, k): 1 where the bone ending at joint k + 1 lies between pelvis and joint."""
    rows = torch.zeros(BONES, BONES - 1)
    for joint in range(1, BONES):
        rows[joint] = rows[PARENTS[joint]]
        rows[joint, joint - 1] = 1
    return rows


@lru_cache(maxsize=1)
def lever_lengths() -> Float[Tensor, " 22"]:
    """Approximate metres by which turning a bone by one radian moves the bones that follow it.

    Of the average body; bones of the legs count half as much again, and none less than 8 cm.
    """
    rest = BodyModel.load().joint_template
    length = torch.full((BONES,), _LEAST_LEVER)
    for joint in range(1, BONES):
        parent = PARENTS[joint]
        length[parent] = length[parent].maximum((rest[joint] - rest[parent]).norm())
    length[[1, 2, *LEGS]] *= _LEGS
    return length


@lru_cache(maxsize=1)
def _metres_per_feature() -> Float[Tensor, " numbers"]:
    """Factor that converts every feature of a frame to metres."""
    places = [_LEVER_OF_DIRECTION] * 2 + [_LEVER_OF_PLACE] * 2 + [_LEVER_OF_CLEARANCE]
    return torch.cat((lever_lengths().repeat_interleave(6), torch.tensor(places)))


HOP = 8
"""Frames from one window to the next: 0.4 s at 20 Hz."""
WINDOW = 2 * HOP
_LEAST = 0.02
"""Deviation of a direction, beside that of the first, below which it is not scaled up further."""


@dataclass(frozen=True)
class LappedBasis(TensorStruct):
    """Linear map between the rows of a motion and coefficients of about unit variance.

    Window k holds frames 8 (k - 1), ..., 8 (k + 1) - 1, each times a sine window whose squares
    add up to one over neighbours; rows beyond the ends repeat the first and the last. So the sum
    of all windows is the motion again, and no seam is seen where some directions are left out.
    """

    mean: Float[Tensor, " window_numbers"]
    directions: Float[Tensor, "basis window_numbers"]
    """Principal directions of windows, orthonormal."""
    deviation: Float[Tensor, " basis"]
    """Standard deviation along each, metres."""

    @property
    def scale(self) -> Float[Tensor, " basis"]:
        """Standard deviation in metres by which each coefficient is divided, bounded below."""
        return self.deviation.clamp(min=_LEAST * float(self.deviation[0]))

    def analyse(
        self, rows: Float[Tensor, "*batch time numbers"]
    ) -> Float[Tensor, "*batch windows basis"]:
        """Return the coefficients in this basis of all windows of a motion's feature rows."""
        return (cut_windows(rows) - self.mean) @ self.directions.mT / self.scale

    def synthesise(
        self, coefficients: Float[Tensor, "*batch windows basis"], frames: int
    ) -> Float[Tensor, "*batch time numbers"]:
        """The first `frames` rows of the motion with these coefficients."""
        windows = self.mean + (coefficients * self.scale) @ self.directions
        return _sum_of_windows(windows.unflatten(-1, (WINDOW, NUMBERS)), frames)


def window_count(frames: int) -> int:
    """Number of windows that a number of frames is cut into."""
    return math.ceil(frames / HOP) + 1


def existing_windows(
    count: Int[Tensor, "*batch 1"], frames: int
) -> Bool[Tensor, "*batch windows"]:
    """Mask of the windows that contain one of the first `count` frames."""
    first = torch.arange(window_count(frames), device=count.device) * HOP
    return first < count + HOP


def cut_windows(rows: Float[Tensor, "*batch time numbers"]) -> Float[Tensor, "*batch windows all"]:
    """Overlapping windows of a motion's rows, each flattened to a vector."""
    frames = rows.shape[-2]
    count = window_count(frames)
    place = torch.arange(-HOP, count * HOP, device=rows.device).clamp(0, frames - 1)
    padded = rows[..., place, :]
    windows = padded.unfold(-2, WINDOW, HOP).transpose(-1, -2)
    return (windows * _sine_window().to(rows)[:, None]).flatten(-2)


def _sum_of_windows(
    windows: Float[Tensor, "*batch windows 16 numbers"], frames: int
) -> Float[Tensor, "*batch time numbers"]:
    """Add up overlapping windows, each weighted and at its time, to the rows of a motion."""
    weighed = windows * _sine_window().to(windows)[:, None]
    early, late = weighed[..., 1:, :HOP, :], weighed[..., :-1, HOP:, :]
    return (early + late).flatten(-3, -2)[..., :frames, :]


@lru_cache(maxsize=1)
def _sine_window() -> Float[Tensor, " window"]:
    return ((torch.arange(WINDOW) + 0.5) * math.pi / WINDOW).sin()
