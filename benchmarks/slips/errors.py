"""How wrong a fit is, by what a slip spoils."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.slips.kinds import Measure, Slip
from benchmarks.slips.recordings import Recording
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, MIRROR, joint_index
from recon.fitting.fitted import ClipFit
from recon.metrics import errors as metrics

Joints = Float[Tensor, "time 22 3"]
Counted = Bool[Tensor, "time 22"]
"""Joints and frames whose errors count."""
_MOST = 0.5


def error(
    found: ClipFit,
    recording: Recording,
    measure: Measure,
    counted: Counted,
    clip: int = 0,
) -> float:
    """Error of one clip of a fit: metres, or for speeds the factor by which they are wrong."""
    return motion_error(_in_true_world(found, recording, clip), recording, measure, counted)


def motion_error(
    motion: Motion, recording: Recording, measure: Measure, counted: Counted
) -> float:
    """Error of a motion in the true world, one clip without batch axis."""
    own, true = (recording.body.pose(m).joints for m in (motion, recording.truth))
    if measure == "speed":
        ratio = _speed(own, motion.fps) / _speed(true, recording.truth.fps)
        return max(ratio, 1 / ratio)
    own = recording.body.pose(_at_moments_of(motion, recording.truth)).joints
    if measure == "posture":
        alike = [_posture_errors(own, image) for image in (true, mirror_image(true))]
        return min(errors[counted].mean().item() for errors in alike)
    if measure == "pelvis":
        own, true = metrics.root_aligned(own), metrics.root_aligned(true)
    elif measure == "path":
        own, true = own - own[:1, :1], true - true[:1, :1]
    return metrics.point_errors(own, true)[counted].mean().item()


def spoiled_samples(slip: Slip, frames: int) -> Counted:
    """The joints that a slip spoils, in all frames."""
    chosen = torch.zeros(frames, len(JOINTS), dtype=torch.bool)
    chosen[:, [joint_index(name) for name in slip.joints or JOINTS]] = True
    return chosen


def claimed_samples(slip: Slip, observed: Bool[np.ndarray, "time 22"], frames: int) -> Counted:
    """Samples that the fit does not declare to be inferred.

    Where it declares most of what the slip spoils to be inferred, the rest of the body is judged,
    and the whole body where it declares most of that.
    """
    spoiled = spoiled_samples(slip, frames)
    if observed.shape != spoiled.shape:
        return spoiled
    seen = torch.from_numpy(observed)
    for chosen in (spoiled, torch.ones_like(spoiled)):
        if (chosen & seen).sum() >= _MOST * chosen.sum():
            return chosen & seen
    return torch.ones_like(spoiled)


def mirror_image(joints: Joints) -> Joints:
    """The joints of a person who does the same on the other side."""
    return joints[:, list(MIRROR)] * joints.new_tensor([-1.0, 1.0, 1.0])


def rigidly_aligned(points: Joints, target: Joints) -> Joints:
    """Every frame's points after the rotation and shift that bring them nearest to the target."""
    middle, goal = points.mean(-2, keepdim=True), target.mean(-2, keepdim=True)
    u, _, vh = torch.linalg.svd((target - goal).mT @ (points - middle))
    sign = torch.ones_like(u[..., 0])
    sign[..., -1] = torch.linalg.det(u @ vh)
    turn = (u * sign[..., None, :]) @ vh
    return (points - middle) @ turn.mT + goal


def _posture_errors(own: Joints, true: Joints) -> Float[Tensor, "time 22"]:
    return metrics.point_errors(rigidly_aligned(own, true), true)


def _in_true_world(found: ClipFit, recording: Recording, clip: int) -> Motion:
    """One clip's motion, brought from the world that was found to the true one.

    Points in space have their z axis up: of the world only the height of the ground is found,
    which is the true ground's. With cameras, the first camera's pose tells.
    """
    motion = found.result.clip(clip).detach().to(device="cpu")
    if found.ground_known or len(recording.cameras) == 0:
        return motion
    T = recording.T_world_recording @ torch.linalg.inv(found.T_world_recording[clip].float())
    return motion.carried(T, recording.body.rest_joints(motion.shape)[0])


def _at_moments_of(motion: Motion, truth: Motion) -> Motion:
    """The motion at the truth's times; beyond its ends it stands still."""
    return motion.at(truth.times.clamp(motion.start_time, motion.stop_time), truth.fps)


def _speed(joints: Joints, fps: float) -> float:
    """Mean speed of all joints, m/s."""
    return joints.diff(dim=0).norm(dim=-1).mean().item() * fps
