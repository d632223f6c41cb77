"""Points fixed to bones as matrix products, with Jacobians by rotations about the joints.

The pose of a frame is its affine matrix [O_j | p_j] of all bones (3 x 88): orientation and joint,
world. A point is that matrix times a constant column, and so is a lever: the vector from a joint
to the part of the point that hangs from this joint. A turn by the small world vector w about joint
a moves the point by w x lever. What forces and stiffnesses at points mean for such turns follows
without any Jacobian: torques, and second moments of levers.

Coordinates of a step of one frame: the translation (3), then the turns, axis by axis: x about all
22 joints, then y, then z.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.derivatives import BELOW, BonePoints
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS, PARENTS
from recon.core.struct import TensorStruct

COORDINATES = 3 + 3 * len(JOINTS)
"""Coordinates of a step of one frame: metres and radians."""


def bone_affines(
    orientations: Float[Tensor, "frames 22 3 3"], joints: Float[Tensor, "frames 22 3"]
) -> Float[Tensor, "frames 3 88"]:
    """Concatenate all bones' rotations and joint positions to [O_j | p_j], world, metres."""
    return torch.cat((orientations, joints[..., None]), -1).transpose(1, 2).flatten(-2)


def rotations_after_turns(
    rotations: Float[Tensor, "frames 22 3 3"],
    orientations: Float[Tensor, "frames 22 3 3"],
    turns: Float[Tensor, "frames 66"],
) -> Float[Tensor, "frames 22 3 3"]:
    """Return local rotations R_a Exp(O_aᵀ w_a) after rotation steps w_a about world axes."""
    world = turns.unflatten(-1, (3, -1)).transpose(1, 2)
    return rotations @ so3.exp((orientations.mT @ world[..., None])[..., 0])


def flat_world_vectors(
    local: Float[Tensor, "frames 22 3"], orientations: Float[Tensor, "frames 22 3 3"]
) -> Float[Tensor, "frames 66"]:
    """Rotate vectors from bone frames to the world, and flatten them as x, y, z of all joints."""
    return (orientations @ local[..., None])[..., 0].transpose(1, 2).flatten(-2)


def sums_over_descendants(values: Float[Tensor, "*batch 22"]) -> Float[Tensor, "*batch 22"]:
    """Return, for every joint, the sum of the values of this joint and all its descendants."""
    return values @ BELOW.to(values).mT


@dataclass(frozen=True)
class Levers(TensorStruct):
    """Constant matrices that map bone poses to points, and to lever arms about all joints."""

    points: Float[Tensor, "88 points"]
    arms: Float[Tensor, "88 columns"]
    """For every point, the columns of its lever arms about the 22 joints; zero for joints that do
    not move it."""

    @classmethod
    def of(cls, points: BonePoints) -> "Levers":
        """Build the matrices for points with offsets c_vj from joints and joint weights m_vj."""
        columns = torch.cat((points.place, points.share[..., None]), -1)
        below = BELOW.to(columns)
        arms = columns[:, None] * below[None, :, :, None]
        # an arm starts at the turning joint: subtract its position × the weights that turn with it
        shares_below = torch.diag_embed(points.share @ below.mT)
        arms[..., 3] -= shares_below
        return cls(
            columns.flatten(1).mT.contiguous(), arms.flatten(2).flatten(0, 1).mT.contiguous()
        )

    def positions(self, pose: Float[Tensor, "frames 3 88"]) -> Float[Tensor, "frames 3 points"]:
        """Return the points' positions for given bone poses, world coordinates, metres."""
        return pose @ self.points

    def arms_about_joints(
        self, pose: Float[Tensor, "frames 3 88"]
    ) -> Float[Tensor, "frames 3 points 22"]:
        """Return lever arms: vectors from joints to the points they rotate, world, metres."""
        return (pose @ self.arms).unflatten(-1, (-1, len(JOINTS)))

    def gradient_of(
        self, pose: Float[Tensor, "frames 3 88"], forces: Float[Tensor, "frames 3 points"]
    ) -> Float[Tensor, "frames 69"]:
        """Return Jᵀ forces, with J the Jacobian of the points by the 69 coordinates of a step."""
        bones = pose.unflatten(-1, (-1, 4))
        loads = (forces @ self.points.mT).unflatten(-1, (-1, 4))
        push = loads[..., 3]
        torque = torch.linalg.cross(bones, loads, dim=1).sum(-1)
        torque, push = sums_over_descendants(torque), sums_over_descendants(push)
        turns = torque - torch.linalg.cross(bones[..., 3], push, dim=1)
        return torch.cat((forces.sum(-1), turns.flatten(1)), -1)

    def jacobian(self, pose: Float[Tensor, "frames 3 88"]) -> Float[Tensor, "frames points 3 69"]:
        """Jacobian of the points by the 69 coordinates of a step, metres."""
        arms = self.arms_about_joints(pose).transpose(1, 2)
        out = arms.new_zeros(*arms.shape[:2], 3, COORDINATES)
        out.diagonal(dim1=-2, dim2=-1)[:] = 1  # derivative by the translation: the identity
        turns = out[..., 3:].unflatten(-1, (3, len(JOINTS)))
        for axis in range(3):
            after, last = (axis + 1) % 3, (axis + 2) % 3
            turns[..., after, last, :] = arms[..., axis, :]
            turns[..., last, after, :] = -arms[..., axis, :]
        return out

    def stiffness(
        self, pose: Float[Tensor, "frames 3 88"], weights: Float[Tensor, "frames points"]
    ) -> Float[Tensor, "frames 69 69"]:
        """Return Σ weight JᵀJ over points, J a point's Jacobian by the coordinates of a step."""
        arms = self.arms_about_joints(pose)
        joints = len(JOINTS)
        flat = arms.transpose(1, 2).flatten(-2)
        weighted = flat * weights[..., None]
        moments = weighted.mT @ flat
        moments = moments.unflatten(-1, (3, joints)).unflatten(-3, (3, joints))
        out = pose.new_zeros(len(pose), COORDINATES, COORDINATES)
        turns = out[:, 3:, 3:].unflatten(-1, (3, joints)).unflatten(-3, (3, joints))
        trace = moments[:, 0, :, 0] + moments[:, 1, :, 1] + moments[:, 2, :, 2]
        for row in range(3):
            for column in range(3):
                turns[:, row, :, column] = -moments[:, column, :, row]
            turns[:, row, :, row] += trace
        out.diagonal(dim1=1, dim2=2)[:, :3] = weights.sum(-1, keepdim=True)
        first = weighted.sum(1).unflatten(-1, (3, joints))
        side = out[:, :3, 3:].unflatten(-1, (3, joints))
        for axis in range(3):
            after, last = (axis + 1) % 3, (axis + 2) % 3
            side[:, after, last] = first[:, axis]
            side[:, last, after] = -first[:, axis]
        out[:, 3:, :3] = out[:, :3, 3:].mT
        return out

    def add_height_hessian(
        self,
        hessians: Float[Tensor, "all 69 69"],
        frames: Int[Tensor, " frames"],
        pose: Float[Tensor, "frames 3 88"],
        weights: Float[Tensor, "frames points"],
    ) -> None:
        """Add Σ weight jᵀj to the Hessians of given frames, j the gradients of points' heights."""
        joints = self._joints_that_move_points
        columns = self.arms.unflatten(-1, (-1, len(JOINTS)))[..., joints].flatten(1)
        arms = (pose[:, :2] @ columns).unflatten(-1, (-1, len(joints)))
        # the height changes by (w x lever)_z = w_x lever_y - w_y lever_x
        up = arms.new_ones(*arms[:, 0].shape[:2], 1)
        slopes = torch.cat((up, arms[:, 1], -arms[:, 0]), -1)
        gram = (slopes * weights[..., None]).mT @ slopes
        turned_by = torch.cat((joints, joints + len(JOINTS)))
        rows = torch.cat((torch.tensor([2]), 3 + turned_by))
        hessians[frames[:, None, None], rows[:, None], rows] += gram

    @cached_property
    def _joints_that_move_points(self) -> Int[Tensor, " some"]:
        """Numbers of the joints whose rotation moves at least one of the points."""
        arms = self.arms.unflatten(-1, (-1, len(JOINTS)))
        return (arms != 0).any(0).any(0).nonzero()[:, 0]


@dataclass(frozen=True)
class ShapeLevers(TensorStruct):
    """Constant matrices that map bone poses to the points' Jacobians by shape coefficients."""

    columns: Float[Tensor, "88 columns"]
    """For every point, one column per shape coefficient."""
    root: Float[Tensor, "3 shape"]
    """Derivatives of the place of the root at rest, which all points share."""

    @classmethod
    def of(cls, points: BonePoints, body: BodyModel) -> "ShapeLevers":
        """Build the matrices; the shape moves points on their bones and changes bone lengths."""
        count = len(points.place_by_shape)
        joints = body.joint_directions[..., :count].to(points.place)
        bones = joints[1:] - joints[list(PARENTS[1:])]
        shares_below = points.share @ BELOW.to(joints).mT
        grown = points.place_by_shape.permute(1, 2, 3, 0).clone()
        for child, parent in enumerate(PARENTS[1:], 1):
            grown[:, parent] += shares_below[:, child, None, None] * bones[child - 1]
        # `pose` holds joint positions beside the rotations; zeros leave the positions out
        columns = torch.nn.functional.pad(grown, (0, 0, 0, 1))
        return cls(columns.permute(1, 2, 0, 3).flatten(2).flatten(0, 1), joints[0])

    def jacobian_by_shape(
        self, pose: Float[Tensor, "frames 3 88"]
    ) -> Float[Tensor, "frames points 3 shape"]:
        """Return the Jacobian of the points by the shape coefficients, metres."""
        moved = (pose @ self.columns).unflatten(-1, (-1, self.root.shape[-1]))
        return moved.transpose(1, 2) + self.root
