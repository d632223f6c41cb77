"""Decides what may be learned from each second: poses, steps, contacts, shapes.

A second is judged by what its motion shows: whether the foot that carries stands still, whether a
joint jumps, whether feet rest on something that is not the ground, whether bodies fall as gravity
has them fall. Whose bones the skeleton has is known from the source.
"""

from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np
from jaxtyping import Bool, Float

from recon.body.model import BodyModel
from recon.core.motion import Motion, MotionFile
from recon.core.skeleton import joint_index
from recon.diagnosis.findings import stretches
from recon.diagnosis.frame_rate import rates_by_falls
from recon.diagnosis.movement import Movement
from training.manifest import ManifestRow

_RATE = 60.0
"""Frames per second at which motions are judged."""
_NEAR = 0.05
"""Metres above the ground of a sole that may carry."""
_OWN, _COMMON = (0.25, 0.15), (0.5, 0.1)
"""Share of a second's frames whose slowest point of the feet near the ground must be slower than
so many metres per second: of people on their own bones, who may run, and on common ones. Walks on
own bones have 0.04 to 0.08 in the median."""
_SHOWN = 0.25
"""Share of a second's frames in which a foot is near the ground, for its feet to be judged."""
_RAISED, _RESTS = 0.1, 0.3
"""Metres above the ground of a sole that stands on something else, and for how many seconds."""
_FLIGHT = 0.8
"""Seconds; where no foot is near the ground for longer, seats, bars or hands carry."""
_STILL = 0.15
"""Metres per second of a sole that stands."""
_BELOW = 0.12
"""Metres that a sole is under the ground where the ground is not flat."""
_JUMP, _SPIN = 15.0, 120.0
"""Metres and radians per second that no joint of a body reaches."""
_HURRY = 2.0
"""How much faster than bodies what plays too fast may be."""
RESIDUAL = 0.02
"""Metres: the marker fit is unsure in a second whose markers are farther from their places."""
_TRUNK_AND_LIMBS = tuple(
    joint_index(name)
    for name in ("pelvis", "spine3", "head", *(
        f"{side}_{joint}" for side in ("left", "right")
        for joint in ("knee", "ankle", "elbow", "wrist", "shoulder")
    ))
)  # fmt: skip
"""Joints that must have been seen for a pose to be learned from."""


@dataclass(frozen=True)
class Source:
    """Metadata of a recording: what is known of its person, skeleton and quality."""

    own_bones: bool = True
    """Whether the bones are those of the person who moves; if not, the root's path does not fit
    the legs, unless the feet hold."""
    retargeted: bool = False
    """Whether somebody put the motion on another skeleton with fewer joints: poses alone."""
    true_rate: bool = True
    """Whether it plays as fast as it happened."""
    flat: bool = True
    clip: str = ""
    collection: str = ""
    """Names of the recording and of its collection in the manifest."""
    residuals: tuple[float, ...] = ()
    """Mean distance of markers from their places in every second, metres; skeletons have none."""


def lesson_rows(file: MotionFile, source: Source, body: BodyModel) -> list[ManifestRow]:
    """Split a clip into stretches of whole seconds by what may be learned from each.

    Args:
        file: the converted clip, on the ground z = 0.
        source: what is known of the recording.
        body: whose motion it is.
    """
    motion = file.motion
    count = max(1, round(motion.frames / motion.fps))
    edges = [min(round(k * motion.fps), motion.frames) for k in range(count)] + [motion.frames]
    against = _reasons_by_second(file, source, body, edges)
    spans = [
        _row_of_stretch(first, stop, why, source)
        for (first, stop), why in zip(pairwise(edges), against, strict=True)
    ]
    joined: list[ManifestRow] = []
    for _, group in groupby(spans, key=lambda span: replace(span, first=0, stop=0)):
        same = list(group)
        seconds = round((same[-1].stop - same[0].first) / motion.fps, 3)
        joined.append(replace(same[0], stop=same[-1].stop, seconds=seconds))
    return joined


_SPOILS = {
    "jump": "poses", "unseen": "poses", "residual": "poses",
    "rate": "steps", "ground": "steps", "raised": "steps", "slides": "steps", "copied": "steps",
    "bones": "contacts",
}  # fmt: skip
"""The first lesson that each finding takes away: steps need poses, contacts need steps."""


def _row_of_stretch(first: int, stop: int, why: tuple[str, ...], source: Source) -> ManifestRow:
    lost = {_SPOILS[word] for word in why}
    poses = "poses" not in lost
    steps = poses and "steps" not in lost
    return ManifestRow(
        source.clip, source.collection, first, stop, 0.0, poses, steps,
        steps and "contacts" not in lost, poses and source.own_bones, " ".join(why),
    )  # fmt: skip


def _reasons_by_second(
    file: MotionFile, source: Source, body: BodyModel, edges: list[int]
) -> list[tuple[str, ...]]:
    """Faults of each second that exclude it from trainings, as keys of `_SPOILS`."""
    motion = file.motion
    step = max(1, round(motion.fps / _RATE))
    movement = Movement.of(_every_nth_frame(motion, step), body)
    slide, near = foot_slide(movement)
    raised = _off_ground(movement)
    fast = _implausible_steps(file, 1.0 if source.true_rate else _HURRY)
    unseen = np.zeros(motion.frames, dtype=bool)
    if file.observed is not None:
        unseen = ~file.observed[:, list(_TRUNK_AND_LIMBS)].all(-1).numpy()
    always: list[str] = []
    if source.retargeted:
        always.append("copied")
    if not source.true_rate or not rates_by_falls(movement)[1] >= 1:
        always.append("rate")
    if not source.flat:
        always.append("ground")
    share, limit = _OWN if source.own_bones else _COMMON
    overall = float(np.quantile(slide[near], share)) if near.any() else np.inf
    found: list[tuple[str, ...]] = []
    for k, (first, stop) in enumerate(pairwise(edges)):
        here = slice(int(first / step), max(int(first / step) + 1, int(stop / step)))
        words = [*always]
        if fast[max(first - 1, 0) : stop].any():
            words.append("jump")
        if unseen[first:stop].any():
            words.append("unseen")
        if k < len(source.residuals) and source.residuals[k] > RESIDUAL:
            words.append("residual")
        shown = near[here].mean() >= _SHOWN
        moving = float(np.quantile(slide[here][near[here]], share)) if shown else overall
        if (shown or not source.own_bones) and moving > limit:
            words.append("slides")
        if raised[here].any():
            words.append("raised")
        if not source.own_bones:
            words.append("bones")
        found.append(tuple(sorted(set(words), key=list(_SPOILS).index)))
    return found


def _every_nth_frame(motion: Motion, step: int) -> Motion:
    return motion.replace(
        translation=motion.translation[::step],
        rotations=motion.rotations[::step],
        valid=motion.valid[::step],
        fps=motion.fps / step,
    )


def foot_slide(
    movement: Movement,
) -> tuple[Float[np.ndarray, " time"], Bool[np.ndarray, " time"]]:
    """Horizontal speed of the slowest foot point near the ground, and a mask of frames with one.

    Whoever walks has such a point at rest in every moment, and whoever runs while not in the air.
    """
    points = np.concatenate((movement.ankles, movement.toes), 1)
    speed = np.linalg.norm(np.gradient(points[..., :2], axis=0), axis=-1) * movement.fps
    low = np.tile(movement.sole_heights < movement.ground + _NEAR, (1, 2))
    slowest = np.where(low, speed, np.inf).min(1)
    near = np.asarray(low.any(1))
    return np.where(near, slowest, 0.0), near


def _off_ground(movement: Movement) -> Bool[np.ndarray, " time"]:
    """Mask of frames in which soles are below the ground, or something else carries the body.

    A sole stands higher than the ground, or no foot is near it for longer than a flight lasts.
    """
    lower = movement.sole_heights.argmin(1)
    rows = np.arange(movement.frames)
    points = np.stack((movement.ankles, movement.toes), 2)[rows, lower]
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1).min(1) * movement.fps
    height = movement.sole_heights[rows, lower]
    found = height < -_BELOW
    stands = stretches((height > _RAISED) & (speed < _STILL), _RESTS * movement.fps)
    hangs = stretches(height > movement.ground + _NEAR, _FLIGHT * movement.fps)
    for first, last in (*stands, *hangs):
        found[first : last + 1] = True
    return found


def _implausible_steps(file: MotionFile, speed_factor: float) -> Bool[np.ndarray, " steps"]:
    """Steps to the next frame in which a joint or a turn is faster than bodies are."""
    motion = file.motion
    turn = motion.rotations.diff(dim=0).flatten(-2).norm(dim=-1) / 2**0.5
    fast = (turn * motion.fps > speed_factor * _SPIN).any(-1)
    if file.joints is not None:
        fast = fast | (
            file.joints.diff(dim=0).norm(dim=-1) * motion.fps > speed_factor * _JUMP
        ).any(-1)
    return fast.numpy()
