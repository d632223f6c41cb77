"""What is believed of a ground that the data do not show: feet stand on it, and people upright.

Sensors see neither the ground nor which way is down where a recording knows neither. The fit puts
the ground below the feet that stand; how far it may be off follows from how well the feet are
known, and from how far standing feet miss a ground and people lean, clip by clip.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.contacts import contact_labels, rest_heights
from recon.core.scene import TILT, Scene, UnknownGround
from recon.core.skeleton import FEET, joint_index
from recon.method.laplace.hessian import Accumulated
from recon.method.protocols import Estimate

_HEAD = joint_index("head")
_ANKLES = [joint_index("left_ankle"), joint_index("right_ankle")]


@dataclass(frozen=True)
class GroundBelief:
    """How far the grounds of clips are from where people's feet and posture put them."""

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
    """Standard deviations of a ground that was found."""

    normal: float
    """Standard deviation of its normal about a horizontal axis, radians; 0 where it is known."""
    height: float
    """Standard deviation of its height below the origin of the recording's frame, metres."""

    @property
    def normal_degrees(self) -> float:
        """The standard deviation of the normal in degrees."""
        return math.degrees(self.normal)


def perturbed(scene: Scene, rows: int, belief: GroundBelief, step: float) -> Scene:
    """Scenes of so many rows; in the last ones a coordinate of the ground each is moved."""
    scenes = scene[torch.zeros(rows, dtype=torch.long)]
    if belief.coordinates == 0:
        return scenes
    assert scenes.ground is not None, "the ground is known: ask for no deviation of it"
    tilt, lift = scenes.ground.tilt.clone(), scenes.ground.lift.clone()
    first = rows - belief.coordinates
    lift[first] += step
    for axis in range(belief.coordinates - 1):
        tilt[first + 1 + axis, axis] += step / TILT
    return scenes.replace(ground=UnknownGround(tilt, lift, scenes.ground.pivot))


def add_stance(
    hessian: Accumulated,
    estimate: Estimate,
    joints: Float[Tensor, "time 66 coordinates"],
    belief: GroundBelief,
) -> bool:
    """Add what standing feet and upright postures tell; whether any foot stands at all.

    All moments of a clip together tell as much as one whose standard deviation is that of clips:
    a person who leans or whose shoes are thick does so all the time.

    Args:
        hessian: that is added to.
        estimate: the fit.
        joints: derivatives of its joints in the world.
        belief: how far grounds are from where they are told to be.
    """
    motion, feet = estimate.motion, list(FEET)
    places = estimate.body.joints[0]
    heights = rest_heights(estimate.body.model, motion.shape[0])
    standing = contact_labels(places, heights, motion.fps)[:, feet]
    if not bool(standing.any()):
        return False
    rows = joints.unflatten(1, (22, 3))
    share = standing / standing.sum() / belief.stance**2
    hessian.add_frames(rows[:, feet, 2] * share.sqrt()[..., None])
    if belief.coordinates == 3:
        rise = places[:, _HEAD] - places[:, _ANKLES].mean(1)
        lean = (rows[:, _HEAD] - rows[:, _ANKLES].mean(1))[:, :2]
        tall = rise.norm(dim=-1).clamp(min=0.1)[:, None, None]
        hessian.add_frames(lean / tall / (len(places) ** 0.5 * belief.upright))
    if belief.coordinates > 0:
        corner = hessian.shape.diagonal()[-belief.coordinates :]
        corner += belief.shown
    return True


def deviation(
    covariance: Float[Tensor, "m m"], scenes: Scene, belief: GroundBelief, step: float
) -> GroundDeviation:
    """The ground's part of the border's covariance in metres and radians."""
    count = belief.coordinates
    own = covariance[-count:, -count:]
    assert scenes.ground is not None
    above = scenes.ground.T_world_recording[:, 2, 3]
    slope = (above[-count:] - above[0]) / step
    height = float((slope @ own @ slope).sqrt())
    return GroundDeviation(float(own.diagonal()[1:].mean().sqrt()) if count > 1 else 0.0, height)
