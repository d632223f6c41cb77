"""The ground as a plane, and the world it defines for a camera of unknown pose.

This is geometry only. The ground of a recording is estimated in `recon.fitting.clip`, from the
first guess of `recon.fitting.ground`.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.struct import TensorStruct

_UPRIGHT = 1e-6
"""Squared sine of the angle between a direction and the normal below which it has no heading."""


@dataclass(frozen=True)
class Ground(TensorStruct):
    """The plane n·x = d with unit normal n pointing up, in whatever frame the normal is given.

    Normal and offset are kept apart: n·d, one vector for both, is singular at d = 0.
    """

    normal: Float[Tensor, "*batch 3"]
    offset: Float[Tensor, "*batch"]
    """d, metres."""

    @classmethod
    def create(
        cls, normal: Float[Tensor, "*batch 3"], offset: Float[Tensor, "*batch"]
    ) -> "Ground":
        """The plane n·x = d from a normal of any length; d is in units of that length.

        Raises:
            ValueError: when a normal is zero.
        """
        length = normal.norm(dim=-1)
        if not bool((length > 0).all()):
            raise ReconError(f"a ground needs a normal that is not zero, got {normal.tolist()}")
        return cls(normal / length[..., None], offset / length)

    @classmethod
    def seen_from(cls, T_camera_world: Float[Tensor, "*batch 4 4"]) -> "Ground":
        """The world's ground z = 0 in the frame of a camera of known pose."""
        normal = T_camera_world[..., :3, 2]
        return cls(normal, (normal * T_camera_world[..., :3, 3]).sum(-1))

    @property
    def coefficients(self) -> Float[Tensor, "*batch 4"]:
        """(nx, ny, nz, d), as files hold it."""
        return torch.cat((self.normal, self.offset[..., None]), -1)

    def heights(self, points: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape"]:
        """Signed distance n·p - d of points above the ground, metres.

        The ground's axes are the leading ones of the points, as (batch) of (batch time joints).
        """
        inner = (1,) * (points.dim() - self.normal.dim())
        normal = self.normal.unflatten(-1, (*inner, 3))
        return (points * normal).sum(-1) - self.offset[(..., *(None for _ in inner))]

    def moved(self, tilt: Float[Tensor, "*batch 2"], shift: Float[Tensor, "*batch"]) -> "Ground":
        """The ground after turning its normal along two tangent directions and shifting it.

        n' = cos|v| n + sin|v|/|v| v with v = tilt in a basis of the tangent plane: |tilt| is the
        angle turned, in radians, and the normal stays a unit vector. `shift` is added to d.
        """
        v = (tangent_basis(self.normal) @ tilt[..., None])[..., 0]
        # The argument of the root is chosen first, so that it is never differentiated at zero.
        squared = v.square().sum(-1, keepdim=True)
        small = squared < 1e-12
        angle = torch.where(small, 1.0, squared).sqrt()
        cosine = torch.where(small, 1 - squared / 2, angle.cos())
        ratio = torch.where(small, 1 - squared / 6, angle.sin() / angle)
        normal = cosine * self.normal + ratio * v
        return Ground(torch.nn.functional.normalize(normal, dim=-1), self.offset + shift)


def tangent_basis(normal: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 2"]:
    """Two orthonormal columns perpendicular to a unit normal (Duff et al. 2017, no branch)."""
    x, y, z = normal.unbind(-1)
    sign = torch.where(z >= 0, 1.0, -1.0).to(normal)
    a = -1 / (sign + z)
    b = x * y * a
    first = torch.stack((1 + sign * x.square() * a, sign * b, -sign * x), -1)
    second = torch.stack((b, sign + y.square() * a, -y), -1)
    return torch.stack((first, second), -1)


def canonical_rotation(
    ground: Ground, root: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch 3 3"]:
    """Rotation into the frame whose z is the ground's normal and whose y is the body's forward.

    Its rows are right, forward and up with right = r - (r·n) n, normalised, for the body's right
    r = -root[:, 0], up = n and forward = cross(n, right). The closed form has no singularity
    where r is parallel to the ground, as HuMoR's intersection of a ray with the plane has. Where
    r is vertical (a body lying on its side) the heading is that of the body's front, root[:, 2].
    """
    up = ground.normal
    side, front = -root[..., :, 0], root[..., :, 2]
    along = side - (side * up).sum(-1, keepdim=True) * up
    # `front` is horizontal, hence not parallel to up, where r is vertical.
    spare = torch.linalg.cross(front, up, dim=-1)
    defined = along.square().sum(-1, keepdim=True) > _UPRIGHT
    right = torch.nn.functional.normalize(torch.where(defined, along, spare), dim=-1)
    return torch.stack((right, torch.linalg.cross(up, right, dim=-1), up), -2)


def world_from_camera(
    ground: Ground, root: Float[Tensor, "*batch 3 3"], origin: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 4 4"]:
    """T_world_camera of a camera whose pose is unknown but that sees ground and body.

    The world's z = 0 is the ground, its y the body's forward direction in the first frame, and
    `origin` (a point such as the first pelvis, camera frame, metres) lies above its origin. All
    of it follows from values a fit moves, so gradients reach the ground through it.
    """
    rotation = canonical_rotation(ground, root)
    turned = (rotation @ origin[..., None])[..., 0]
    shift = torch.cat((-turned[..., :2], -ground.offset[..., None]), -1)
    return so3.rigid(rotation, shift)
