"""Treadmills: every standing foot is carried along at one velocity while the body stays."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, arange, float64, nn

from observations.points import TrackedPoints
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding
from recon.diagnosis.motions.movement import Movement

_SLOWEST = 0.4
"""Metres per second of a belt; feet that slip are slower."""
_SOLE_HEIGHT_M = 0.03
"""Metres above the ground up to which a sole is on it."""
_MAX_RELATIVE_DEVIATION = 0.2
"""Relative deviation from the belt's velocity up to which a foot is carried by it."""
_STEADY_LEAST = 0.2
"""Deviation from the velocity of slow belts up to which a foot is carried by them, m/s."""
_MIN_CARRIED_SHARE = 0.55
"""Share of the moments with a sole on the ground in which it must move with the belt."""
_STANDING = 0.3
"""Metres per second below which a foot stands in the room."""
_STANDING_SHARE = 0.15
"""Share of the moments with a sole on the ground in which it may stand in the room."""
_STAYS = 0.35
"""Mean speed of the pelvis over that of the belt, up to which the body stays where it is."""
_MIN_CONTACT_S = 0.15
"""Seconds for which each foot must touch the ground."""
_MIN_PELVIS_HEIGHT_LEGS = 0.7
"""Median height of the pelvis above the ground in lengths of leg; nobody walks or runs lower."""


def belt_velocity(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> Float[Tensor, " 2"] | None:
    """Horizontal velocity of the belt under a motion's feet, m/s, or None where there is none.

    Feet are taken as standing by their height alone, since on a belt none stands still. Both are
    carried at one velocity against the way the person faces, and the body stays in the room.

    Args:
        motion: one clip, z up, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows.
    """
    movement = Movement.of(motion, body, observed)
    if movement.frames < 3:
        return None
    height = float(np.median(movement.joints[:, 0, 2])) - movement.ground
    if height < _MIN_PELVIS_HEIGHT_LEGS * movement.leg:
        return None
    feet = np.stack((movement.ankles, movement.toes), -2)
    # the part of each foot that is on the ground: heel strike to flat foot to toe
    lower = (feet[..., 2] - movement.sole_drop).argmin(-1)
    steps = np.diff(feet[..., :2], axis=0) * movement.fps
    velocity = np.take_along_axis(steps, lower[:-1, :, None, None], axis=2)[:, :, 0]
    low = movement.sole_heights < movement.ground + _SOLE_HEIGHT_M
    standing = low[1:] & low[:-1] & (lower[1:] == lower[:-1])
    if (standing.sum(0) < max(3, _MIN_CONTACT_S * movement.fps)).any():
        return None
    belt = _commonest(velocity[standing])
    speed = float(np.linalg.norm(belt))
    if speed < _SLOWEST:
        return None
    carried = _near(velocity, belt)
    shares = [carried[standing[:, side], side].mean() for side in (0, 1)]
    still = (np.linalg.norm(velocity[standing], axis=-1) < _STANDING).mean()
    drift = (movement.joints[-1, 0, :2] - movement.joints[0, 0, :2]) / movement.seconds
    facing = movement.forward.mean(0) @ belt / speed
    stays = float(np.linalg.norm(drift)) < _STAYS * speed
    if min(shares) < _MIN_CARRIED_SHARE or still > _STANDING_SHARE or not stays or facing > 0:
        return None
    return torch.from_numpy(belt).to(motion.translation)


def treadmill_finding(belt: Float[Tensor, " 2"]) -> Finding:
    """What is said of a belt of this velocity, m/s."""
    speed = float(belt.norm())
    return Finding(
        "treadmill",
        f"standing feet are all carried along at {speed:.2f} m/s, as on a treadmill: they do not "
        "stand still in the room, so contacts with the ground are not told",
        value=speed,
    )


def _near(
    velocity: Float[np.ndarray, "*shape 2"], belt: Float[np.ndarray, " 2"]
) -> Bool[np.ndarray, "*shape"]:
    reach = max(_STEADY_LEAST, _MAX_RELATIVE_DEVIATION * float(np.linalg.norm(belt)))
    return np.linalg.norm(velocity - belt, axis=-1) < reach


def _commonest(velocity: Float[np.ndarray, "samples 2"]) -> Float[np.ndarray, " 2"]:
    """The velocity with most others near it, refined to their median."""
    some = velocity[:: max(1, len(velocity) // 400)]
    near = [int(_near(velocity, candidate).sum()) for candidate in some]
    best = some[int(np.argmax(near))]
    return np.median(velocity[_near(velocity, best)], axis=0)


def with_belt(points: TrackedPoints, belt: Float[Tensor, " 2"]) -> TrackedPoints:
    """Points seen in the room, in the frame that moves with the belt (m/s, horizontal)."""
    times = _times(points.positions.shape[-3], points.fps, points.start_time)
    path = _path(times, belt).to(points.positions)
    moved = points.positions - path[:, None]
    return points.replace(positions=moved.where(points.visible[..., None], 0.0))


def on_belt(motion: Motion, belt: Float[Tensor, " 2"]) -> Motion:
    """A motion in the room, in the frame that moves with the belt."""
    return motion.replace(translation=motion.translation - path_of_belt(motion, belt))


def in_room(motion: Motion, belt: Float[Tensor, " 2"]) -> Motion:
    """A motion in the frame that moves with the belt, in the room."""
    return motion.replace(translation=motion.translation + path_of_belt(motion, belt))


def path_of_belt(motion: Motion, belt: Float[Tensor, " 2"]) -> Float[Tensor, "time 3"]:
    """How far the belt has come at every frame of a motion, metres."""
    times = _times(motion.frames, motion.fps, motion.start_time)
    return _path(times, belt).to(motion.translation)


def _times(count: int, fps: float, start: float) -> Float[Tensor, " time"]:
    return start + arange(count, dtype=float64) / fps


def _path(times: Float[Tensor, " time"], belt: Float[Tensor, " 2"]) -> Float[Tensor, "time 3"]:
    return nn.functional.pad(times[:, None] * belt.double().cpu(), (0, 1))
