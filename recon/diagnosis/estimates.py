"""Turns a network's estimate of a motion into measured points with noise, for a fit."""

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

_SWITCH_RAD = 0.18
"""Angle (rad, root mean square over the joints of both limbs) whose square is the cost of a change
of sides. It and the next number were chosen on validation windows: of frames whose legs are
exchanged by more than 0.3 rad nine in ten are found, and no correct motion is changed."""
_EXCHANGED_COST = 0.005
"""Cost (rad²) of an exchanged frame, by which the sides of most frames are taken as right."""

_FLIP = torch.tensor([-1.0, 1.0, 1.0])


def exchanged_frames(
    rotations: Float[Tensor, "time joints 3 3"], mirrored: Float[Tensor, "time joints 3 3"]
) -> Bool[Tensor, " time"]:
    """Return a mask of frames where exchanging left and right limbs makes the motion smoother.

    The sides of all frames are chosen together so that Σ ½ |angle|² from frame to frame, plus the
    costs of changes of sides and of exchanged frames, is least (Viterbi's algorithm).

    Args:
        rotations: local rotations of both limbs' joints.
        mirrored: the same with the limbs exchanged.
    """
    both = torch.stack((rotations, mirrored), 1).double()
    # axes: time, exchanged or not, the frame before exchanged or not, joints, 3, 3
    step = both[1:, :, None] - both[:-1, None, :]
    squared = step.square().sum((-1, -2)).mean(-1) / 2  # squared angle (radians²), if it is small
    switch = _SWITCH_RAD**2 * (1 - torch.eye(2, dtype=torch.float64))
    here = both.new_tensor([0.0, _EXCHANGED_COST]).expand(len(both), 2)
    return cheapest_path(here[None], (squared + switch).mT)[0].bool()


def mirrored_limbs(motion: Motion, joints: tuple[int, ...]) -> Float[Tensor, "time joints 3 3"]:
    """Return local rotations of both limbs' joints with left and right exchanged."""
    flip = _FLIP.to(motion.rotations)
    other = [MIRROR[joint] for joint in joints]
    return flip[:, None] * motion.rotations[:, other] * flip


FASTEST = 60.0
"""Frame rate (Hz) to which estimates with higher rates are thinned."""
OWN = ErrorCovariance(jitter=0.015, slow=0.06, seconds=1.0)
"""Error covariance of a point relative to the mean of all points, as of networks on video. Chosen
on windows of validation people and on martial arts, runs and climbs of training people
(benchmarks/refine.py): values that suit walks alone let a prior that never saw a handspring
overrule it. Better estimates get a share of these errors; the jitter is a lower bound."""
PATH = ErrorCovariance(jitter=0.003, slow=0.06, seconds=2.0)
"""Error covariance of the path, which is the mean position of all points over time."""
_JITTER_FACTOR = 2.0
"""Factor on the jitter that is estimated per point, as points of one limb err together."""
_JITTER_LIMITS_M = (0.004, 0.05)
"""Least and largest jitter (m) that is estimated."""
_JUMP_M, _JUMP_RATIO = 0.01, 4.0
"""A point jumps where its step differs from the mean of the steps before and after by more than
this distance (m) plus this multiple of the usual difference."""
_STAND_S, _STANDING_SHARE = 0.25, 0.2
"""Time (s) over which positions of feet are averaged, and share of the frames in which at least
one foot stands even in runs and jumps."""
_JITTER_M, _SLIDE_M_S = (0.0007, 0.0022), (0.05, 0.11)
"""Jitter of points (m) and speed of standing feet (m/s): first of motion capture, whose errors
count as none, then of networks on video. Chosen on windows of training people."""
_MIN_ERROR_SHARE = 0.05
"""Least share of the errors `OWN` and `PATH` that is assumed."""
_LIMBS = {
    "legs": ("hip", "knee", "ankle", "foot"),
    "arms": ("collar", "shoulder", "elbow", "wrist"),
}


def as_measurement(
    motion: Motion, known: Bool[Tensor, " time"], body: BodyModel
) -> tuple[EstimatedPoints, Motion, Findings]:
    """Convert a network's motion to points to be fitted, with estimates of their noise and jumps.

    Args:
        motion: estimated motion, z up, of a shape of this body; without a batch axis.
        known: frames that were estimated.
        body: body model of the motion.

    Returns:
        Points of the skin with their covariance, with a leading axis of one clip; the estimate
        with exchanged limbs put right; and repairs and warnings.
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
    limits = (share * _JITTER_LIMITS_M[0], _JITTER_LIMITS_M[1])
    jitter = _JITTER_FACTOR * estimate_noise(points - path, visible, limits)
    along = _JITTER_FACTOR * estimate_noise(path, visible[:, :1], limits)
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
    """Return the errors of a motion relative to those of networks on video, from 0.05 to 1.

    Two signs show that an estimate is noisy: points jitter about the path, and no foot ever
    stands. Where too few frames are known to tell, the result is 1.
    """
    frames = max(round(_STAND_S * motion.fps), 1)
    feet = body.pose(motion).joints.detach()[:, list(FEET)]
    if len(feet) < 3 * frames:
        return 1.0
    slides = feet.unfold(0, frames, 1).mean(-1).diff(dim=0).norm(dim=-1) * motion.fps
    slides = slides[known.unfold(0, frames + 1, 1).all(-1)]
    if len(slides) < frames:
        return 1.0
    still = float(slides.amin(-1).quantile(_STANDING_SHARE))
    jitter = estimate_noise(points, known[:, None].expand(points.shape[:-1]), (0.0, 1.0))
    shares = [(x - a) / (b - a) for x, (a, b) in ((jitter, _JITTER_M), (still, _SLIDE_M_S))]
    return min(max(*shares, _MIN_ERROR_SHARE), 1.0)


def _sides_corrected(motion: Motion) -> tuple[Motion, list[Finding]]:
    """Return the motion with exchanged left and right limbs put right, and the repairs."""
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
    """Return, per point and frame, the index of the segment between two jumps."""
    none = points.new_zeros(points.shape[:-1])
    if len(points) < 4:
        return none
    steps = points.diff(dim=0)
    usual = torch.cat((steps[1:2], (steps[2:] + steps[:-2]) / 2, steps[-2:-1]))
    away = (steps - usual).norm(dim=-1)
    around = torch.nn.functional.max_pool1d(away.mT[None], 3, 1, 1)[0].mT
    jumps = (away > _JUMP_M + _JUMP_RATIO * away.median(0).values) & (away >= around)
    none[1:] = jumps.to(points).cumsum(0)
    return none
