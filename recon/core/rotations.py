"""Rotations as matrices; exponential and logarithm that are safe at zero and at pi."""

from typing import Any, cast

import roma
import torch
from jaxtyping import Float
from torch import Tensor

_SMALL = 1e-8
"""Squared angle below which the Taylor series is exact to double precision."""


def hat(vector: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3 3"]:
    """The matrix K of the cross product: K x = vector × x."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))


def exp(vector: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3 3"]:
    """Rotation about `vector` by its length: I + sin(a)/a K + (1 - cos(a))/a² K² (Rodrigues).

    Both factors are replaced by their series near zero, so that the gradient is finite there too.
    The derivative is written out, dR = hat(J dv) R with the left Jacobian J of SO(3): a fraction
    of the operations that recording the entries would take.
    """
    return _Exponential.apply(vector)


class _Exponential(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vector: Tensor) -> Tensor:
        squared = vector.square().sum(-1)
        small = squared < _SMALL
        safe = torch.where(small, 1.0, squared)
        angle = safe.sqrt()
        a = torch.where(small, 1 - squared / 6, angle.sin() / angle)
        b = torch.where(small, 0.5 - squared / 24, (1 - angle.cos()) / safe)
        x, y, z = vector.unbind(-1)
        bx, by, bz = b * x, b * y, b * z
        ax, ay, az = a * x, a * y, a * z
        xy, xz, yz = bx * y, bx * z, by * z
        xx, yy, zz = bx * x, by * y, bz * z
        entries = (
            1 - yy - zz, xy - az, xz + ay,
            xy + az, 1 - xx - zz, yz - ax,
            xz - ay, yz + ax, 1 - xx - yy,
        )  # fmt: skip
        rotation = torch.stack(entries, -1).unflatten(-1, (3, 3))
        d = torch.where(small, 1 / 6 - squared / 120, (1 - a) / safe)
        ctx.save_for_backward(vector, rotation, b, d)
        return rotation

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        vector, rotation, b, d = ctx.saved_tensors
        turned = gradients[0] @ rotation.mT
        skew = turned - turned.mT
        axial = torch.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), -1)
        across = torch.linalg.cross(vector, axial)
        # the transposed left Jacobian: I - b K + d K²
        return axial - b[..., None] * across + d[..., None] * torch.linalg.cross(vector, across)


def log(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3"]:
    """Rotation vector of a matrix, angle in [0, pi]; the inverse of `exp`."""
    return roma.rotmat_to_rotvec(rotation)


def axis_sine(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3"]:
    """The skew part of a rotation as a vector: its axis times the sine of its angle.

    Equals `log` for small angles, and is smooth everywhere.
    """
    skew = rotation - rotation.mT
    return torch.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), -1) / 2


def geodesic(a: Float[Tensor, "*shape 3 3"], b: Float[Tensor, "*shape 3 3"]) -> Tensor:
    """Angle between two rotations, in radians."""
    return roma.rotmat_geodesic_distance(a, b)


def nearest(matrix: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3 3"]:
    """The rotation closest to a matrix in the Frobenius norm."""
    return cast(Tensor, roma.special_procrustes(matrix))


def to_6d(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 6"]:
    """The first two columns, one after the other (Zhou et al. 2019)."""
    return rotation[..., :2].transpose(-1, -2).flatten(-2)


def from_6d(columns: Float[Tensor, "*shape 6"]) -> Float[Tensor, "*shape 3 3"]:
    """Rotation whose first two columns are the Gram-Schmidt of the given ones."""
    return roma.special_gramschmidt(columns.unflatten(-1, (2, 3)).transpose(-1, -2))


def interpolate(
    a: Float[Tensor, "*shape 3 3"],
    b: Float[Tensor, "*shape 3 3"],
    fraction: Float[Tensor, "*#shape"],
) -> Float[Tensor, "*shape 3 3"]:
    """Slerp: the rotation `fraction` of the way from `a` to `b` along the shortest arc."""
    step = log(a.transpose(-1, -2) @ b)
    return a @ exp(step * fraction[..., None])


def about_z(angle: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape 3 3"]:
    """Rotation about the vertical, in radians."""
    zero = torch.zeros_like(angle)
    return exp(torch.stack((zero, zero, angle), -1))


def rigid(
    turn: Float[Tensor, "*shape 3 3"], shift: Float[Tensor, "*shape 3"]
) -> Float[Tensor, "*shape 4 4"]:
    """The transform x -> turn x + shift as one matrix."""
    upper = torch.cat((turn, shift[..., None]), -1)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(upper).expand(*upper.shape[:-2], 1, 4)
    return torch.cat((upper, last), -2)


def heading(root: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3 3"]:
    """Turn A about the vertical that brings the body's right side to +x (so forward to +y).

    With (rx, ry) the normalised horizontal part of -root[:, 0], A = [[rx, ry, 0], [-ry, rx, 0],
    [0, 0, 1]]: no arc cosine, exact at every angle. Where the right side is vertical the heading
    is undefined and A is the identity.
    """
    right = -root[..., :2, 0]
    squared = right.square().sum(-1)
    upright = squared > _SMALL
    length = torch.where(upright, squared, 1.0).sqrt()
    rx = torch.where(upright, right[..., 0] / length, 1.0)
    ry = torch.where(upright, right[..., 1] / length, 0.0)
    zero, one = torch.zeros_like(rx), torch.ones_like(rx)
    entries = (rx, ry, zero, -ry, rx, zero, zero, zero, one)
    return torch.stack(entries, -1).unflatten(-1, (3, 3))
