"""Derivatives of joints, poses and residuals by the coordinates of a motion of one clip.

Columns are the 69 coordinates of a frame (the translation, then the rotation step of every joint),
the coefficients of the shape, and coordinates of the ground. Joints and the points that bones
carry have derivatives in closed form (`recon.body.derivatives`); a residual of such a point
follows from the point's own by what a translation of the body does to it. All other residuals are
differentiated numerically, coordinate by coordinate.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.derivatives import CarriedPoints
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.residuals import Residuals
from recon.core.scene import Scene
from recon.method.laplace.grounds import GroundBelief, perturbed
from recon.method.laplace.hessian import FRAME
from recon.method.newton.hessian import is_pointwise
from recon.method.protocols import Decoded, Estimate, Sensor
from recon.method.stages import Matched

STEP = 1e-3
"""Metres, radians and standard deviations of shape over which derivatives are differences."""
_AXES = 3


@dataclass(frozen=True)
class Neighbourhood:
    """A motion of one clip, and what is asked about motions near it."""

    motion: Motion
    """A leading axis of length one."""
    scene: Scene
    body: BodyModel
    ground: GroundBelief | None

    @property
    def unknown(self) -> int:
        """Coordinates of the ground."""
        return 0 if self.ground is None else self.ground.coordinates

    @cached_property
    def here(self) -> Estimate:
        """The motion as it is, for correspondences, which hold for all motions near it."""
        return Estimate(Decoded(self.motion), self.body.pose(self.motion), self.scene)

    @cached_property
    def translated(self) -> Estimate:
        """Rows: the motion as it is, moved along each axis, and with each ground that is moved."""
        rows = 1 + _AXES + self.unknown
        motion = self.motion[torch.zeros(rows, dtype=torch.long)]
        place = motion.translation.clone()
        for axis in range(_AXES):
            place[1 + axis, :, axis] += STEP
        return self._estimate(motion.replace(translation=place))

    @cached_property
    def everywhere(self) -> Estimate:
        """Rows: the motion as it is, and after a step of each column's coordinate."""
        shapes, frames = self.motion.shape.shape[-1], self.motion.frames
        rows = 1 + FRAME + shapes + self.unknown
        motion = self.motion[torch.zeros(rows, dtype=torch.long)]
        place, shape = motion.translation.clone(), motion.shape.clone()
        steps = place.new_zeros(rows, frames, FRAME // 3 - 1, 3)
        for k in range(_AXES):
            place[1 + k, :, k] += STEP
        for k in range(FRAME - _AXES):
            steps[1 + _AXES + k, :, k // 3, k % 3] = STEP
        for k in range(shapes):
            shape[1 + FRAME + k, k] += STEP
        turned = motion.rotations @ so3.exp(steps)
        return self._estimate(motion.replace(translation=place, rotations=turned, shape=shape))

    def _estimate(self, motion: Motion) -> Estimate:
        """Motions of some rows; the last ones are of grounds that are moved."""
        rows = len(motion.translation)
        if self.ground is None:
            scenes = self.scene[torch.zeros(rows, dtype=torch.long)]
        else:
            scenes = perturbed(self.scene, rows, self.ground, STEP)
        return Estimate(Decoded(motion), self.body.pose(motion), scenes)

    @cached_property
    def joints(self) -> Float[Tensor, "time 66 columns"]:
        """Derivatives of the joints in the world, metres."""
        carried = CarriedPoints.joints(self.body, self.motion.shape[0])
        moved = self._by_motion(carried)
        none = moved.new_zeros(*moved.shape[:-1], self.unknown)
        return torch.cat((moved, none), -1).flatten(1, 2)

    def _by_motion(self, points: CarriedPoints) -> Float[Tensor, "time points 3 motion"]:
        """Derivatives of points by the coordinates of frames and shape."""
        posed = self.translated.body
        orientations, joints = posed.orientations[0], posed.joints[0]
        turned = points.by_rotations(orientations, joints)
        identity = torch.eye(3, dtype=turned.dtype, device=turned.device)
        moved = identity.expand(*turned.shape[:2], 3, 3)
        rotations = self.motion.rotations[0]
        return torch.cat((moved, turned, points.by_shape(rotations, orientations, self.body)), -1)

    def seen(self) -> Float[Tensor, "time 66 columns"]:
        """Derivatives of the joints in the frame of the recording, metres."""
        scenes, world = self.translated.scene, self.translated.body.joints
        if scenes.ground is None:
            return self.joints
        turn = scenes.ground.T_world_recording[0, :3, :3].mT
        turned = turn @ self.joints.unflatten(1, (-1, 3))
        if self.unknown > 0:
            moved = differences(scenes.to_recording(world))[..., -self.unknown :]
            turned = torch.cat((turned[..., : -self.unknown], moved), -1)
        return turned.flatten(1, 2)

    def residuals(
        self, one: Sensor, frame: Int[Tensor, " moments"]
    ) -> tuple[Residuals, Float[Tensor, "moments points dims columns"]]:
        """What a sensor misses, one clip, and its derivatives.

        Args:
            one: the sensor.
            frame: of the motion, for every moment of the sensor.
        """
        carries = is_pointwise(one)
        held = cast(Sensor, one.matched(self.here)) if isinstance(one, Matched) else one
        found = _of(held, self.translated if carries else self.everywhere)
        slopes = differences(found.values)
        if carries:
            points = one.carried(self.body, self.motion.shape[0], self.scene.offsets[0])
            moved = slopes[..., :_AXES] @ self._by_motion(points)[frame]
            slopes = torch.cat((moved, slopes[..., _AXES:]), -1)
        return found[0], slopes


def _of(one: Sensor, estimates: Estimate) -> Residuals:
    rows = torch.zeros(len(estimates.motion.translation), dtype=torch.long)
    return one[rows].residuals(estimates)


def differences(
    values: Float[Tensor, "rows time points dims"],
) -> Float[Tensor, "time points dims columns"]:
    """Differences of rows from the first, per unit of the step."""
    return ((values[1:] - values[:1]) / STEP).movedim(0, -1)
