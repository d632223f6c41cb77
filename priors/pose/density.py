"""The density of poses: a Gaussian over the 21 body rotations, about their mean."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.derivatives import inverse_right_jacobian
from recon.core import rotations as so3
from recon.core.struct import TensorStruct

ROTATIONS = 21
"""Body joints: all but the root."""

COORDINATES = 3 * ROTATIONS


@dataclass(frozen=True)
class PoseDensity(TensorStruct):
    """Poses as R_j = M_j Exp(v_j) with v = B z and z ~ N(0, I).

    Tangent vectors about the mean rotation of every joint stay far from half a turn, unlike those
    about the rest pose. The whole covariance B Bᵀ is kept, so joints that move together hold each
    other in place where the data sees only some of them. Every pose has coordinates, and exact
    ones: nothing is lost in a code narrower than the data.
    """

    mean: Float[Tensor, "21 3 3"]
    """M: the Fréchet mean of each joint's rotation."""
    basis: Float[Tensor, "63 63"]
    """B: eigenvectors of the covariance, each as long as its standard deviation in radians."""
    stiffness: Float[Tensor, "66 66"]
    """Σ (∂p/∂x)ᵀ (∂p/∂x) over the 22 joints p of the mean pose, metres², where x is the turn of
    the root (radians) and z. Scales the variables of a fit; no energy depends on it."""

    def coordinates(self, rotations: Float[Tensor, "*shape 21 3 3"]) -> Float[Tensor, "*shape 63"]:
        """The coordinates z of a pose: |z|² is its squared Mahalanobis distance from the mean."""
        steps = so3.log(self.mean.mT @ rotations).flatten(-2)
        return steps @ torch.linalg.inv(self.basis).mT

    def rotations(self, coordinates: Float[Tensor, "*shape 63"]) -> Float[Tensor, "*shape 21 3 3"]:
        """The pose at z; the inverse of `coordinates`."""
        steps = (coordinates @ self.basis.mT).unflatten(-1, (ROTATIONS, 3))
        return self.mean @ so3.exp(steps)

    def by_rotations(
        self, rotations: Float[Tensor, "*shape 21 3 3"]
    ) -> Float[Tensor, "*shape 63 63"]:
        """Derivatives of the coordinates by steps R_j Exp(w_j) of the joints, per radian."""
        steps = so3.log(self.mean.mT @ rotations)
        slopes = inverse_right_jacobian(steps)
        inverse = torch.linalg.inv(self.basis).unflatten(-1, (ROTATIONS, 3))
        return torch.einsum("zja,...jab->...zjb", inverse, slopes).flatten(-2)
