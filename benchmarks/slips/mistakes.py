"""What is done to a clean recording by each mistake, as functions of the recording and a size.

A mistake changes what it says and nothing else; the truth stays what it was.
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
from recon.simulation.images import orbiting

Spoil = Callable[[Recording, float], tuple[Seen, ...]]
"""The observations of a recording after a mistake of a size."""

_FIRST = 0.25
"""Share of the clip after which a mistake of a stretch begins."""
_SPOILED_VIEW = 1
"""Number of the view that is at odds with the others."""


def sides(recording: Recording, _: float) -> tuple[Seen, ...]:
    """Left and right exchanged in all frames."""
    return tuple(_sides(seen, slice(None)) for seen in recording.clean)


def sides_for(recording: Recording, seconds: float) -> tuple[Seen, ...]:
    """Left and right exchanged for some seconds."""
    return tuple(_sides(seen, _stretch(recording, seconds)) for seen in recording.clean)


def exchange(first: str, second: str) -> Spoil:
    """Two points that carry each other's name for some seconds."""

    def spoil(recording: Recording, seconds: float) -> tuple[Seen, ...]:
        frames = _stretch(recording, seconds)
        return tuple(
            points.exchanged(seen, [(_point(seen, first), _point(seen, second))], frames)
            for seen in recording.clean
        )

    return spoil


def somebody_else(recording: Recording, distance: float) -> tuple[Seen, ...]:
    """Another person from mid clip on, so many metres beside the first at that moment."""
    frame = recording.truth.frames // 2
    other = recording.of(beside(recording, distance, frame), recording.seed + 1)
    return tuple(
        points.joined(seen, theirs, frame)
        for seen, theirs in zip(recording.clean, other, strict=True)
    )


def beside(recording: Recording, distance: float, frame: int) -> Motion:
    """The stranger carried to where their pelvis is beside the person's at one frame."""
    angle = math.tau * torch.rand(1, generator=Generator().manual_seed(recording.seed)).item()
    way = torch.tensor([math.cos(angle), math.sin(angle)]) * distance
    own, other = (
        recording.body.pose(motion.window(frame, frame + 1)).joints[0, 0, :2]
        for motion in (recording.truth, recording.stranger)
    )
    shift = torch.cat((own + way - other, torch.zeros(1)))
    return recording.stranger.replace(translation=recording.stranger.translation + shift)


def hold(point: str) -> Spoil:
    """A point that repeats its last value for some seconds."""

    def spoil(recording: Recording, seconds: float) -> tuple[Seen, ...]:
        frames = _stretch(recording, seconds)
        return tuple(points.held(seen, _point(seen, point), frames) for seen in recording.clean)

    return spoil


def zeros(recording: Recording, share: float) -> tuple[Seen, ...]:
    """A share of the points written as zeros that count as seen."""
    return tuple(
        points.zeroed(seen, share, recording.seed + k) for k, seen in enumerate(recording.clean)
    )


def offset(point: str, axis: int) -> Spoil:
    """A point so many metres away from its place throughout."""

    def spoil(recording: Recording, metres: float) -> tuple[Seen, ...]:
        way = [0.0, 0.0, 0.0]
        way[axis] = metres
        return tuple(points.displaced(seen, _point(seen, point), way) for seen in recording.clean)

    return spoil


def rate(recording: Recording, factor: float) -> tuple[Seen, ...]:
    """A declared rate that is so many times the true one."""
    return tuple(seen.derived(fps=seen.fps * factor) for seen in recording.clean)


def shuffle(recording: Recording, block: float) -> tuple[Seen, ...]:
    """Frames in random order within blocks of so many."""
    order = points.shuffled(recording.truth.frames, round(block), recording.seed)
    return tuple(points.reordered(seen, order) for seen in recording.clean)


def repeat(recording: Recording, share: float) -> tuple[Seen, ...]:
    """A share of the frames lost at random and filled by repeating the last one before."""
    order = points.repeating(recording.truth.frames, share, recording.seed)
    return tuple(points.reordered(seen, order) for seen in recording.clean)


def lift(recording: Recording, metres: float) -> tuple[Seen, ...]:
    """The person stands so many metres above the declared ground; negative: below."""
    return tuple(points.moved(seen, (0.0, 0.0, metres)) for seen in recording.clean)


def scale(recording: Recording, factor: float) -> tuple[Seen, ...]:
    """All positions multiplied by a factor."""
    return tuple(points.scaled(seen, (factor,) * 3) for seen in recording.clean)


def mirror(recording: Recording, _: float) -> tuple[Seen, ...]:
    """The recording's x axis points the wrong way."""
    return tuple(points.scaled(seen, (-1.0, 1.0, 1.0)) for seen in recording.clean)


def outliers(recording: Recording, share: float) -> tuple[Seen, ...]:
    """A share of the points is far away, anew in every frame."""
    return tuple(
        points.wild(seen, share, recording.seed + k) for k, seen in enumerate(recording.clean)
    )


def carried_camera(recording: Recording, degrees: float) -> tuple[Seen, ...]:
    """A phone that is carried around the person by an angle, declared fixed."""
    middle = recording.body.pose(recording.truth).joints.flatten(0, 1).mean(0)
    radians = math.radians(degrees)
    moving = orbiting(recording.cameras[0], middle, recording.truth.frames, radians)
    first = recording.cameras[0].replace(T_camera_world=moving.T_camera_world)
    return _declared(recording, first, 0)


def sagging_view(recording: Recording, degrees: float) -> tuple[Seen, ...]:
    """One of several cameras turns by an angle during the clip, declared fixed."""
    camera, frames = recording.cameras[_SPOILED_VIEW], recording.truth.frames
    true = points.drifting(camera, frames, degrees, recording.seed)
    return _declared(recording, true, _SPOILED_VIEW)


def misplaced_view(recording: Recording, degrees: float) -> tuple[Seen, ...]:
    """One camera's calibrated pose is turned by an angle."""
    return _one(recording, lambda view: points.misplaced(view, degrees, recording.seed))


def other_person_in_view(recording: Recording, distance: float) -> tuple[Seen, ...]:
    """One view follows another person, at so many metres when the clip begins."""
    other = recording.of(beside(recording, distance, 0), recording.seed + 1)
    return _one(recording, lambda view: other[_SPOILED_VIEW])


def sides_in_view(recording: Recording, seconds: float) -> tuple[Seen, ...]:
    """One view has left and right exchanged for some seconds."""
    return _one(recording, lambda view: _sides(view, _stretch(recording, seconds)))


def mirrored_view(recording: Recording, _: float) -> tuple[Seen, ...]:
    """One view's images are mirrored."""
    return _one(recording, points.mirrored)


def delayed_view(recording: Recording, frames: float) -> tuple[Seen, ...]:
    """One view's clock is late by some frames."""
    return _one(recording, lambda view: points.delayed(view, round(frames)))


def mirrored_views(recording: Recording, _: float) -> tuple[Seen, ...]:
    """All views' images are mirrored."""
    return tuple(points.mirrored(view) for view in recording.clean)


def large_calibration(recording: Recording, factor: float) -> tuple[Seen, ...]:
    """All cameras are declared so many times as far from the origin."""
    return tuple(points.spread_out(view, factor) for view in recording.clean)


def _sides(seen: Seen, frames: slice) -> Seen:
    return points.exchanged(seen, points.pairs_of_sides(points.point_names(seen)), frames)


def _point(seen: Seen, name: str) -> int:
    return points.point_names(seen).index(name)


def _stretch(recording: Recording, seconds: float) -> slice:
    """Some seconds from a quarter of the clip on; the whole clip when that is as long."""
    frames, count = recording.truth.frames, round(seconds * recording.truth.fps)
    first = min(round(_FIRST * frames), max(frames - count, 0))
    return slice(first, first + count)


def _one(recording: Recording, spoil: Callable[[Seen], Seen]) -> tuple[Seen, ...]:
    return _with(recording.clean, _SPOILED_VIEW, spoil(recording.clean[_SPOILED_VIEW]))


def _with(seen: Sequence[Seen], number: int, other: Seen) -> tuple[Seen, ...]:
    return tuple(other if k == number else one for k, one in enumerate(seen))


def _declared(recording: Recording, true: Camera, number: int) -> tuple[Seen, ...]:
    """What a camera sees while it moves, with the pose that it is declared to have."""
    cameras = tuple(true if k == number else c for k, c in enumerate(recording.cameras))
    seen = observed(
        recording.sensor, recording.truth, recording.body, cameras, recording.corruption,
        recording.seed,
    )  # fmt: skip
    clean = recording.clean[number]
    return _with(recording.clean, number,
                 points.edited(clean, points.values_of(seen[number]),
                               points.weights_of(seen[number])))  # fmt: skip
