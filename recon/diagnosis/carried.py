"""Standing feet that are all carried along: by a treadmill, or in the view of a turning camera.

On a treadmill every standing foot moves at the belt's velocity while the body stays. In the frame
of a camera that is carried around a person, or panned, though it is declared fixed, the whole room
turns the other way. Feet that stand in the room then move as points of one rigid plate, all of
them at one rate about the vertical. People who turn do so step by step: one foot turns while the
other stands, and each by a rate of its own.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, arange, float64, nn

from observations.points import TrackedPoints
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import Finding
from recon.diagnosis.movement import Movement

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


_FEET = tuple(
    [joint_index(f"{side}_{part}") for part in ("ankle", "foot")] for side in ("left", "right")
)
_LAG = 0.13
"""Seconds over which velocities are taken."""
_MAX_HEIGHT_DIFFERENCE_M = 0.04
"""Metres by which a standing foot may be higher than the other: a ground that is estimated from
one image is not exact, and a height above it would not tell who stands."""
_UPWARD = 0.35
"""Metres per second up to which a foot may rise or sink while it stands."""
_SCALE = 0.1
"""Metres per second by which soles that stand differ from one plate in a fit to one camera."""
_ITERATIONS = 20
"""Iterations of reweighting."""
_MIN_MOMENTS = 20
"""Moments of a standing foot that are needed to tell a rate."""
_RATES_DEG_S = (9.0, 50.0)
"""Degrees per second at which cameras are carried around a person or panned with one; people who
turn on the spot or climb reach less and more."""
_LEAST_GAIN = 0.07
"""Robust misfit of the soles' velocities that must vanish when the plate may turn, per sample."""
_LEAST_SHARE = 0.1
"""Share of the robust misfit that must vanish when the plate may turn. Good fits to one camera of
validation people, at rates above the least, reach 0.09; those to a camera that is carried around
the person by 20 degrees per second have more in four clips of five."""
_SURE_SHARE = 0.15
"""Share that must vanish where feet rest in the image, as they do before a fixed camera."""


def standing_soles(
    movement: Movement, observed: Bool[np.ndarray, "time 2"] | None = None
) -> tuple[Float[np.ndarray, "samples 2"], Float[np.ndarray, "samples 2"]]:
    """Places and velocities of heels and tips of feet while they stand; horizontal, metres.

    Feet stand by their height alone, and count where they are `observed`, which may be all.
    """
    half = max(1, round(_LAG * movement.fps / 2))
    if movement.frames <= 2 * half:
        return np.zeros((0, 2)), np.zeros((0, 2))
    now = slice(half, movement.frames - half)

    def speed(path: np.ndarray) -> np.ndarray:
        return (path[2 * half :] - path[: -2 * half]) * movement.fps / (2 * half)

    heights = movement.sole_heights[now]
    rising = np.maximum(*(abs(speed(p)[..., 2]) for p in (movement.ankles, movement.toes)))
    low = heights < heights.min(1, keepdims=True) + _MAX_HEIGHT_DIFFERENCE_M
    standing = low & (rising < _UPWARD) & (True if observed is None else observed[now])
    places, velocities = movement.soles[now], speed(movement.soles)
    return (
        places[standing][..., :2].reshape(-1, 2),
        velocities[standing][..., :2].reshape(-1, 2),
    )


def _plate(
    places: Float[np.ndarray, "samples 2"],
    velocities: Float[np.ndarray, "samples 2"],
    *,
    turning: bool,
) -> tuple[float, float]:
    """Robust misfit per sample (Cauchy's loss) of the rigid plate that most samples move with.

    The second number is its rate about the vertical, radians per second, counterclockwise from
    above; zero for a plate that may not turn.
    """
    x, y = (places - places.mean(0)).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    columns = [(one, zero), (zero, one), *([(-y, x)] if turning else [])]
    design = np.stack([np.stack(column, -1) for column in columns], -1)
    weight, away = one, one
    motion = np.zeros(len(columns))
    for _ in range(_ITERATIONS):
        root = np.sqrt(weight)[:, None]
        motion = np.linalg.lstsq(
            (design * root[..., None]).reshape(-1, len(columns)),
            (velocities * root).reshape(-1),
            rcond=None,
        )[0]
        away = np.square((design @ motion - velocities) / _SCALE).sum(-1)
        weight = 1 / (1 + away)
    return float(np.log1p(away).mean()), float(motion[2]) if turning else 0.0


def carried_finding(
    name: str,
    motion: Motion,
    body: BodyModel,
    observed: Bool[Tensor, "time 22"] | None = None,
    *,
    rests: bool = False,
) -> Finding | None:
    """Whether the one camera that a motion was seen by turned, though it is declared fixed.

    Args:
        name: of the camera, for the message.
        motion: one clip, z up, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows; None means all.
        rests: whether some part of a foot rests in the image most of the time.
    """
    movement = Movement.of(motion, body)
    feet = None if observed is None else _seen_feet(observed.cpu().numpy(), motion.fps)
    places, velocities = standing_soles(movement, feet)
    if len(places) < 2 * _MIN_MOMENTS:
        return None
    still, _ = _plate(places, velocities, turning=False)
    turning, speed = _plate(places, velocities, turning=True)
    rate, gain = float(np.degrees(speed)), still - turning
    slowest, fastest = _RATES_DEG_S
    least = _SURE_SHARE if rests else _LEAST_SHARE
    if not slowest < abs(rate) < fastest or gain <= max(_LEAST_GAIN, least * max(still, 1e-9)):
        return None
    return Finding(
        "camera moves",
        f"{name}: standing feet all turn about one vertical axis by {abs(rate):.0f} degrees per "
        f"second, {abs(rate) * movement.seconds:.0f} degrees in this clip, as nobody's do on firm "
        "ground: the camera seems to have been carried or panned, though it is declared fixed. "
        "Places, headings and contacts of the fit are not to be trusted: film with a fixed "
        "camera, or give a pose for every frame (T_camera_world), or its track (--camera-track). "
        "Otherwise the person stands on something that turns",
        value=rate,
    )


def _seen_feet(observed: Bool[np.ndarray, "time 22"], fps: float) -> Bool[np.ndarray, "time 2"]:
    """Feet that were seen at about the time, as detectors lose single points for a frame."""
    both = np.stack([observed[:, foot].all(-1) for foot in _FEET], -1)
    half = max(1, round(_LAG * fps / 2))
    around = np.pad(both, ((half, half), (0, 0)))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, 0).any(-1))
