"""Jacobians of joints, poses and residuals by the coordinates of a clip's motion.

Columns are the 69 coordinates of a frame (the translation, then the rotation step of every joint),
the coefficients of the shape, and coordinates of the ground. Joints and the points that bones
carry have derivatives in closed form (`recon.body.derivatives`); a residual of such a point
follows from the point's own by what a translation of the body does to it. All other residuals are
differentiated numerically, coordinate by coordinate.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.body.derivatives import BonePoints
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.residuals import Residuals
from recon.core.scene import TILT, Scene, UnknownGround
from recon.core.skeleton import FEET, joint_index
from recon.method.newton import is_pointwise
from recon.method.protocols import Decoded, Estimate
from recon.method.quadratic import FRAME
from recon.method.sensor import Sensor
from recon.solver.banded import Banded

_HEAD = joint_index("head")
_ANKLES = [joint_index("left_ankle"), joint_index("right_ankle")]


@dataclass(frozen=True)
class GroundBelief:
    """The assumed uncertainty of a ground that was found from feet and posture."""

    stance: float
    """Standard deviation of the mean height of a clip's standing feet above the ground, metres."""
    upright: float
    """Standard deviation of a clip's mean direction from feet to head about each horizontal axis,
    radians."""
    coordinates: Literal[0, 1, 3]
    """How many of the ground's coordinates are unknown: none, its lift, or with it two turns."""
    shown: float = 0.0
    """Inverse variance of a plane that is given or seen, 1 / metres² and 1 / radians²."""


@dataclass(frozen=True)
class GroundDeviation:
    """Standard deviations of the height and normal of a ground that a fit found."""

    normal: float
    """Standard deviation of its normal about a horizontal axis, radians; 0 where it is known."""
    height: float
    """Standard deviation of its height below the origin of the recording's frame, metres."""

    @property
    def normal_degrees(self) -> float:
        """The standard deviation of the normal in degrees."""
        return math.degrees(self.normal)


def perturbed_scenes(scene: Scene, copies: int, belief: GroundBelief, step: float) -> Scene:
    """Copy a scene; move one coordinate of the ground by `step` in each of the last copies."""
    scenes = scene[torch.zeros(copies, dtype=torch.long)]
    if belief.coordinates == 0:
        return scenes
    assert scenes.ground is not None, "the ground is known: ask for no deviation of it"
    tilt, lift = scenes.ground.tilt.clone(), scenes.ground.lift.clone()
    first = copies - belief.coordinates
    lift[first] += step
    for axis in range(belief.coordinates - 1):
        tilt[first + 1 + axis, axis] += step / TILT
    return scenes.replace(ground=UnknownGround(tilt, lift, scenes.ground.pivot))


def add_stance_information(
    hessian: Banded,
    estimate: Estimate,
    joints: Float[Tensor, "time 66 coordinates"],
    belief: GroundBelief,
) -> bool:
    """Add the information of standing feet and upright posture; return whether any foot stands.

    All frames of a clip together count as one measurement, with the standard deviation between
    clips, as a person who leans or has thick shoes does so in all frames.

    Args:
        hessian: the Hessian that is added to.
        estimate: the fit.
        joints: derivatives of the fitted joints in the world.
        belief: the assumed uncertainty of the ground.
    """
    motion, feet = estimate.motion, list(FEET)
    places = estimate.body.joints[0]
    heights = rest_heights(estimate.body.model, motion.shape[0])
    standing = contact_labels(places, heights, motion.fps)[:, feet]
    if not bool(standing.any()):
        return False
    rows = joints.unflatten(1, (22, 3))
    share = standing / standing.sum() / belief.stance**2
    whitened = rows[:, feet, 2] * share.sqrt()[..., None]
    if belief.coordinates == 3:
        rise = places[:, _HEAD] - places[:, _ANKLES].mean(1)
        lean = (rows[:, _HEAD] - rows[:, _ANKLES].mean(1))[:, :2]
        tall = rise.norm(dim=-1).clamp(min=0.1)[:, None, None]
        leaning = lean / tall / (len(places) ** 0.5 * belief.upright)
        whitened = torch.cat((whitened, leaning), 1)
    hessian.add_frames(torch.arange(len(places)), whitened.mT @ whitened)
    if belief.coordinates > 0:
        corner = hessian.corner.diagonal()[-belief.coordinates :]
        corner += belief.shown
    return True


def ground_std(
    covariance: Float[Tensor, "m m"], scenes: Scene, belief: GroundBelief, step: float
) -> GroundDeviation:
    """Return standard deviations of the ground's height and normal from a covariance matrix."""
    count = belief.coordinates
    own = covariance[-count:, -count:]
    assert scenes.ground is not None
    above = scenes.ground.T_world_recording[:, 2, 3]
    slope = (above[-count:] - above[0]) / step
    height = float((slope @ own @ slope).sqrt())
    return GroundDeviation(float(own.diagonal()[1:].mean().sqrt()) if count > 1 else 0.0, height)


STEP = 1e-3
"""Metres, radians and standard deviations of shape over which derivatives are differences."""
_AXES = 3


@dataclass(frozen=True)
class Neighbourhood:
    """A motion of one clip, with Jacobians of joints and residuals linearised about it."""

    motion: Motion
    """A leading axis of length one."""
    scene: Scene
    body: BodyModel
    ground: GroundBelief | None

    @property
    def ground_coordinates(self) -> int:
        """Number of coordinates of an unknown ground; 0 where it is known."""
        return 0 if self.ground is None else self.ground.coordinates

    @cached_property
    def unperturbed(self) -> Estimate:
        """The estimate at the motion itself; correspondences are found here and then held."""
        return Estimate(Decoded(self.motion), self.body.pose(self.motion), self.scene)

    @cached_property
    def translated(self) -> Estimate:
        """Copies of the estimate: itself, moved along x, y, z, and by each ground coordinate."""
        rows = 1 + _AXES + self.ground_coordinates
        motion = self.motion[torch.zeros(rows, dtype=torch.long)]
        place = motion.translation.clone()
        for axis in range(_AXES):
            place[1 + axis, :, axis] += STEP
        return self._as_estimate(motion.replace(translation=place))

    @cached_property
    def perturbed_columns(self) -> Estimate:
        """Estimates: the motion, and the motion after a small step of each Jacobian column."""
        shapes, frames = self.motion.shape.shape[-1], self.motion.frames
        rows = 1 + FRAME + shapes + self.ground_coordinates
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
        return self._as_estimate(motion.replace(translation=place, rotations=turned, shape=shape))

    def _as_estimate(self, motion: Motion) -> Estimate:
        """Pose motions as estimates, moving one ground coordinate in each of the last rows."""
        rows = len(motion.translation)
        if self.ground is None:
            scenes = self.scene[torch.zeros(rows, dtype=torch.long)]
        else:
            scenes = perturbed_scenes(self.scene, rows, self.ground, STEP)
        return Estimate(Decoded(motion), self.body.pose(motion), scenes)

    @cached_property
    def jacobian(self) -> Float[Tensor, "time 66 columns"]:
        """Jacobian of the joints in the world, metres."""
        carried = BonePoints.of_joints(self.body, self.motion.shape[0])
        moved = self._jacobian_by_motion(carried)
        none = moved.new_zeros(*moved.shape[:-1], self.ground_coordinates)
        return torch.cat((moved, none), -1).flatten(1, 2)

    def _jacobian_by_motion(self, points: BonePoints) -> Float[Tensor, "time points 3 motion"]:
        """Return the Jacobian of points by the 69 coordinates of a frame and the shape."""
        posed = self.translated.body
        orientations, joints = posed.orientations[0], posed.joints[0]
        turned = points.jacobian_by_rotations(orientations, joints)
        identity = torch.eye(3, dtype=turned.dtype, device=turned.device)
        moved = identity.expand(*turned.shape[:2], 3, 3)
        return torch.cat((moved, turned, points.jacobian_by_shape(orientations, self.body)), -1)

    def jacobian_in_recording(self) -> Float[Tensor, "time 66 columns"]:
        """Return the Jacobian of the joints in the recording's frame, metres, all columns."""
        scenes, world = self.translated.scene, self.translated.body.joints
        if scenes.ground is None:
            return self.jacobian
        turn = scenes.ground.T_world_recording[0, :3, :3].mT
        turned = turn @ self.jacobian.unflatten(1, (-1, 3))
        if self.ground_coordinates > 0:
            moved = differences(scenes.to_recording(world))[..., -self.ground_coordinates :]
            turned = torch.cat((turned[..., : -self.ground_coordinates], moved), -1)
        return turned.flatten(1, 2)

    def residuals(
        self, sensor: Sensor, frame: Int[Tensor, " moments"]
    ) -> tuple[Residuals, Float[Tensor, "moments points dims columns"]]:
        """Return a sensor's residuals and their Jacobian by motion, shape and ground.

        Args:
            sensor: the sensor.
            frame: number of the motion's frame for every frame of the sensor.
        """
        pointwise, points_of = is_pointwise(sensor), getattr(sensor, "points_on_bones", None)
        held: Any = getattr(sensor, "matched", lambda _: sensor)(self.unperturbed)
        estimates = self.translated if pointwise else self.perturbed_columns
        rows = torch.zeros(len(estimates.motion.translation), dtype=torch.long)
        found = held[rows].residuals(estimates)
        slopes = differences(found.values)
        if pointwise and points_of is not None:
            points = points_of(self.body, self.motion.shape[0], self.scene.offsets[0])
            moved = slopes[..., :_AXES] @ self._jacobian_by_motion(points)[frame]
            slopes = torch.cat((moved, slopes[..., _AXES:]), -1)
        return found[0], slopes


def differences(
    values: Float[Tensor, "rows time points dims"],
) -> Float[Tensor, "time points dims columns"]:
    """Return (f(x + h e_k) - f(x)) / h for every k, from rows f(x), f(x + h e_0), ..."""
    return ((values[1:] - values[:1]) / STEP).movedim(0, -1)
