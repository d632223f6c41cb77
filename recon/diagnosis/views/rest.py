"""Feet that never rest in the image of a camera that is declared fixed: the camera moves.

Whoever stands, walks or dances has some part of a foot at rest on the ground most of the time. In
the image of a fixed camera its keypoints then stay where they are. In that of a phone in the hand,
one that is panned with a walker, or one that is carried along, nothing ever stays. Who runs or
jumps has no foot at rest most of the time either, but flies then, and rests in between for a
moment.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from recon.core.robust import NORMAL_MAD
from recon.diagnosis.findings import Finding
from recon.diagnosis.views.images import Images

_CONTACTS = tuple(
    tuple(f"{side}_{name}" for name in names)
    for side in ("left", "right")
    for names in (("heel", "ankle"), ("big_toe", "small_toe"))
)
"""Keypoints of the parts of feet that rest on the ground."""
_LAG = 0.2
"""Seconds over which velocities are taken."""
_MIN_RESTING_SHARE = 0.3
"""Share of the moments in which some part of a foot rests, of a fixed camera."""
_MIN_SEEN_S = 0.8
"""Time in which feet must be seen to tell anything."""
_MOVES = 0.035
"""Metres per second, at the person, from which on what rests most moves in the image. In simulated
films of validation people by fixed cameras it reaches 0.018, in real ones 0.025."""
_FLIES, _SELDOM = 0.5, 0.05
"""Metres per second by which what rests most moves in so small a share of the moments, from which
on the person may run or jump. Training people who walk before a phone in the hand stay below,
those who run before a fixed camera above, in 19 clips of 20."""
_BRIEF, _SOMETIMES = 0.13, 0.2
"""Seconds for which a foot of somebody who runs or jumps rests, and the share of the moments."""
_NEVER_RESTS, _EVEN = 0.05, 0.12
"""Speed, metres per second and as a share of that of the flights, from which on not even then
does a foot rest. Training people who run before fixed cameras reach a share of 0.10."""
_HINT = 0.01
"""Metres per second below which feet rest as before a fixed camera, in 19 of 20 simulated films of
validation people."""
_FAST = 0.3
"""Metres per second from which on the camera is panned or carried along rather than shaken."""


@dataclass(frozen=True)
class Rest:
    """How fast the part of the feet that rests most moves in the image."""

    speed: float
    """Metres per second at the person, without what the noise of the keypoints makes of it."""
    noise: float
    """Speed that the noise makes of a keypoint at rest, metres per second."""
    flying: float
    """Speed of what rests most in the few moments in which it is fastest, metres per second."""
    brief: float
    """Speed over a short time, of the fifth of the moments in which it is slowest, without what
    the noise makes of it; metres per second."""

    @property
    def moves(self) -> bool:
        """Whether the camera surely moves."""
        never = self.brief > max(_NEVER_RESTS, _EVEN * self.flying)
        return self.speed > _MOVES and (self.flying < _FLIES or never)

    @property
    def may_move(self) -> bool:
        """Whether the camera may be carried smoothly around a person whose feet nearly rest."""
        return self.speed > _HINT


def rest_of(images: Images) -> Rest | None:
    """What the feet tell about the one view of some images; None where they are hardly seen."""
    usual, brief = _Slowest.of(images, _LAG), _Slowest.of(images, _BRIEF)
    if usual is None or brief is None:
        return None
    return Rest(
        speed=usual.quantile(_MIN_RESTING_SHARE),
        noise=usual.noise,
        flying=float(np.quantile(usual.speeds, 1 - _SELDOM)),
        brief=brief.quantile(_SOMETIMES),
    )


@dataclass(frozen=True)
class _Slowest:
    """Speed of the part of the feet that rests most, at every moment where one was seen."""

    speeds: Float[np.ndarray, " moments"]
    """Metres per second at the person."""
    noise: float

    @classmethod
    def of(cls, images: Images, lag: float) -> "_Slowest | None":
        """Speeds over a time lag, seconds; None where feet are hardly seen."""
        half = max(1, round(lag * images.fps / 2))
        pixels, seen = images.pixels[0], images.seen[0]
        if len(pixels) <= 2 * half:
            return None
        lag = 2 * half / images.fps
        speeds, jitters = [], []
        for names in _CONTACTS:
            columns = [images.points.index(name) for name in names if name in images.points]
            if not columns:
                continue
            place, there = pixels[:, columns].mean(1), seen[:, columns].all(1)
            moved = np.linalg.norm(place[2 * half :] - place[: -2 * half], axis=-1)
            both = there[2 * half :] & there[: -2 * half]
            speeds.append(np.where(both, moved / lag / images.scale[0, half:-half], np.inf))
            jitters.append(_jitter(place, there)[half - 1 : len(place) - half - 1])
        if not speeds:
            return None
        every = np.stack(speeds)
        slowest, which = every.min(0), every.argmin(0)
        told = np.isfinite(slowest)
        if told.sum() < _MIN_SEEN_S * images.fps:
            return None
        jitter = np.stack(jitters)[which, np.arange(len(which))][told]
        spread = float(np.nanmedian(jitter)) / NORMAL_MAD / np.sqrt(6)
        noise = spread * np.sqrt(2) / lag / float(np.median(images.scale[0]))
        return cls(slowest[told], float(noise))

    def quantile(self, share: float) -> float:
        """Speed below which a share of the moments lie, without what the noise makes of it."""
        speed = float(np.quantile(self.speeds, share))
        return float(np.sqrt(max(speed**2 - self.noise**2, 0.0)))


def moving_finding(name: str, images: Images, rest: Rest) -> Finding:
    """What is said of the one camera of a clip that moves, though it is declared fixed.

    Args:
        name: of the camera, for the message.
        images: of the one view.
        rest: what its feet tell.
    """
    pixels = rest.speed * float(np.median(images.scale[0]))
    how = (
        "as where the camera is panned with a person or carried along, or the person is on a "
        "treadmill"
        if rest.speed > _FAST
        else "as where the camera is held in the hand, or slowly panned"
    )
    return Finding(
        "camera moves",
        f"{name}: no part of any foot rests in the image: what moves least moves by "
        f"{pixels:.0f} pixels per second ({100 * rest.speed:.0f} cm/s at the person), {how}. The "
        "camera was declared fixed; places, headings and contacts of the fit are not to be "
        "trusted. Film with a fixed camera, or give the camera's track (--camera-track, in Python "
        "camera_track) as a tracker wrote it. Otherwise the feet bear nobody: the person runs, "
        "skates, swims or sits",
        value=rest.speed,
    )


def _jitter(
    place: Float[np.ndarray, "time 2"], there: Bool[np.ndarray, " time"]
) -> Float[np.ndarray, " inner"]:
    """Mean size of the second difference of both coordinates; NaN where it is not known."""
    size = np.abs(place[2:] - 2 * place[1:-1] + place[:-2]).mean(-1)
    return np.where(there[2:] & there[1:-1] & there[:-2], size, np.nan)
