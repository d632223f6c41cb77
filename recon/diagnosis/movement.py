"""The centre of mass and the feet of a body over time, and what carries it: feet or a seat."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import Finding, spans, stretches
from recon.physics.mass import centre_of_mass, vertex_masses_of_segments

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


def outside(
    points: Float[np.ndarray, "frames 2"], corners: Float[np.ndarray, "frames corners 2"]
) -> Float[np.ndarray, " frames"]:
    """Distance of a point from the convex hull of its corners, zero inside."""
    count = corners.shape[1]
    distance = np.full(len(points), np.inf)
    for a in range(count):
        for b in range(a + 1, count):
            side = corners[:, b] - corners[:, a]
            arm = points - corners[:, a]
            along = (arm * side).sum(-1) / np.square(side).sum(-1).clip(min=1e-9)
            nearest = corners[:, a] + along.clip(0, 1)[:, None] * side
            distance = np.minimum(distance, np.linalg.norm(points - nearest, axis=-1))
    arms = corners - points[:, None]
    angles = np.sort(np.arctan2(arms[..., 1], arms[..., 0]), axis=1)
    around = np.diff(np.concatenate((angles, angles[:, :1] + 2 * np.pi), 1), axis=1)
    return np.where(around.max(1) < np.pi, 0.0, distance)


_MAX_STANDING_SPEED_M_S = 0.2
"""Metres per second below which a foot or the centre of mass stands."""
_LEVELS = 0.08
"""Metres between two levels; soles of one floor differ less."""
_MIN_LEVEL_S = 0.3
"""Seconds for which a foot must stand on another level."""
_MIN_LEVEL_SHARE = 0.1
"""Share of the time of all standing feet for which feet must stand on another level."""
_MAX_BESIDE_M = 0.12
"""Metres by which the centre of mass may lie beside the feet while a body stands still."""
_LEAST_REST = 0.8
"""Seconds of rest beside the feet that make it sitting, lying or leaning."""
_BELOW = 0.3
"""Lengths of a leg by which a standing sole is below the pelvis."""
_SEATED, _INVERTED = 0.75, -0.2
"""Heights of the pelvis over the lower sole, in lengths of a leg, between which a body is not on
its feet alone: 1.2 for who stands, 0.7 for who sits on crossed legs, negative on the hands."""
_LEAST_FRAMES = 10


def support_findings(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> list[Finding]:
    """Feet that stand at several heights, and rests that feet alone cannot carry or hardly do.

    Args:
        motion: one clip, z up, without a batch axis.
        body: whose motion it is.
        observed: joints that the data shows; None means all.
    """
    movement = Movement.of(motion, body, observed)
    if movement.frames < _LEAST_FRAMES:
        return []
    speed = np.linalg.norm(np.gradient(movement.centre, axis=0), axis=-1) * movement.fps
    corners = movement.soles[..., :2].reshape(movement.frames, 4, 2)
    beside = outside(movement.centre[:, :2], corners) > _MAX_BESIDE_M
    above = (movement.joints[:, 0, 2] - movement.sole_heights.min(1)) / movement.leg
    rests = (
        (beside & (speed < _MAX_STANDING_SPEED_M_S), "rests beside its feet",
         "sitting, lying or leaning on something"),
        ((above > _INVERTED) & (above < _SEATED), "has its pelvis low over its feet",
         "sitting, kneeling, squatting or lying"),
    )  # fmt: skip
    found = _uneven(movement)
    for resting, what, how in rests:
        if frames := stretches(resting, np.nextafter(_LEAST_REST * movement.fps, np.inf)):
            seconds = sum(last - first + 1 for first, last in frames) / movement.fps
            said = (
                f"for {seconds:.1f} s the body {what} ({spans(frames)}), {how}: contacts are told "
                "of feet, knees and hands with z = 0 only"
            )
            return [*found, Finding("uneven ground", said, (), frames, seconds)]
    return found


def _uneven(movement: Movement) -> list[Finding]:
    """Feet that stand below the body at several heights."""
    lower, rows = movement.sole_heights.argmin(1), np.arange(movement.frames)
    height = movement.sole_heights[rows, lower]
    speeds = [
        np.linalg.norm(np.gradient(part, axis=0), axis=-1) * movement.fps
        for part in (movement.toes, movement.ankles)
    ]
    still = np.minimum(*speeds)[rows, lower] < _MAX_STANDING_SPEED_M_S
    known = still & (movement.joints[:, 0, 2] > height + _BELOW * movement.leg)
    if known.sum() < _LEAST_FRAMES:
        return []
    floor = float(np.quantile(height[known], 0.1))
    above = known & (height > floor + _LEVELS)
    long = stretches(above, _MIN_LEVEL_S * movement.fps)
    if not long or above.sum() < _MIN_LEVEL_SHARE * known.sum():
        return []
    most = float(np.quantile(height[above], 0.9)) - floor
    return [
        Finding(
            "uneven ground",
            f"feet stand at several heights, up to {most:.2f} m above the lowest: contacts are "
            "told on the level z = 0 only",
            value=most,
        )
    ]
