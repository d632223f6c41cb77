"""What laws of movement are judged on: the centre of mass and the feet of a body over time."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import stretches
from recon.physics.mass import GRAVITY, centre_of_mass, vertex_masses_of_segments

_HIPS = (joint_index("left_hip"), joint_index("right_hip"))
_KNEES = (joint_index("left_knee"), joint_index("right_knee"))
_ANKLES = (joint_index("left_ankle"), joint_index("right_ankle"))
_TOES = (joint_index("left_foot"), joint_index("right_foot"))
_ASKED = (joint_index("pelvis"), *_HIPS, *_KNEES, *_ANKLES)
_SELDOM = 0.1
"""Share of the frames in which the lower sole may be below the ground."""
_HEEL, _TIP = 0.4, 0.5
"""How far the sole reaches behind the ankle and beyond the toe joint, in lengths of the line
between the two."""


@dataclass(frozen=True)
class Movement:
    """One stretch of a motion in which the pelvis and both legs were seen; metres, z up."""

    joints: Float[np.ndarray, "time 22 3"]
    centre: Float[np.ndarray, "time 3"]
    """Centre of mass."""
    leg: float
    """Length of a leg from the hip joint over the knee to the ankle."""
    sole_drop: Float[np.ndarray, " 2"]
    """Height of the ankle and of the toe joint above the sole of a standing foot."""
    fps: float

    @classmethod
    def of(
        cls, motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
    ) -> "Movement":
        """The longest stretch of one clip in which the pelvis and both legs were observed.

        Args:
            motion: one clip, z up, without a batch axis.
            body: whose motion it is.
            observed: joints that the data shows; None means all.
        """
        seen = motion.valid.cpu()
        if observed is not None:
            seen = seen & observed[:, list(_ASKED)].cpu().all(-1)
        first, last = _longest(seen.numpy())
        posed = body.pose(motion.window(first, last).detach())
        centre = centre_of_mass(posed, vertex_masses_of_segments(body))
        rest = posed.rest.double().cpu().numpy()
        sole = float(body.rest_vertices(motion.shape)[..., 1].amin())
        thigh = np.linalg.norm(rest[list(_HIPS)] - rest[list(_KNEES)], axis=-1).mean()
        shank = np.linalg.norm(rest[list(_KNEES)] - rest[list(_ANKLES)], axis=-1).mean()
        return cls(
            joints=posed.joints.double().cpu().numpy(),
            centre=centre.double().cpu().numpy(),
            leg=float(thigh + shank),
            sole_drop=np.array([rest[list(group), 1].mean() - sole for group in (_ANKLES, _TOES)]),
            fps=motion.fps,
        )

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.joints)

    @property
    def seconds(self) -> float:
        """Length of the stretch by the declared rate."""
        return self.frames / self.fps

    @property
    def ankles(self) -> Float[np.ndarray, "time 2 3"]:
        """Left and right ankle."""
        return self.joints[:, list(_ANKLES)]

    @property
    def toes(self) -> Float[np.ndarray, "time 2 3"]:
        """Left and right toe joint."""
        return self.joints[:, list(_TOES)]

    @property
    def forward(self) -> Float[np.ndarray, "time 2"]:
        """Horizontal direction in which the pelvis faces."""
        across = (self.joints[:, _HIPS[0]] - self.joints[:, _HIPS[1]])[:, :2]
        across = across / np.linalg.norm(across, axis=-1, keepdims=True).clip(min=1e-9)
        return np.stack((across[:, 1], -across[:, 0]), -1)

    @property
    def sole_heights(self) -> Float[np.ndarray, "time 2"]:
        """Height of the lowest part of the left and the right foot."""
        both = np.stack((self.ankles[..., 2], self.toes[..., 2]), -1) - self.sole_drop
        return both.min(-1)

    @property
    def ground(self) -> float:
        """Height of the ground: the soles are seldom lower."""
        return float(np.quantile(self.sole_heights.min(1), _SELDOM))

    @property
    def soles(self) -> Float[np.ndarray, "time 2 2 3"]:
        """Heel and tip of the left and the right foot, at the height of the joints."""
        along = self.toes - self.ankles
        return np.stack((self.ankles - _HEEL * along, self.toes + _TIP * along), -2)


def _longest(seen: Bool[np.ndarray, " time"]) -> tuple[int, int]:
    """First frame and last + 1 of the longest run of true values; (0, 0) where there is none."""
    runs = [(first, last + 1) for first, last in stretches(seen)]
    return max(runs, key=lambda run: run[1] - run[0], default=(0, 0))


_TURN = 0.35
"""Leg lengths by which the separation of the feet must fall back for an extreme to count."""
_LEAST_STEPS = 2
_IRREGULAR = 0.35
"""Relative standard deviation of durations and of widths above which this is no gait."""
_MAX_SLOW_STEP_LEGS = 0.6
"""Leg lengths: steps less wide may be as slow as one likes."""
_WALK, _RUN = -0.35, 0.5
"""Correlation of the pelvis' height with the separation of the feet: who walks vaults over the
standing leg and is highest where the feet pass each other, who runs is lowest there."""


@dataclass(frozen=True)
class Strides:
    """Alternating steps of two legs, by the declared rate."""

    count: int
    duration: float
    """Median time between two extremes of the feet's separation, in sqrt(leg length / g)."""
    width: float
    """Median separation of the ankles at the extremes, along the pelvis' facing, leg lengths."""
    phase: float
    """Correlation of the pelvis' height with the separation of the feet, -1 to 1."""


def strides(movement: Movement) -> Strides | None:
    """The steps of a stretch of motion, or None where legs do not alternate regularly."""
    if movement.frames < 3:
        return None
    between = (movement.ankles[:, 0] - movement.ankles[:, 1])[:, :2]
    apart = (between * movement.forward).sum(-1) / movement.leg
    turns = _extremes(apart)
    steps = [(a, b) for a, b in itertools.pairwise(turns) if apart[a] * apart[b] < 0]
    if len(steps) < _LEAST_STEPS:
        return None
    durations = np.array([(b - a) / movement.fps for a, b in steps])
    widths = np.array([abs(apart[a] - apart[b]) / 2 for a, b in steps])
    if max(durations.std() / durations.mean(), widths.std() / widths.mean()) > _IRREGULAR:
        return None
    inside = slice(steps[0][0], steps[-1][1] + 1)
    return Strides(
        count=len(steps),
        duration=float(np.median(durations)) * math.sqrt(GRAVITY / movement.leg),
        width=float(np.median(widths)),
        phase=_correlation(_detrended(movement.joints[inside, 0, 2]), np.abs(apart[inside])),
    )


_WALK_RATIO = (0.9, 2.6)
"""Product of width and duration of a walk's steps. CMU: 1.0 to 2.3, median 1.4."""
_WALK_SLOWNESS = (1.35, 4.1)
"""Duration over width of a walk's steps: the inverse of their speed. Above a speed of
sqrt(g leg length) no foot stays on the ground; people change to a run at 0.7 of it."""
_RUN_RATIO = (0.7, 1.6)
"""Product of width and duration of a run's steps. CMU: 0.9 to 1.25."""


def rates_by_strides(found: Strides) -> tuple[float, float]:
    """Factors between which the true rate over the declared one lies; (0, inf) if all may be."""
    low, high = 0.0, math.inf
    if found.width < _MAX_SLOW_STEP_LEGS:
        return low, high
    ratio, slowness = found.width * found.duration, found.duration / found.width
    if found.phase < _WALK:
        low = max(ratio / _WALK_RATIO[1], slowness / _WALK_SLOWNESS[1])
        high = min(ratio / _WALK_RATIO[0], slowness / _WALK_SLOWNESS[0])
    elif found.phase > _RUN and found.count > _LEAST_STEPS:
        low, high = ratio / _RUN_RATIO[1], ratio / _RUN_RATIO[0]
    return low, high


def _extremes(values: Float[np.ndarray, " time"]) -> list[int]:
    """Frames of maxima and minima between which the values turn back by `_TURN`."""
    found: list[int] = []
    high = low = direction = 0
    for index, value in enumerate(values):
        high = index if value > values[high] else high
        low = index if value < values[low] else low
        if direction >= 0 and values[high] - value > _TURN:
            found.append(high)
            direction, high, low = -1, index, index
        elif direction <= 0 and value - values[low] > _TURN:
            found.append(low)
            direction, high, low = 1, index, index
    return found


def _detrended(values: Float[np.ndarray, " time"]) -> Float[np.ndarray, " time"]:
    time = np.arange(len(values))
    return values - np.polyval(np.polyfit(time, values, 1), time)


def _correlation(a: Float[np.ndarray, " time"], b: Float[np.ndarray, " time"]) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0
