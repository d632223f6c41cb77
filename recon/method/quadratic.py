"""Quadratic models of energies, by which priors and sensors support Gauss-Newton stages.

Every frame has 69 steps: of the translation in metres, of the root's rotation R Exp(w) in
radians, and 63 numbers for the other joints, which the prior chooses.
"""

from dataclasses import dataclass, field
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.derivatives import BonePoints, joint_jacobian_by_shape
from recon.body.model import BodyModel, forward_kinematics
from recon.core.motion import Motion
from recon.method.protocols import Estimate
from recon.solver.banded import Banded

FRAME = 69
"""Steps of one frame."""


@dataclass(frozen=True)
class PointModel:
    """An energy near given places of points: E + Σ (gᵀ dp + ½ dpᵀ A dp) for small shifts dp.

    An energy of points fixed to bones has `point_model(places)`, which returns this approximation,
    scaled to 30 Hz, near places in the recording's frame (metres); the method `points_on_bones`,
    which puts its points on a body; and a sensor's clock: `fps`, `start_time`, `moments`.
    """

    value: Float[Tensor, "*batch"]
    """E, unit of the sensor squared."""
    gradient: Float[Tensor, "*batch moments points 3"]
    """g; that unit squared per metre."""
    curvature: Float[Tensor, "*batch moments points 3 3"]
    """A, positive semidefinite: second derivatives of the kernel and the camera are left out."""
    isotropic: bool = False
    """Whether every A is a multiple of the identity."""


@dataclass(frozen=True)
class ClipModel:
    """One clip of an estimate, with derivatives by steps, to which terms add their Hessian."""

    estimate: Estimate
    """The estimate of all clips."""
    clip: int
    """Number of the clip."""
    turn: Float[Tensor, "time 63 63"]
    """See `recon.method.priors.Prior.turns`."""
    reach: int
    with_shape: bool
    """Whether the shape is moved as well."""
    part: Banded = field(init=False)
    """The Hessian without that of joints."""
    joints: Float[Tensor, "time 3 66"] = field(init=False)
    """Coefficients of products of joints' coordinates; see `Banded.add_products`."""

    def __post_init__(self) -> None:
        """Set the Hessian to zero."""
        motion, like = self.motion, self.motion.translation
        size = motion.shape.shape[-1] if self.with_shape else 0
        part = Banded.zero(motion.frames, self.reach, FRAME, size, like)
        object.__setattr__(self, "part", part)
        object.__setattr__(self, "joints", like.new_zeros(motion.frames, 3, 66))

    @cached_property
    def motion(self) -> Motion:
        """The clip's motion."""
        return self.estimate.motion[self.clip].detach()

    @property
    def body(self) -> BodyModel:
        """The body model of the motion."""
        return self.estimate.body.model

    def hessian(self) -> Banded:
        """Return the sum of all added parts of the Hessian; to be called once."""
        moved, shaped = self.jacobians_by_steps(BonePoints.of_joints(self.body, self.motion.shape))
        self.part.add_products(self.joints, moved.flatten(1, 2), shaped.flatten(1, 2))
        return self.part

    def jacobians_by_steps(
        self, points: BonePoints
    ) -> tuple[Float[Tensor, "time points 3 69"], Float[Tensor, "time points 3 shape"]]:
        """Return derivatives of points (metres) by the steps of their frame, and by the shape."""
        orientations, joints = self.posed
        turned = points.jacobian_by_rotations(orientations, joints)
        by_steps = jacobian_by_steps(turned, self.turn)
        if not self.with_shape:
            return by_steps, by_steps[..., :0]
        return by_steps, points.jacobian_by_shape_of(orientations, self._joints_by_shape)

    @cached_property
    def posed(self) -> tuple[Float[Tensor, "time 22 3 3"], Float[Tensor, "time 22 3"]]:
        """Orientations of the bones and positions of the joints, in the world, metres."""
        motion = self.motion
        orientations, joints = forward_kinematics(
            motion.rotations, self.body.rest_joints(motion.shape)
        )
        return orientations, joints + motion.translation[:, None]

    @cached_property
    def _joints_by_shape(self) -> Float[Tensor, "time 22 3 shape"]:
        return joint_jacobian_by_shape(self.posed[0], self.body, self.motion.shape.shape[-1])


def jacobian_by_steps(
    by_rotations: Float[Tensor, "time points 3 66"], turns: Float[Tensor, "time 63 63"]
) -> Float[Tensor, "time points 3 69"]:
    """Return derivatives of points by the 69 steps of their frame.

    Args:
        by_rotations: derivatives by the rotation steps of all joints, metres per radian.
        turns: derivatives of these rotation steps, but the root's, by the last 63 steps.
    """
    identity = torch.eye(3, dtype=by_rotations.dtype, device=by_rotations.device)
    moved = identity.expand(*by_rotations.shape[:2], 3, 3)
    posed = (by_rotations[..., 3:].flatten(1, 2) @ turns).unflatten(1, (-1, 3))
    return torch.cat((moved, by_rotations[..., :3], posed), -1)
