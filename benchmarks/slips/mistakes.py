"""Functions that make each mistake (slip) of a given size in a clean recording.

They change the observations only; the true motion stays the same.
"""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Generator

from benchmarks.slips import points
from benchmarks.slips.points import Seen
from benchmarks.slips.recordings import Recording, observed
from recon.core.camera import Camera
from recon.core.motion import Motion
from recon.simulation.images import orbiting_camera

Spoil = Callable[[Recording, float], tuple[Seen, ...]]
"""Function that returns the observations of a recording after a mistake of a given size."""

_START_SHARE = 0.25
"""Share of the clip after which a mistake begins that lasts for a stretch."""
_SPOILED_VIEW = 1
"""Index of the view that contradicts the others."""


def sides(recording: Recording, _: float) -> tuple[Seen, ...]:
    """Exchange left and right in all frames."""
    return tuple(_sides(seen, slice(None)) for seen in recording.clean)


def sides_for(recording: Recording, seconds: float) -> tuple[Seen, ...]:
    """Exchange left and right for some seconds."""
    return tuple(_sides(seen, _stretch(recording, seconds)) for seen in recording.clean)


def exchange(first: str, second: str) -> Spoil:
    """Return a mistake that exchanges the names of two points for some seconds."""

    def spoil(recording: Recording, seconds: float) -> tuple[Seen, ...]:
        frames = _stretch(recording, seconds)
        return tuple(
            points.exchanged(seen, [(_point(seen, first), _point(seen, second))], frames)
            for seen in recording.clean
        )

    return spoil


def somebody_else(recording: Recording, distance: float) -> tuple[Seen, ...]:
    """Switch to another person in mid clip, who is `distance` metres beside the first then."""
    frame = recording.truth.frames // 2
    other = recording.of(beside(recording, distance, frame), recording.seed + 1)
    return tuple(
        points.joined(seen, theirs, frame)
        for seen, theirs in zip(recording.clean, other, strict=True)
    )


def beside(recording: Recording, distance: float, frame: int) -> Motion:
    """Move the stranger's motion so that the pelvis is beside the person's in one frame."""
    angle = math.tau * torch.rand(1, generator=Generator().manual_seed(recording.seed)).item()
    way = torch.tensor([math.cos(angle), math.sin(angle)]) * distance
    own, other = (
        recording.body.pose(motion.window(frame, frame + 1)).joints[0, 0, :2]
        for motion in (recording.truth, recording.stranger)
    )
    shift = torch.cat((own + way - other, torch.zeros(1)))
    return recording.stranger.replace(translation=recording.stranger.translation + shift)


def hold(point: str) -> Spoil:
    """Return a mistake by which a point repeats its last value for some seconds."""

    def spoil(recording: Recording, seconds: float) -> tuple[Seen, ...]:
        frames = _stretch(recording, seconds)
        return tuple(points.held(seen, _point(seen, point), frames) for seen in recording.clean)

    return spoil


def zeros(recording: Recording, share: float) -> tuple[Seen, ...]:
    """Write a share of the points as zeros that count as seen."""
    return tuple(
        points.zeroed(seen, share, recording.seed + k) for k, seen in enumerate(recording.clean)
    )


def offset(point: str, axis: int) -> Spoil:
    """Return a mistake that moves a point away from its place by some metres in all frames."""

    def spoil(recording: Recording, metres: float) -> tuple[Seen, ...]:
        way = [0.0, 0.0, 0.0]
        way[axis] = metres
        return tuple(points.displaced(seen, _point(seen, point), way) for seen in recording.clean)

    return spoil


def rate(recording: Recording, factor: float) -> tuple[Seen, ...]:
    """Declare a frame rate that is `factor` times the true one."""
    return tuple(seen.derived(fps=seen.fps * factor) for seen in recording.clean)


def shuffle(recording: Recording, block: float) -> tuple[Seen, ...]:
    """Put frames in random order within blocks."""
    order = points.shuffled(recording.truth.frames, round(block), recording.seed)
    return tuple(points.reordered(seen, order) for seen in recording.clean)


def repeat(recording: Recording, share: float) -> tuple[Seen, ...]:
    """Replace a random share of the frames by the last one before that is left."""
    order = points.repeating(recording.truth.frames, share, recording.seed)
    return tuple(points.reordered(seen, order) for seen in recording.clean)


def lift(recording: Recording, metres: float) -> tuple[Seen, ...]:
    """Let the person stand some metres above the declared ground; negative: below."""
    return tuple(points.moved(seen, (0.0, 0.0, metres)) for seen in recording.clean)


def scale(recording: Recording, factor: float) -> tuple[Seen, ...]:
    """Multiply all positions by a factor."""
    return tuple(points.scaled(seen, (factor,) * 3) for seen in recording.clean)


def mirror(recording: Recording, _: float) -> tuple[Seen, ...]:
    """Reverse the recording's x axis."""
    return tuple(points.scaled(seen, (-1.0, 1.0, 1.0)) for seen in recording.clean)


def outliers(recording: Recording, share: float) -> tuple[Seen, ...]:
    """Move a share of the points far away, independently in every frame."""
    return tuple(
        points.wild(seen, share, recording.seed + k) for k, seen in enumerate(recording.clean)
    )


def carried_camera(recording: Recording, degrees: float) -> tuple[Seen, ...]:
    """Carry a phone around the person by an angle, and declare it fixed."""
    middle = recording.body.pose(recording.truth).joints.flatten(0, 1).mean(0)
    radians = math.radians(degrees)
    moving = orbiting_camera(recording.cameras[0], middle, recording.truth.frames, radians)
    first = recording.cameras[0].replace(T_camera_world=moving.T_camera_world)
    return _declared(recording, first, 0)


def sagging_view(recording: Recording, degrees: float) -> tuple[Seen, ...]:
    """Turn one of several cameras by an angle during the clip, and declare it fixed."""
    camera, frames = recording.cameras[_SPOILED_VIEW], recording.truth.frames
    true = points.drifting(camera, frames, degrees, recording.seed)
    return _declared(recording, true, _SPOILED_VIEW)


def misplaced_view(recording: Recording, degrees: float) -> tuple[Seen, ...]:
    """Turn one camera's calibrated pose by an angle."""
    return _one(recording, lambda view: points.misplaced(view, degrees, recording.seed))


def other_person_in_view(recording: Recording, distance: float) -> tuple[Seen, ...]:
    """Let one view follow another person, some metres away when the clip begins."""
    other = recording.of(beside(recording, distance, 0), recording.seed + 1)
    return _one(recording, lambda view: other[_SPOILED_VIEW])


def sides_in_view(recording: Recording, seconds: float) -> tuple[Seen, ...]:
    """Exchange left and right in one view for some seconds."""
    return _one(recording, lambda view: _sides(view, _stretch(recording, seconds)))


def mirrored_view(recording: Recording, _: float) -> tuple[Seen, ...]:
    """Mirror one view's images."""
    return _one(recording, points.mirrored)


def delayed_view(recording: Recording, frames: float) -> tuple[Seen, ...]:
    """Delay one view's clock by some frames."""
    return _one(recording, lambda view: points.delayed(view, round(frames)))


def mirrored_views(recording: Recording, _: float) -> tuple[Seen, ...]:
    """Mirror all views' images."""
    return tuple(points.mirrored(view) for view in recording.clean)


def large_calibration(recording: Recording, factor: float) -> tuple[Seen, ...]:
    """Declare all cameras `factor` times as far from the origin."""
    return tuple(points.spread_out(view, factor) for view in recording.clean)


def _sides(seen: Seen, frames: slice) -> Seen:
    return points.exchanged(seen, points.pairs_of_sides(points.point_names(seen)), frames)


def _point(seen: Seen, name: str) -> int:
    return points.point_names(seen).index(name)


def _stretch(recording: Recording, seconds: float) -> slice:
    """Return the frames of some seconds from a quarter of the clip on, or the whole clip."""
    frames, count = recording.truth.frames, round(seconds * recording.truth.fps)
    first = min(round(_START_SHARE * frames), max(frames - count, 0))
    return slice(first, first + count)


def _one(recording: Recording, spoil: Callable[[Seen], Seen]) -> tuple[Seen, ...]:
    return _with(recording.clean, _SPOILED_VIEW, spoil(recording.clean[_SPOILED_VIEW]))


def _with(seen: Sequence[Seen], number: int, other: Seen) -> tuple[Seen, ...]:
    return tuple(other if k == number else one for k, one in enumerate(seen))


def _declared(recording: Recording, true: Camera, number: int) -> tuple[Seen, ...]:
    """Return what a moving camera sees, with the pose that it is declared to have."""
    cameras = tuple(true if k == number else c for k, c in enumerate(recording.cameras))
    seen = observed(
        recording.sensor, recording.truth, recording.body, cameras, recording.corruption,
        recording.seed,
    )  # fmt: skip
    clean = recording.clean[number]
    return _with(recording.clean, number,
                 points.edited(clean, points.values_of(seen[number]),
                               points.weights_of(seen[number])))  # fmt: skip
