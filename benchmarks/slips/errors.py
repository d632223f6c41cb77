"""How wrong a fit is, by what a slip spoils."""

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.slips.kinds import Measure
from benchmarks.slips.recordings import Recording
from recon import metrics
from recon.clip import ClipFit
from recon.motion import Motion
from recon.skeleton import MIRROR, joint_index

Joints = Float[Tensor, "time 22 3"]


def error(
    found: ClipFit, recording: Recording, measure: Measure, joints: tuple[str, ...], clip: int = 0
) -> float:
    """Of one clip of a fit: metres, or for speeds the factor by which they are wrong."""
    return motion_error(_in_true_world(found, recording, clip), recording, measure, joints)


def motion_error(
    motion: Motion, recording: Recording, measure: Measure, joints: tuple[str, ...] = ()
) -> float:
    """The same of a motion in the true world, one clip without batch axis."""
    own, true = (recording.body.pose(m).joints for m in (motion, recording.truth))
    if measure == "speed":
        ratio = _speed(own, motion.fps) / _speed(true, recording.truth.fps)
        return max(ratio, 1 / ratio)
    own = recording.body.pose(_at_moments_of(motion, recording.truth)).joints
    if measure == "posture":
        return min(_posture_error(own, true), _posture_error(own, mirror_image(true)))
    if measure == "pelvis":
        own, true = metrics.root_aligned(own), metrics.root_aligned(true)
    elif measure == "path":
        own, true = own - own[:1, :1], true - true[:1, :1]
    chosen = [joint_index(name) for name in joints] or list(range(22))
    return metrics.point_errors(own, true)[:, chosen].mean().item()


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


def _posture_error(own: Joints, true: Joints) -> float:
    return metrics.point_errors(rigidly_aligned(own, true), true).mean().item()


def _in_true_world(found: ClipFit, recording: Recording, clip: int) -> Motion:
    """One clip's motion, brought from the world that was found to the true one.

    Where the ground is known both are the same; where it is not, the recording's frame tells.
    """
    motion = found.result.clip(clip).detach().to(device="cpu")
    if found.ground_known:
        return motion
    T = recording.T_world_recording @ torch.linalg.inv(found.T_world_recording[clip].float())
    return motion.carried(T, recording.body.rest_joints(motion.shape)[0])


def _at_moments_of(motion: Motion, truth: Motion) -> Motion:
    """The motion at the truth's times; beyond its ends it stands still."""
    last = motion.start_time + (motion.frames - 1) / motion.fps
    return motion.at(truth.times.clamp(motion.start_time, last), truth.fps)


def _speed(joints: Joints, fps: float) -> float:
    """Mean speed of all joints, m/s."""
    return joints.diff(dim=0).norm(dim=-1).mean().item() * fps
