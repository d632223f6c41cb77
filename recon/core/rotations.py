"""Rotations as matrices; exponential and logarithm that are safe at zero and at pi."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

_SMALL = 1e-8
"""Squared angle below which the Taylor series is exact to double precision."""


def hat(vector: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3 3"]:
    """Return the skew-symmetric matrix K of the cross product: K x = vector × x."""
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
        # multiplied by the transposed left Jacobian I - b K + d K², where K x = vector × x
        return axial - b[..., None] * across + d[..., None] * torch.linalg.cross(vector, across)


def log(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3"]:
    """Rotation vector of a matrix, angle in [0, pi]; the inverse of `exp`.

    Through the quaternion, whose vector is the axis times sin(a/2): unlike the arc cosine of the
    trace it is exact at zero and at pi.
    """
    quaternion = to_quaternion(rotation)
    # q and -q are one rotation; the one with w > 0 turns by at most pi
    quaternion = quaternion * ((quaternion[..., 3:] > 0).to(quaternion) * 2 - 1)
    vector = quaternion[..., :3]
    half = torch.atan2(vector.norm(dim=-1), quaternion[..., 3])
    return 2 * _x_over_sin_x(half)[..., None] * vector


def _x_over_sin_x(x: Tensor) -> Tensor:
    """The quotient x / sin(x), by its series near zero.

    The series begins where its derivative is as exact as the one of the quotient: its error is
    31/2520 x⁵, that of the quotient, a difference of nearly equal numbers, ε / x.
    """
    small = x.abs() < 2 * torch.finfo(x.dtype).eps ** (1 / 6)
    sine = torch.where(small, 1.0, x.sin())
    return torch.where(small, 1 + x**2 / 6 + 7 * x**4 / 360, x / sine)


def to_quaternion(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 4"]:
    """One of the two unit quaternions (x, y, z, w) of a rotation.

    All four products 4 q_i q are sums of the matrix's entries; the one whose q_i is largest is
    normalised, so that nothing cancels (Markley 2008, doi 10.2514/1.31730).
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in rotation.unbind(-2))
    entries = (
        1 + a - e - i, d + b, g + c, h - f,
        b + d, 1 + e - i - a, h + f, c - g,
        c + g, f + h, 1 + i - a - e, d - b,
        h - f, c - g, d - b, 1 + a + e + i,
    )  # fmt: skip
    products = torch.stack(entries, -1).unflatten(-1, (4, 4))
    largest = products.diagonal(dim1=-2, dim2=-1).argmax(-1)
    chosen = products.take_along_dim(largest[..., None, None], -2)[..., 0, :]
    return chosen / chosen.norm(dim=-1, keepdim=True)


def axis_sine(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3"]:
    """The skew part of a rotation as a vector: its axis times the sine of its angle.

    Equals `log` for small angles, and is smooth everywhere.
    """
    skew = rotation - rotation.mT
    return torch.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), -1) / 2


def geodesic_angle(a: Float[Tensor, "*shape 3 3"], b: Float[Tensor, "*shape 3 3"]) -> Tensor:
    """Angle between two rotations, in radians: |b - a| = 2 √2 sin(angle / 2)."""
    sine = (b - a).norm(dim=(-2, -1)) * 0.5**1.5
    return 2 * sine.clamp(max=1.0).asin()


def nearest_rotation(matrix: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3 3"]:
    """The rotation closest to a matrix in the Frobenius norm (Kabsch 1976, Schönemann 1966).

    From the singular value decomposition, in double precision; where that would be a reflection
    the direction of the least singular value is turned round. Without a gradient.
    """
    with torch.no_grad():
        left, _, right = torch.linalg.svd(matrix.double())
        sign = torch.linalg.det(left @ right).sign()
        left = torch.cat((left[..., :2], left[..., 2:] * sign[..., None, None]), -1)
        return (left @ right).to(matrix)


def to_6d(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 6"]:
    """Flatten a rotation matrix to its first two columns, six numbers (Zhou et al. 2019)."""
    return rotation[..., :2].transpose(-1, -2).flatten(-2)


def from_6d(columns: Float[Tensor, "*shape 6"]) -> Float[Tensor, "*shape 3 3"]:
    """Rotation whose first two columns are the given ones, orthonormalised by Gram-Schmidt."""
    first, second = columns.unflatten(-1, (2, 3)).unbind(-2)
    x = first / first.norm(dim=-1, keepdim=True)
    across = second - (x * second).sum(-1, keepdim=True) * x
    y = across / across.norm(dim=-1, keepdim=True)
    return torch.stack((x, y, torch.linalg.cross(x, y)), -1)


def interpolate(
    a: Float[Tensor, "*shape 3 3"],
    b: Float[Tensor, "*shape 3 3"],
    fraction: Float[Tensor, "*#shape"],
) -> Float[Tensor, "*shape 3 3"]:
    """Slerp: the rotation `fraction` of the way from `a` to `b` along the shortest arc."""
    step = log(a.transpose(-1, -2) @ b)
    return a @ exp(step * fraction[..., None])


def rotation_between(
    start: Float[Tensor, "*shape 3"], end: Float[Tensor, "*shape 3"]
) -> Float[Tensor, "*shape 3 3"]:
    """The smallest rotation that takes one direction to another; vectors of any length.

    It is the identity where a vector is zero or the two are opposite.
    """
    axis = torch.linalg.cross(start, end)
    sine = axis.norm(dim=-1, keepdim=True)
    angle = torch.atan2(sine, (start * end).sum(-1, keepdim=True))
    tiny = torch.finfo(start.dtype).tiny
    return exp(axis / sine.clamp(min=tiny) * angle)


def about_z(angle: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape 3 3"]:
    """Return the matrix of a rotation about the z axis by an angle in radians."""
    zero = torch.zeros_like(angle)
    return exp(torch.stack((zero, zero, angle), -1))


def rigid(
    turn: Float[Tensor, "*shape 3 3"], shift: Float[Tensor, "*shape 3"]
) -> Float[Tensor, "*shape 4 4"]:
    """Return the 4 x 4 matrix of the transform x -> turn x + shift."""
    upper = torch.cat((turn, shift[..., None]), -1)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(upper).expand(*upper.shape[:-2], 1, 4)
    return torch.cat((upper, last), -2)


def transform(
    T: Float[Tensor, "*frames 4 4"], points: Float[Tensor, "*batch points 3"]
) -> Float[Tensor, "*all points 3"]:
    """Apply 4 x 4 rigid transforms to points; leading axes broadcast."""
    return points @ T[..., :3, :3].mT + T[..., None, :3, 3]


def inverse_rigid(T: Float[Tensor, "*shape 4 4"]) -> Float[Tensor, "*shape 4 4"]:
    """Return the inverse of a 4 x 4 rigid transform (rotation and translation)."""
    back = T[..., :3, :3].mT
    return rigid(back, -(back @ T[..., :3, 3:])[..., 0])


def undo_heading(root: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 3 3"]:
    """Return the rotation A about z that turns the body's right side to +x (forward to +y).

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
