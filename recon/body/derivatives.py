"""Points of the body and their Jacobians by joint rotations and shape, in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import cached_constant
from recon.core.skeleton import JOINTS, PARENTS, descendants


@dataclass(frozen=True)
class BonePoints:
    """Points fixed to bones with rotation O_j and origin p_j: p_v = Σ_j O_j c_vj + m_vj p_j.

    Joints, points of the skin (linear blend skinning) and their means are such points.
    """

    share: Float[Tensor, "points 22"]
    """Numbers m_vj, the share of joint j in point v; they add up to one over j."""
    place: Float[Tensor, "points 22 3"]
    """Vectors c_vj, which turn with bone j, metres."""
    place_by_shape: Float[Tensor, "shape points 22 3"]
    """Their derivatives by the coefficients of the shape."""
    own_joints: tuple[int, ...] | None = None
    """The joint that each point is identical with; None where some may be no joints."""

    @classmethod
    def create(
        cls,
        body: BodyModel,
        shape: Float[Tensor, " shape"],
        of_joints: Float[Tensor, "points 22"],
        of_vertices: Float[Tensor, "points vertices"],
        vertices: Int[Tensor, " vertices"],
    ) -> "BonePoints":
        """Points as means of joints and vertices, p = A joints + B vertices.

        The rotation-dependent corrections of SMPL bodies are left out.
        """
        weights = body.weights[vertices]
        surface, joints = body.rest_vertices(shape, vertices), body.rest_joints(shape)
        away = surface[:, None] - joints
        directions = body.shape_directions[vertices][:, None] - body.joint_directions
        place = torch.einsum("vu,uj,ujd->vjd", of_vertices, weights, away)
        by_shape = torch.einsum("vu,uj,ujdk->kvjd", of_vertices, weights, directions)
        return cls(of_joints + of_vertices @ weights, place, by_shape[: len(shape)])

    @classmethod
    def of_joints(cls, body: BodyModel, shape: Float[Tensor, " shape"]) -> "BonePoints":
        """Return the 22 joints of the body as points on bones."""
        count = len(JOINTS)
        none = torch.zeros(0, dtype=torch.long, device=shape.device)
        eye = torch.eye(count, dtype=shape.dtype, device=shape.device)
        found = cls.create(body, shape, eye, shape.new_zeros(count, 0), none)
        return replace(found, own_joints=tuple(range(count)))

    def selected(self, rows: Sequence[int]) -> "BonePoints":
        """Return the points with the given numbers, in the given order."""
        order, own = cached_constant(tuple(rows), self.share.device), self.own_joints
        return BonePoints(
            self.share[order], self.place[order], self.place_by_shape[:, order],
            None if own is None else tuple(own[row] for row in rows),
        )  # fmt: skip

    def displaced(self, bones: Sequence[int], offsets: Float[Tensor, "points 3"]) -> "BonePoints":
        """Return the points shifted by constant offsets (m), each in the axes of its bone."""
        place = self.place.clone()
        of_bone = cached_constant(tuple(bones), place.device)
        place[torch.arange(len(place), device=place.device), of_bone] += offsets
        return replace(self, place=place, own_joints=None)

    def positions(
        self,
        orientations: Float[Tensor, "*batch 22 3 3"],
        joints: Float[Tensor, "*batch 22 3"],
    ) -> Float[Tensor, "*batch points 3"]:
        """Positions of the points for given world poses of the bones, metres."""
        return _offsets_in_world(self.place, orientations).sum(-2) + self.share @ joints

    def jacobian_by_rotations(
        self, orientations: Float[Tensor, "time 22 3 3"], joints: Float[Tensor, "time 22 3"]
    ) -> Float[Tensor, "time points 3 66"]:
        """Jacobian of the points by steps d_a of joint rotations R_a Exp(d_a), metres per radian.

        A step rotates all descendants of joint a about p_a by the world vector O_a d_a.
        """
        parts = (
            _offsets_in_world(self.place, orientations) + self.share[:, :, None] * joints[:, None]
        )
        below = cached_constant(_BELOW, parts.device, parts.dtype)
        levers = below @ parts - (self.share @ below.mT)[:, :, None] * joints[:, None]
        axes = orientations.mT[:, None]  # shape: time, 1, joints, axes, 3
        turned = torch.linalg.cross(axes, levers[..., None, :], dim=-1)
        return turned.flatten(2, 3).mT

    def jacobian_by_shape(
        self,
        orientations: Float[Tensor, "time 22 3 3"],
        body: BodyModel,
    ) -> Float[Tensor, "time points 3 shape"]:
        """Jacobian of the points by the shape coefficients, metres."""
        joints = joint_jacobian_by_shape(orientations, body, len(self.place_by_shape))
        return self.jacobian_by_shape_of(orientations, joints)

    def jacobian_by_shape_of(
        self,
        orientations: Float[Tensor, "time 22 3 3"],
        joints: Float[Tensor, "time 22 3 shape"],
    ) -> Float[Tensor, "time points 3 shape"]:
        """Jacobian of the points by shape coefficients, given that of the joints; metres."""
        # one matrix product of (time, 3, 22·3) with (points, 22·3, shape)
        turned = orientations.transpose(1, 2).flatten(2)[:, None]
        parts = turned @ self.place_by_shape.permute(1, 2, 3, 0).flatten(1, 2)
        return parts + (self.share @ joints.flatten(2)).unflatten(2, joints.shape[2:])


def joint_jacobian_by_shape(
    orientations: Float[Tensor, "time 22 3 3"], body: BodyModel, count: int
) -> Float[Tensor, "time 22 3 shape"]:
    """Return the Jacobian of the 22 joints by the first `count` shape coefficients, metres."""
    directions = body.joint_directions[..., :count].to(orientations)
    bones = directions.clone()
    parents = cached_constant((0, *PARENTS[1:]), bones.device)
    bones[1:] -= directions[parents[1:]]
    turned = orientations[:, parents] @ bones
    turned[:, 0] = bones[0]
    below = cached_constant(_BELOW, turned.device, turned.dtype)
    return (below.mT @ turned.flatten(2)).unflatten(2, turned.shape[2:])


def right_jacobian(
    steps: Float[Tensor, "*batch joints 3"],
) -> Float[Tensor, "*batch joints 3 3"]:
    """The right Jacobian J of SO(3): Exp(v + dv) = Exp(v) Exp(J dv) to first order."""
    squared = steps.square().sum(-1)[..., None, None]
    small = squared < 1e-4
    safe = torch.where(small, 1.0, squared)
    angle = safe.sqrt()
    first = torch.where(small, 0.5 - squared / 24, (1 - angle.cos()) / safe)
    second = torch.where(small, 1 / 6 - squared / 120, (angle - angle.sin()) / (safe * angle))
    cross = so3.hat(steps)
    identity = torch.eye(3, dtype=steps.dtype, device=steps.device)
    return identity - first * cross + second * (cross @ cross)


def inverse_right_jacobian(
    steps: Float[Tensor, "*batch joints 3"],
) -> Float[Tensor, "*batch joints 3 3"]:
    """The inverse of `right_jacobian`: Log(Exp(v) Exp(d)) = v + J⁻¹ d to first order.

    J⁻¹ = 1 + ½ [v] + (1/θ² - cot(θ/2) / 2θ) [v]², with θ = |v| up to π.
    """
    squared = steps.square().sum(-1)[..., None, None]
    small = squared < 1e-4
    safe = torch.where(small, 1.0, squared)
    half = safe.sqrt() / 2
    factor = torch.where(small, 1 / 12, 1 / safe - half.cos() / (4 * half * half.sin()))
    cross = so3.hat(steps)
    identity = torch.eye(3, dtype=steps.dtype, device=steps.device)
    return identity + 0.5 * cross + factor * (cross @ cross)


def _offsets_in_world(
    place: Float[Tensor, "points 22 3"], orientations: Float[Tensor, "*batch 22 3 3"]
) -> Float[Tensor, "*batch points 22 3"]:
    return torch.einsum("...jab,vjb->...vja", orientations, place)


_EVERY = range(len(JOINTS))
_BELOW = tuple(tuple(float(k in below) for k in _EVERY) for below in map(descendants, _EVERY))
BELOW = torch.tensor(_BELOW)
"""Row a: 1 for joint a and all joints that hang from it."""
