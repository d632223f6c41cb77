"""What points on the bones of a skeleton ask of translations and turns: torques and inertia.

The points of a bone enter by their moments alone. Those of all bones that hang from a joint add
up, and so do their torques and tensors of inertia, as in the dynamics of rigid bodies.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.derivatives import BELOW
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS

_BONES = len(JOINTS)
_HANGING = BELOW.nonzero(as_tuple=True)
"""All pairs of a joint and one that is the same or hangs from it."""


def torques(
    bones: Float[Tensor, "rows 22 3 4"], force: Float[Tensor, "rows 22 3 4"]
) -> tuple[Float[Tensor, "rows 3"], Float[Tensor, "rows 22 3"]]:
    """Derivatives of the energy by the translation and by world turns about the joints."""
    below = BELOW.to(bones)
    moment = force @ bones.mT
    # the axial part of Σ w r xᵀ is Σ w x × r
    twist = torch.stack([
        moment[..., (axis + 2) % 3, (axis + 1) % 3] - moment[..., (axis + 1) % 3, (axis + 2) % 3]
        for axis in range(3)
    ], -1)  # fmt: skip
    push = force[..., 3]
    hung = below @ push
    return push.sum(1), below @ twist - torch.linalg.cross(bones[..., 3], hung)


def inertia(
    bones: Float[Tensor, "rows 22 3 4"], stiffness: Float[Tensor, "rows 22 4 4"]
) -> tuple[Float[Tensor, " rows"], Float[Tensor, "rows 3 66"], Float[Tensor, "rows 66 66"]]:
    """Gauss-Newton second derivatives: by translations, by one and a turn, and by two turns.

    With the points x that hang from joint b, which is a or hangs from it, weighed by w, and
    U = Σ w (x - p_a) (x - p_b)ᵀ, those by turns about a and b are tr(U) - Uᵀ, as in a body's
    tensor of inertia.
    """
    rows, below = len(bones), BELOW.to(bones)
    carried = bones @ stiffness
    second, first, mass = carried @ bones.mT, carried[..., 3], stiffness[..., 3, 3]
    second = (below @ second.flatten(2)).unflatten(-1, (3, 3))
    first, mass = below @ first, mass @ below.mT
    joints = bones[..., 3]
    lever = first - mass[..., None] * joints
    # about its own joint: Σ w x (x - p_b)ᵀ, and then Σ w (x - p_a) (x - p_b)ᵀ
    own = second - first[..., None] * joints[..., None, :]
    upper, lower = _HANGING
    moments = own[:, lower] - joints[:, upper, :, None] * lever[:, lower, None, :]
    turned = -moments.mT
    turned.diagonal(dim1=-2, dim2=-1).add_(moments.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None])
    between = bones.new_zeros(rows, _BONES, _BONES, 3, 3)
    between[:, upper, lower] = turned
    between[:, lower, upper] = turned.mT
    between = between.transpose(2, 3).reshape(rows, 3 * _BONES, 3 * _BONES)
    return mass[:, 0], -so3.hat(lever).transpose(1, 2).reshape(rows, 3, -1), between
