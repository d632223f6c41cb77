"""A network's motion as a measurement: which parts are trusted, and with what noise."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.estimated import ErrorCovariance, EstimatedPoints
from observations.noise import estimate_noise
from recon.body.landmarks import KEYPOINTS_43, landmark
from recon.body.model import BodyModel
from recon.core.coordinates import notes_on_missing_path
from recon.core.motion import Motion
from recon.core.skeleton import FEET, JOINTS, MIRROR
from recon.diagnosis.findings import Finding, Findings, stretches
from recon.solver.viterbi import cheapest_path

_SWITCH = 0.18
"""Root mean square angle over the joints of both limbs, radians, whose square a change of sides
costs. It and the next number are chosen on validation windows: of frames whose legs are exchanged
by more than 0.3 radians nine in ten are found, and no motion is blamed that is as it should be."""
_STAY = 0.005
"""Cost of an exchanged frame, radians², so that the sides held most of the time are right."""

_FLIP = torch.tensor([-1.0, 1.0, 1.0])


def exchanged_frames(
    rotations: Float[Tensor, "time joints 3 3"], mirrored: Float[Tensor, "time joints 3 3"]
) -> Bool[Tensor, " time"]:
    """Frames in which left and right limbs seem exchanged: exchanging them makes motion smoother.

    The sides of every frame are chosen together so that Σ ½ |angle|² from frame to frame is
    least, plus what changes of sides and exchanged frames cost (Viterbi's algorithm).

    Args:
        rotations: local rotations of both limbs' joints.
        mirrored: the same with the limbs exchanged.
    """
    both = torch.stack((rotations, mirrored), 1).double()
    # axes: time, hypothesis of the frame, hypothesis of the frame before, joints, 3, 3
    step = both[1:, :, None] - both[:-1, None, :]
    squared = step.square().sum((-1, -2)).mean(-1) / 2  # radians², for small angles
    switch = _SWITCH**2 * (1 - torch.eye(2, dtype=torch.float64))
    here = both.new_tensor([0.0, _STAY]).expand(len(both), 2)
    return cheapest_path(here[None], (squared + switch).mT)[0].bool()


def mirrored_limbs(motion: Motion, joints: tuple[int, ...]) -> Float[Tensor, "time joints 3 3"]:
    """Local rotations of both limbs' joints with left and right exchanged."""
    flip = _FLIP.to(motion.rotations)
    other = [MIRROR[joint] for joint in joints]
    return flip[:, None] * motion.rotations[:, other] * flip


FASTEST = 60.0
"""Hz; estimates at higher rates are thinned to it."""
OWN = ErrorCovariance(jitter=0.015, slow=0.06, seconds=1.0)
"""Error of a point relative to the path of the body, as networks on video make it. The numbers are
chosen on windows of validation people and on martial arts, runs and climbs of training people
(benchmarks/refine.py): numbers that suit walks alone let a prior that never saw a handspring
overrule it. Estimates with smaller errors get a share of it; the jitter is the least assumed."""
PATH = ErrorCovariance(jitter=0.003, slow=0.06, seconds=2.0)
"""Error of the path."""
_ALIKE = 2.0
"""Points of one limb err together, so that the jitter estimated from one point is
multiplied."""
_LIMITS = (0.004, 0.05)
"""Least and largest jitter that is estimated, metres."""
_JUMP, _TIMES = 0.01, 4.0
"""A point jumps where its step differs from those before and after by more than so many metres
and so many times as much as usual."""
_STAND_S, _STANDS = 0.25, 0.2
"""Seconds over which feet are averaged, and share of the frames in which at least one foot stands
even in runs and jumps."""
_JITTER, _SLIDE = (0.0007, 0.0022), (0.05, 0.11)
"""Jitter of points in metres, and speed of standing feet in m/s: of motion capture, whose errors
count as none, and of networks on video. Chosen on windows of training people."""
_LEAST = 0.05
"""Least share of the usual errors that is assumed."""
_LIMBS = {
    "legs": ("hip", "knee", "ankle", "foot"),
    "arms": ("collar", "shoulder", "elbow", "wrist"),
}


def as_measurement(
    motion: Motion, known: Bool[Tensor, " time"], body: BodyModel
) -> tuple[EstimatedPoints, Motion, Findings]:
    """A network's motion as observed points: their noise, how long errors last, where they jump.

    Args:
        motion: the estimate in a world with z up, of a shape of this body; no leading axis.
        known: frames that were estimated.
        body: whose motion it is.

    Returns:
        Points of the skin with their covariance, with a leading axis of one clip; the estimate
        with its exchanges of limbs undone; and what was repaired, or is to be warned of.
    """
    step = max(round(motion.fps / FASTEST), 1)
    if step > 1:
        rows = torch.arange(0, motion.frames, step)
        motion = motion.replace(
            translation=motion.translation[rows], rotations=motion.rotations[rows],
            valid=motion.valid[rows], fps=motion.fps / step,
        )  # fmt: skip
        known = known[rows]
    motion, repairs = _sides_corrected(motion)
    vertices = tuple(landmark(name) for name in KEYPOINTS_43)
    points = body.pose(motion).points(torch.tensor(vertices)).detach()
    visible = known[:, None].expand(points.shape[:-1])
    path = points.mean(-2, keepdim=True)
    share = _relative_error(motion, known, body, points - path)
    limits = (share * _LIMITS[0], _LIMITS[1])
    jitter = _ALIKE * estimate_noise(points - path, visible, limits)
    along = _ALIKE * estimate_noise(path, visible[:, :1], limits)
    seen = EstimatedPoints(
        positions=points.where(visible[..., None], 0.0)[None],
        visible=visible[None].clone(),
        vertices=vertices,
        own=replace(OWN, jitter=max(share * OWN.jitter, jitter), slow=share * OWN.slow),
        path=replace(PATH, jitter=max(share * PATH.jitter, along), slow=share * PATH.slow),
        fps=motion.fps,
        segment=_segments_between_jumps(points - path)[None],
        start_time=motion.start_time,
    )
    alone = notes_on_missing_path(
        motion.translation[known].numpy(), motion.rotations[known].numpy()
    )
    return seen, motion, Findings(repairs, [Finding("no path", alone)] if alone else ())


def _relative_error(
    motion: Motion,
    known: Bool[Tensor, " time"],
    body: BodyModel,
    points: Float[Tensor, "time points 3"],
) -> float:
    """Errors of a motion relative to those that networks usually make on video, at most 1.

    Two things tell that an estimate is noisy: points jitter about the path, and no foot ever
    stands. Where too few frames are known to see it, the share is 1.
    """
    frames = max(round(_STAND_S * motion.fps), 1)
    feet = body.pose(motion).joints.detach()[:, list(FEET)]
    if len(feet) < 3 * frames:
        return 1.0
    slides = feet.unfold(0, frames, 1).mean(-1).diff(dim=0).norm(dim=-1) * motion.fps
    slides = slides[known.unfold(0, frames + 1, 1).all(-1)]
    if len(slides) < frames:
        return 1.0
    still = float(slides.amin(-1).quantile(_STANDS))
    jitter = estimate_noise(points, known[:, None].expand(points.shape[:-1]), (0.0, 1.0))
    shares = [(x - a) / (b - a) for x, (a, b) in ((jitter, _JITTER), (still, _SLIDE))]
    return min(max(*shares, _LEAST), 1.0)


def _sides_corrected(motion: Motion) -> tuple[Motion, list[Finding]]:
    """The motion with left and right limbs exchanged back, and the repairs."""
    rotations, repairs = motion.rotations.clone(), list[Finding]()
    for limb, parts in _LIMBS.items():
        joints = tuple(
            JOINTS.index(f"{side}_{part}") for part in parts for side in ("left", "right")
        )
        mirrored = mirrored_limbs(motion, joints)
        wrong = exchanged_frames(motion.rotations[:, list(joints)], mirrored)
        if bool(wrong.any()):
            own = rotations[:, list(joints)]
            rotations[:, list(joints)] = mirrored.where(wrong[:, None, None, None], own)
            times = wrong.nonzero()[:, 0] / motion.fps + motion.start_time
            repairs.append(
                Finding(
                    "sides exchanged",
                    f"left and right {limb} are exchanged in {int(wrong.sum())} frames between "
                    f"{float(times[0]):.2f} and {float(times[-1]):.2f} s; put right",
                    frames=stretches(wrong.numpy()),
                    value=float(wrong.sum()),
                )
            )
    return motion.replace(rotations=rotations), repairs


def _segments_between_jumps(
    points: Float[Tensor, "time points 3"],
) -> Float[Tensor, "time points"]:
    """For every point and frame, the index of the segment between two jumps that contains it."""
    none = points.new_zeros(points.shape[:-1])
    if len(points) < 4:
        return none
    steps = points.diff(dim=0)
    usual = torch.cat((steps[1:2], (steps[2:] + steps[:-2]) / 2, steps[-2:-1]))
    away = (steps - usual).norm(dim=-1)
    around = torch.nn.functional.max_pool1d(away.mT[None], 3, 1, 1)[0].mT
    jumps = (away > _JUMP + _TIMES * away.median(0).values) & (away >= around)
    none[1:] = jumps.to(points).cumsum(0)
    return none
