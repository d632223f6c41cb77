"""Detects a camera that turned though declared fixed: all standing feet turn about one axis.

In the frame of a camera that is carried around a person, or panned, the whole room turns the other
way. Feet that stand in the room then move like points of one rigid body, all with the same angular
velocity about the vertical. People who turn do so step by step: one foot turns while the other
stands, each with a rate of its own. A treadmill carries all feet along, too, but turns none.
"""

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import Finding
from recon.diagnosis.movement import Movement

_FEET = tuple(
    [joint_index(f"{side}_{part}") for part in ("ankle", "foot")] for side in ("left", "right")
)
_LAG_S = 0.13
"""Time (s) between the two positions from which a velocity is computed."""
_MAX_HEIGHT_DIFFERENCE_M = 0.04
"""Metres by which a standing foot may be higher than the lower one. Heights above the ground are
not used, as a ground that is estimated from one image is not exact."""
_MAX_VERTICAL_M_S = 0.35
"""Vertical speed (m/s) below which a foot may count as standing."""
_LOSS_SCALE_M_S = 0.1
"""Scale of Cauchy's loss (m/s): deviation of standing soles from a rigid motion in a fit to one
camera."""
_ITERATIONS = 20
"""Number of iterations of reweighted least squares."""
_MIN_STANDING = 20
"""Least number of standing feet, counted over all frames; each has two sole points."""
_RATES_DEG_S = (9.0, 50.0)
"""Angular speeds (degrees per second) between which a camera is carried or panned; people who turn
on the spot are slower, those who climb faster."""
_MIN_GAIN = 0.07
"""Least decrease of the mean Cauchy loss per sample when the rigid motion may include a
rotation."""
_MIN_GAIN_SHARE = 0.1
"""Least decrease of the loss by a rotation, as a share of the loss without. Good fits to one
camera of validation people, at rates above the smallest, reach 0.09; of those to a camera that is
carried around the person at 20 degrees per second, four in five have more than 0.1."""
_MIN_GAIN_SHARE_AT_REST = 0.15
"""Least decrease of the loss by a rotation, if feet rest in the image as for a fixed camera."""


def standing_soles(
    movement: Movement, observed: Bool[np.ndarray, "time 2"] | None = None
) -> tuple[Float[np.ndarray, "samples 2"], Float[np.ndarray, "samples 2"]]:
    """Return horizontal positions (m) and velocities (m/s) of heels and toes while they stand.

    A foot stands where it is hardly higher than the other one and hardly rises or sinks; frames in
    which it is not `observed` are left out (None: all feet are observed).
    """
    half = max(1, round(_LAG_S * movement.fps / 2))
    if movement.frames <= 2 * half:
        return np.zeros((0, 2)), np.zeros((0, 2))
    now = slice(half, movement.frames - half)

    def velocity(path: np.ndarray) -> np.ndarray:
        return (path[2 * half :] - path[: -2 * half]) * movement.fps / (2 * half)

    heights = movement.sole_heights[now]
    rising = np.maximum(*(abs(velocity(p)[..., 2]) for p in (movement.ankles, movement.toes)))
    low = heights < heights.min(1, keepdims=True) + _MAX_HEIGHT_DIFFERENCE_M
    standing = low & (rising < _MAX_VERTICAL_M_S) & (True if observed is None else observed[now])
    places, velocities = movement.soles[now], velocity(movement.soles)
    return (
        places[standing][..., :2].reshape(-1, 2),
        velocities[standing][..., :2].reshape(-1, 2),
    )


def _misfit_of_rigid_motion(
    places: Float[np.ndarray, "samples 2"],
    velocities: Float[np.ndarray, "samples 2"],
    *,
    turning: bool,
) -> tuple[float, float]:
    """Fit one planar rigid motion to the soles' velocities; return mean Cauchy loss and turn rate.

    The rate is the angular velocity about the vertical, rad/s, counterclockwise seen from above;
    zero unless `turning`. Outlying samples have little weight.
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
        away = np.square((design @ motion - velocities) / _LOSS_SCALE_M_S).sum(-1)
        weight = 1 / (1 + away)
    return float(np.log1p(away).mean()), float(motion[2]) if turning else 0.0


def turned_camera_finding(
    name: str,
    motion: Motion,
    body: BodyModel,
    observed: Bool[Tensor, "time 22"] | None = None,
    *,
    rests: bool = False,
) -> Finding | None:
    """Return a warning if a clip's only camera turned although it is declared fixed, else None.

    Args:
        name: name of the camera, for the message.
        motion: fitted motion of one clip, z up, without a batch axis.
        body: body model of the motion.
        observed: joints that the data shows; None means all.
        rests: whether some part of a foot rests in the image most of the time.
    """
    movement = Movement.of(motion, body)
    feet = None if observed is None else _seen_feet(observed.numpy(), motion.fps)
    places, velocities = standing_soles(movement, feet)
    if len(places) < 2 * _MIN_STANDING:
        return None
    still, _ = _misfit_of_rigid_motion(places, velocities, turning=False)
    turning, speed = _misfit_of_rigid_motion(places, velocities, turning=True)
    rate, gain = float(np.degrees(speed)), still - turning
    slowest, fastest = _RATES_DEG_S
    least = _MIN_GAIN_SHARE_AT_REST if rests else _MIN_GAIN_SHARE
    if not slowest < abs(rate) < fastest or gain <= max(_MIN_GAIN, least * max(still, 1e-9)):
        return None
    turned = abs(rate) * movement.frames / movement.fps
    return Finding(
        "camera moves",
        f"{name}: standing feet all turn about one vertical axis by {abs(rate):.0f} degrees per "
        f"second, {turned:.0f} degrees in this clip, as nobody's do on firm ground: the camera "
        "seems to have been carried or panned, though it is declared fixed. Places, headings and "
        "contacts of the fit are not to be trusted: film with a fixed camera, or give a pose for "
        "every frame (T_camera_world), or its track (--camera-track). If the camera stood still, "
        "the person stands on something that turns",
        value=rate,
    )


def _seen_feet(observed: Bool[np.ndarray, "time 22"], fps: float) -> Bool[np.ndarray, "time 2"]:
    """Return whether ankle and toe of each foot are both seen within 65 ms of every frame."""
    both = np.stack([observed[:, foot].all(-1) for foot in _FEET], -1)
    half = max(1, round(_LAG_S * fps / 2))
    around = np.pad(both, ((half, half), (0, 0)))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, 0).any(-1))
