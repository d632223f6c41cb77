"""Judges fits of clips with slips: errors of the joints concerned, and reported findings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

import recon
from benchmarks.cameras import in_true_world
from benchmarks.slips.kinds import Measure, Slip
from benchmarks.slips.recordings import Recording
from recon import Motion
from recon.core import rotations as so3
from recon.core.skeleton import JOINTS, MIRROR, joint_index
from recon.diagnosis.findings import Finding
from recon.metrics import errors as metrics

AS_GOOD = 1.2
"""Ratio to the error of the clean clip's fit, up to which a fit is repaired."""
CONSEQUENCES = frozenset({"unseen", "gap"})
"""Codes of missing data, which follow from repairs and name no cause."""
_MIN_SEEN_SHARE = 0.5

Joints = Float[Tensor, "time 22 3"]
Counted = Bool[Tensor, "time 22"]
"""Mask of the joints and frames whose errors count."""


@dataclass(frozen=True)
class Verdict:
    """The outcome for one clip with a slip: errors, and whether findings were given and right."""

    clip: str
    clean: float
    """Error of the fit without the slip, in the slip's measure."""
    error: float
    """Error of the fit with it, over joints that the fit does not declare to be inferred."""
    warned: bool
    silent: bool
    """Whether there was no finding, neither repair nor warning."""
    named: bool
    """Whether one of the codes names the cause correctly."""

    @property
    def as_good(self) -> bool:
        """Whether the fit is as good as the clean clip's."""
        return self.error <= AS_GOOD * self.clean

    @property
    def caught(self) -> bool:
        """Whether the user gets a right result or is told that it may be wrong."""
        return self.as_good or self.warned

    @property
    def judged(self) -> bool:
        """Whether there is a cause to name: a slip that does no harm need not be found."""
        return not (self.as_good and self.silent)


def slipped(slip: Slip, recording: Recording, clean: recon.Result, prior: str) -> Verdict:
    """Fit one clip with a slip, and compare it with the fit of the clean clip."""
    found = recon.fit(slip.spoil(recording, slip.size), prior, body=recording.body)
    claimed = claimed_samples(slip, found.observed.numpy(), recording.truth.frames)
    before, after = (
        motion_error(truly_placed(result, recording), recording, slip.measure, claimed)
        for result in (clean, found)
    )
    return verdict_of(slip, recording.name, before, after, found.repairs, found.warnings)


def verdict_of(
    slip: Slip, clip: str, clean: float, error: float,
    repairs: Sequence[Finding], warnings: Sequence[Finding],
) -> Verdict:  # fmt: skip
    """Judge the findings of one clip by the slip's right codes."""
    causes = [f.code for f in (*repairs, *warnings) if f.code not in CONSEQUENCES]
    named = any(code in slip.codes for code in causes)
    return Verdict(clip, clean, error, len(warnings) > 0, len(repairs) + len(warnings) == 0, named)


def truly_placed(result: recon.Result, recording: Recording) -> Motion:
    """Return the motion in the true world, by way of the true camera if its pose was found."""
    if len(recording.cameras) == 0:
        return result.motion
    return in_true_world(result, recording.cameras[0].T_world_camera, recording.body)[0]


def motion_error(
    motion: Motion, recording: Recording, measure: Measure, counted: Counted
) -> float:
    """Return the error of a motion in the true world (m), or the factor of wrong speed."""
    own, true = (recording.body.pose(m).joints for m in (motion, recording.truth))
    if measure == "speed":
        ratio = _speed(own, motion.fps) / _speed(true, recording.truth.fps)
        return max(ratio, 1 / ratio)
    # poses at the truth's times; outside its own time the motion keeps its first or last pose
    times = recording.truth.times.clamp(motion.start_time, motion.stop_time)
    own = recording.body.pose(motion.at(times, recording.truth.fps)).joints
    if measure == "posture":
        alike = [
            metrics.point_errors(rigidly_aligned(own, image), image)
            for image in (true, mirror_image(true))
        ]
        return min(errors[counted].mean().item() for errors in alike)
    if measure == "pelvis":
        own, true = metrics.root_aligned(own), metrics.root_aligned(true)
    elif measure == "path":
        own, true = own - own[:1, :1], true - true[:1, :1]
    return metrics.point_errors(own, true)[counted].mean().item()


def spoiled_samples(slip: Slip, frames: int) -> Counted:
    """Return a mask of the joints that a slip spoils, in all frames."""
    chosen = torch.zeros(frames, len(JOINTS), dtype=torch.bool)
    chosen[:, [joint_index(name) for name in slip.joints or JOINTS]] = True
    return chosen


def claimed_samples(slip: Slip, observed: Bool[np.ndarray, "time 22"], frames: int) -> Counted:
    """Return a mask of the samples that the fit does not declare to be inferred.

    These are samples that the slip spoils; if most of them are declared to be inferred, those of
    the whole body; and if most of these are, too, all samples.
    """
    spoiled = spoiled_samples(slip, frames)
    if observed.shape != spoiled.shape:
        return spoiled
    seen = torch.from_numpy(observed)
    for chosen in (spoiled, torch.ones_like(spoiled)):
        if (chosen & seen).sum() >= _MIN_SEEN_SHARE * chosen.sum():
            return chosen & seen
    return torch.ones_like(spoiled)


def mirror_image(joints: Joints) -> Joints:
    """Return the joints of a person who moves likewise on the other side."""
    return joints[:, list(MIRROR)] * joints.new_tensor([-1.0, 1.0, 1.0])


def rigidly_aligned(points: Joints, target: Joints) -> Joints:
    """Align every frame's points rigidly with the target."""
    middle, goal = points.mean(-2, keepdim=True), target.mean(-2, keepdim=True)
    turn = so3.nearest_rotation((target - goal).mT @ (points - middle))
    return (points - middle) @ turn.mT + goal


def _speed(joints: Joints, fps: float) -> float:
    """Return the mean speed of all joints (m/s)."""
    return joints.diff(dim=0).norm(dim=-1).mean().item() * fps
