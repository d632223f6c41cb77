"""Centre of mass and feet over time; detects seats, steps and treadmills under the body."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.points import TrackedPoints
from recon.body.model import SHORTEST_BODY, TALLEST_BODY, BodyModel
from recon.body.parts import centre_of_mass, vertex_masses_of_segments
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import NOTHING, Finding, Findings, spans, stretches

_HIPS = (joint_index("left_hip"), joint_index("right_hip"))
_KNEES = (joint_index("left_knee"), joint_index("right_knee"))
_ANKLES = (joint_index("left_ankle"), joint_index("right_ankle"))
_TOES = (joint_index("left_foot"), joint_index("right_foot"))
_REQUIRED_JOINTS = (joint_index("pelvis"), *_HIPS, *_KNEES, *_ANKLES)
_GROUND_QUANTILE = 0.1
"""Quantile over time of the lower sole's height that is the height of the ground."""
_HEEL_RATIO, _TIP_RATIO = 0.4, 0.5
"""How far the sole reaches behind the ankle and beyond the toe joint, relative to the distance of
these two joints."""


@dataclass(frozen=True)
class Movement:
    """Centre of mass and feet in one stretch of a motion with visible legs; metres, z up."""

    joints: Float[np.ndarray, "time 22 3"]
    centre: Float[np.ndarray, "time 3"]
    """Position of the centre of mass (m)."""
    leg: float
    """Length of a leg (m) from the hip joint over the knee to the ankle."""
    ankles: Float[np.ndarray, "time 2 3"]
    """Positions of the left and right ankle; those of the toe joints follow."""
    toes: Float[np.ndarray, "time 2 3"]
    sole_drop: Float[np.ndarray, " 2"]
    """Height of the ankle and of the toe joint above the sole of a standing foot."""
    sole_heights: Float[np.ndarray, "time 2"]
    """Height of the lowest part of the left and the right foot."""
    soles: Float[np.ndarray, "time 2 2 3"]
    """Positions (m) of heel and tip of the left and right foot, at the height of its joints."""
    ground: float
    """Height of the ground: a low quantile of the heights of the lower sole."""
    forward: Float[np.ndarray, "time 2"]
    """Horizontal unit vector of the direction that the pelvis faces."""
    fps: float
    frames: int

    @classmethod
    def of(
        cls, motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
    ) -> "Movement":
        """Take the longest stretch of one clip in which the pelvis and both legs were observed.

        Args:
            motion: motion of one clip, z up, without a batch axis.
            body: body model of the motion.
            observed: joints that the data shows; None means all.
        """
        seen = motion.valid
        if observed is not None:
            seen = seen & observed[:, list(_REQUIRED_JOINTS)].all(-1)
        runs = stretches(seen.numpy())
        first, last = max(runs, key=lambda run: run[1] - run[0], default=(0, -1))
        posed = body.pose(motion.window(first, last + 1).detach())
        centre = centre_of_mass(posed, vertex_masses_of_segments(body))
        rest, joints = (x.double().numpy() for x in (posed.rest, posed.joints))
        sole = float(body.rest_vertices(motion.shape)[..., 1].amin())
        thigh = np.linalg.norm(rest[list(_HIPS)] - rest[list(_KNEES)], axis=-1).mean()
        shank = np.linalg.norm(rest[list(_KNEES)] - rest[list(_ANKLES)], axis=-1).mean()
        ankles, toes = joints[:, list(_ANKLES)], joints[:, list(_TOES)]
        drop = np.array([rest[list(group), 1].mean() - sole for group in (_ANKLES, _TOES)])
        heights = (np.stack((ankles[..., 2], toes[..., 2]), -1) - drop).min(-1)
        along = toes - ankles
        return cls(
            joints=joints,
            centre=centre.double().numpy(),
            leg=float(thigh + shank),
            ankles=ankles,
            toes=toes,
            sole_drop=drop,
            sole_heights=heights,
            soles=np.stack((ankles - _HEEL_RATIO * along, toes + _TIP_RATIO * along), -2),
            ground=float(np.quantile(heights.min(1), _GROUND_QUANTILE)) if len(heights) else 0.0,
            forward=facing_directions(joints),
            fps=motion.fps,
            frames=len(joints),
        )


def facing_directions(joints: Float[np.ndarray, "time 22 3"]) -> Float[np.ndarray, "time 2"]:
    """Return the horizontal unit vector in which the hips face, world."""
    across = (joints[:, _HIPS[0]] - joints[:, _HIPS[1]])[:, :2]
    across = across / np.linalg.norm(across, axis=-1, keepdims=True).clip(min=1e-9)
    return np.stack((across[:, 1], -across[:, 0]), -1)


def distance_outside_hull(
    points: Float[np.ndarray, "frames 2"], corners: Float[np.ndarray, "frames corners 2"]
) -> Float[np.ndarray, " frames"]:
    """Return each frame's distance of a point from the convex hull of corners; zero inside."""
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
"""Speed (m/s) below which a foot or the centre of mass stands still."""
_MIN_LEVEL_M = 0.08
"""Height difference (m) of two levels; soles on one floor differ less."""
_MIN_LEVEL_S = 0.3
"""Time (s) for which a foot must stand on another level."""
_MIN_LEVEL_SHARE = 0.1
"""Share of the time of standing feet for which feet must stand on another level."""
_MAX_BESIDE_M = 0.12
"""Distance (m) by which the centre of mass may lie outside the feet of a standing body."""
_MIN_REST_S = 0.8
"""Time (s) at rest beside the feet that makes it sitting, lying or leaning."""
_MIN_PELVIS_LEGS = 0.3
"""Height of the pelvis over the sole of a standing foot, in leg lengths, at least."""
_MAX_SEAT_LEGS, _MIN_SEAT_LEGS = 0.75, -0.2
"""Heights of the pelvis over the lower sole, in leg lengths, between which a body is not on its
feet alone: standing 1.2, sitting on crossed legs 0.7, negative on the hands."""
_LEAST_FRAMES = 10


def support_findings(
    motion: Motion,
    body: BodyModel,
    observed: Bool[Tensor, "time 22"] | None = None,
    ratio: float = 1.0,
) -> list[Finding]:
    """Return findings about feet at several heights, and postures that feet cannot support.

    Args:
        motion: motion of one clip, z up, without a batch axis.
        body: body model of the motion.
        observed: joints that the data shows; None means all.
        ratio: frames of the data per frame of the motion.
    """
    movement = Movement.of(motion, body, observed)
    if movement.frames < _LEAST_FRAMES:
        return []
    speed = np.linalg.norm(np.gradient(movement.centre, axis=0), axis=-1) * movement.fps
    corners = movement.soles[..., :2].reshape(movement.frames, 4, 2)
    beside = distance_outside_hull(movement.centre[:, :2], corners) > _MAX_BESIDE_M
    above = (movement.joints[:, 0, 2] - movement.sole_heights.min(1)) / movement.leg
    rests = (
        (beside & (speed < _MAX_STANDING_SPEED_M_S), "rests beside its feet",
         "sitting, lying or leaning on something"),
        ((above > _MIN_SEAT_LEGS) & (above < _MAX_SEAT_LEGS), "has its pelvis low over its feet",
         "sitting, kneeling, squatting or lying"),
    )  # fmt: skip
    found = _uneven_ground_findings(movement)
    for resting, what, how in rests:
        if frames := stretches(resting, np.nextafter(_MIN_REST_S * movement.fps, np.inf), ratio):
            seconds = sum(last - first + 1 for first, last in frames) / movement.fps / ratio
            said = (
                f"for {seconds:.1f} s the body {what} ({spans(frames)}), {how}: only contacts of "
                "feet, knees and hands with z = 0 are estimated"
            )
            return [*found, Finding("uneven ground", said, (), frames, seconds)]
    return found


def _uneven_ground_findings(movement: Movement) -> list[Finding]:
    """Return a finding if feet stand at several heights."""
    lower, rows = movement.sole_heights.argmin(1), np.arange(movement.frames)
    height = movement.sole_heights[rows, lower]
    speeds = [
        np.linalg.norm(np.gradient(part, axis=0), axis=-1) * movement.fps
        for part in (movement.toes, movement.ankles)
    ]
    still = np.minimum(*speeds)[rows, lower] < _MAX_STANDING_SPEED_M_S
    known = still & (movement.joints[:, 0, 2] > height + _MIN_PELVIS_LEGS * movement.leg)
    if known.sum() < _LEAST_FRAMES:
        return []
    floor = float(np.quantile(height[known], 0.1))
    above = known & (height > floor + _MIN_LEVEL_M)
    long = stretches(above, _MIN_LEVEL_S * movement.fps)
    if not long or above.sum() < _MIN_LEVEL_SHARE * known.sum():
        return []
    most = float(np.quantile(height[above], 0.9)) - floor
    return [
        Finding(
            "uneven ground",
            f"feet stand at several heights, up to {most:.2f} m above the lowest: only contacts "
            "with the level z = 0 are estimated",
            value=most,
        )
    ]


_MIN_BELT_M_S = 0.4
"""Least speed (m/s) of a belt; feet that slip are slower."""
_SOLE_HEIGHT_M = 0.03
"""Height (m) above the ground up to which a sole is on it."""
_MAX_RELATIVE_DEVIATION = 0.2
"""Relative deviation from the belt's velocity up to which a foot is carried by it."""
_MIN_DEVIATION_M_S = 0.2
"""Least tolerance (m/s) for the velocity of a foot that is carried by a belt."""
_MIN_CARRIED_SHARE = 0.55
"""Share of the frames with a sole on the ground in which it must move with the belt."""
_STILL_M_S = 0.3
"""Speed (m/s) below which a foot stands in the room."""
_STANDING_SHARE = 0.15
"""Largest share of the frames with a sole on the ground in which it may stand in the room."""
_MAX_DRIFT_RATIO = 0.35
"""Mean speed of the pelvis over that of the belt, up to which the body stays in place."""
_MIN_CONTACT_S = 0.15
"""Time (s) for which each foot must touch the ground."""
_MIN_PELVIS_HEIGHT_LEGS = 0.7
"""Least median height of the pelvis above the ground, in leg lengths, of walks and runs."""


def belt_velocity(
    motion: Motion, body: BodyModel, observed: Bool[Tensor, "time 22"] | None = None
) -> Float[Tensor, " 2"] | None:
    """Return the horizontal velocity (m/s) of a treadmill's belt; None if there is none.

    Feet count as standing by their height alone, since on a belt none stands still. Both move at
    one velocity, against the direction that the person faces, and the body stays in the room.

    Args:
        motion: motion of one clip, z up, without a batch axis.
        body: body model of the motion.
        observed: joints that the data shows; None means all.
    """
    movement = Movement.of(motion, body, observed)
    if movement.frames < 3:
        return None
    height = float(np.median(movement.joints[:, 0, 2])) - movement.ground
    if height < _MIN_PELVIS_HEIGHT_LEGS * movement.leg:
        return None
    feet = np.stack((movement.ankles, movement.toes), -2)
    # which part of each foot is lower: 0 the heel, judged by the ankle; 1 the toes
    lower = (feet[..., 2] - movement.sole_drop).argmin(-1)
    steps = np.diff(feet[..., :2], axis=0) * movement.fps
    velocity = np.take_along_axis(steps, lower[:-1, :, None, None], axis=2)[:, :, 0]
    low = movement.sole_heights < movement.ground + _SOLE_HEIGHT_M
    standing = low[1:] & low[:-1] & (lower[1:] == lower[:-1])
    if (standing.sum(0) < max(3, _MIN_CONTACT_S * movement.fps)).any():
        return None
    # the most frequent velocity: the median of the largest group of similar ones
    every = velocity[standing]
    some = every[:: max(1, len(every) // 400)]
    best = some[
        int(np.argmax([int(_close_velocities(every, candidate).sum()) for candidate in some]))
    ]
    belt = np.median(every[_close_velocities(every, best)], axis=0)
    speed = float(np.linalg.norm(belt))
    if speed < _MIN_BELT_M_S:
        return None
    carried = _close_velocities(velocity, belt)
    shares = [carried[standing[:, side], side].mean() for side in (0, 1)]
    still = (np.linalg.norm(velocity[standing], axis=-1) < _STILL_M_S).mean()
    drift = (movement.joints[-1, 0, :2] - movement.joints[0, 0, :2]) / (
        movement.frames / movement.fps
    )
    facing = movement.forward.mean(0) @ belt / speed
    stays = float(np.linalg.norm(drift)) < _MAX_DRIFT_RATIO * speed
    if min(shares) < _MIN_CARRIED_SHARE or still > _STANDING_SHARE or not stays or facing > 0:
        return None
    return torch.from_numpy(belt).to(motion.translation)


def treadmill_finding(belt: Float[Tensor, " 2"]) -> Finding:
    """Return the finding about a treadmill whose belt has this velocity (m/s)."""
    speed = float(belt.norm())
    return Finding(
        "treadmill",
        f"standing feet are all carried along at {speed:.2f} m/s, as on a treadmill: they do not "
        "stand still in the room, so contacts with the ground are not estimated",
        value=speed,
    )


def _close_velocities(
    velocity: Float[np.ndarray, "*shape 2"], belt: Float[np.ndarray, " 2"]
) -> Bool[np.ndarray, "*shape"]:
    reach = max(_MIN_DEVIATION_M_S, _MAX_RELATIVE_DEVIATION * float(np.linalg.norm(belt)))
    return np.linalg.norm(velocity - belt, axis=-1) < reach


def in_belt_frame(points: TrackedPoints, belt: Float[Tensor, " 2"]) -> TrackedPoints:
    """Transform points from the room's frame to that of a treadmill's belt (velocity in m/s)."""
    path = _path_of_belt(points.positions.shape[-3], points.fps, points.start_time, belt)
    moved = points.positions - path.to(points.positions)[:, None]
    return points.replace(positions=moved.where(points.visible[..., None], 0.0))


def motion_in_room(motion: Motion, belt: Float[Tensor, " 2"]) -> Motion:
    """Transform a motion from the frame of a treadmill's belt to the room's frame."""
    return motion.replace(translation=motion.translation + path_of_belt(motion, belt))


def path_of_belt(motion: Motion, belt: Float[Tensor, " 2"]) -> Float[Tensor, "time 3"]:
    """Return the displacement (m) of the belt at every frame of a motion."""
    path = _path_of_belt(motion.frames, motion.fps, motion.start_time, belt)
    return path.to(motion.translation)


def _path_of_belt(
    count: int, fps: float, start: float, belt: Float[Tensor, " 2"]
) -> Float[Tensor, "time 3"]:
    times = start + torch.arange(count, dtype=torch.float64) / fps
    return torch.nn.functional.pad(times[:, None] * belt.double(), (0, 1))


_MIN_CHILD_HEIGHT_M = 0.95
"""Height (m); smaller children do not walk on command."""


def height_findings(tall: float, causes: str, *, may_be_child: bool) -> Findings:
    """Return a warning if no adult has this height (m); it names `causes` that are to be checked.

    Where there `may_be_child`, as in points in metres, a child's height is only noted.
    """
    if may_be_child and _MIN_CHILD_HEIGHT_M < tall <= SHORTEST_BODY:
        text = (
            f"the person is {tall:.2f} m tall: a child, whose proportions an adult body meets "
            "only roughly. If it is an adult, check the unit and the scale of the points"
        )
        return Findings(diagnosis=(Finding("body size", text, value=tall),))
    if SHORTEST_BODY < tall < TALLEST_BODY:
        return NOTHING
    text = (
        f"the person would be {tall:.2f} m tall; check {causes} (an adult body cannot fit a "
        "child better)"
    )
    return Findings(warnings=(Finding("body size", text, value=tall),))
