"""Motions on a treadmill as motions on the ground: the room is left moving with the belt.

In a frame that moves with the belt, feet stand still and the person walks on; there everything
that is known of gait and of contacts holds. Results are carried back to the room.
"""

from jaxtyping import Float
from torch import Tensor, arange, float64, nn

from observations.together.kinds import Tracked
from recon.core.motion import Motion


def with_belt(points: Tracked, belt: Float[Tensor, " 2"]) -> Tracked:
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
