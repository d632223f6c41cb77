"""Detects a turning camera declared fixed: all standing feet seem to turn about one axis.

In the frame of a camera that is carried around a person, or panned, the whole room turns the other
way. Feet that stand in the room then move as points of one rigid plate, all of them at one rate
about the vertical. People who turn do so step by step: one foot turns while the other stands, and
each by a rate of its own. On a treadmill all feet are carried too, but none turns.
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
_LAG = 0.13
"""Seconds over which velocities are taken."""
_MAX_HEIGHT_DIFFERENCE_M = 0.04
"""Metres by which a standing foot may be higher than the other: a ground that is estimated from
one image is not exact, so that heights above it do not show who stands."""
_UPWARD = 0.35
"""Metres per second up to which a foot may rise or sink while it stands."""
_SCALE = 0.1
"""Metres per second by which soles that stand differ from one plate in a fit to one camera."""
_ITERATIONS = 20
"""Iterations of reweighting."""
_MIN_MOMENTS = 20
"""Least number of samples of a standing foot."""
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
    """Horizontal positions and velocities of heels and toes while they stand; metres, seconds.

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


def _misfit_of_rigid_motion(
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
    """A finding if the only camera of a motion turned although it is declared fixed.

    Args:
        name: of the camera, for the message.
        motion: one clip, z up, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows; None means all.
        rests: whether some part of a foot rests in the image most of the time.
    """
    movement = Movement.of(motion, body)
    feet = None if observed is None else _seen_feet(observed.numpy(), motion.fps)
    places, velocities = standing_soles(movement, feet)
    if len(places) < 2 * _MIN_MOMENTS:
        return None
    still, _ = _misfit_of_rigid_motion(places, velocities, turning=False)
    turning, speed = _misfit_of_rigid_motion(places, velocities, turning=True)
    rate, gain = float(np.degrees(speed)), still - turning
    slowest, fastest = _RATES_DEG_S
    least = _SURE_SHARE if rests else _LEAST_SHARE
    if not slowest < abs(rate) < fastest or gain <= max(_LEAST_GAIN, least * max(still, 1e-9)):
        return None
    turned = abs(rate) * movement.frames / movement.fps
    return Finding(
        "camera moves",
        f"{name}: standing feet all turn about one vertical axis by {abs(rate):.0f} degrees per "
        f"second, {turned:.0f} degrees in this clip, as nobody's do on firm "
        "ground: the camera seems to have been carried or panned, though it is declared fixed. "
        "Places, headings and contacts of the fit are not to be trusted: film with a fixed "
        "camera, or give a pose for every frame (T_camera_world), or its track (--camera-track). "
        "Otherwise the person stands on something that turns",
        value=rate,
    )


def _seen_feet(observed: Bool[np.ndarray, "time 22"], fps: float) -> Bool[np.ndarray, "time 2"]:
    """Whether each foot is seen within a few frames; detectors lose points for single frames."""
    both = np.stack([observed[:, foot].all(-1) for foot in _FEET], -1)
    half = max(1, round(_LAG * fps / 2))
    around = np.pad(both, ((half, half), (0, 0)))
    return np.asarray(np.lib.stride_tricks.sliding_window_view(around, 2 * half + 1, 0).any(-1))
