"""What is seen of windows in each protocol of `benchmarks.rollout_fits`, and how it is fitted."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.cameras import CASES, batch_of, to_true_world
from benchmarks.converged import Protocol as Seen
from benchmarks.converged import protocols as in_space
from observations.markers3d import Markers3D
from recon.benchmark.protocols import noisy_joints
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.core.camera import depth_camera
from recon.core.struct import concatenate
from recon.fitting.clip import fit_clip
from recon.fitting.methods import FitOptions, method_of
from recon.method.reconstruction import Reconstruction, solve
from recon.reading.clouds import cloud_of
from recon.simulation.depth import depth_points
from recon.simulation.images import dome
from recon.simulation.points import Corruption

SEED = 0
JOINT_NOISE = 0.04
"""Metres per coordinate of noisy joints."""


@dataclass(frozen=True)
class Fit:
    """A batch of fitted windows beside the truth."""

    result: Reconstruction
    joints: Float[Tensor, "clips time 22 3"]
    """Joints that were found, in the frame in which they are compared, metres."""
    truth: Float[Tensor, "clips time 22 3"]
    hidden: Float[Tensor, "clips numbers"]
    """Errors of the points or joints that were not seen, metres."""
    unseen: Bool[Tensor, "clips numbers"]
    """Which of `hidden` were not seen."""


Protocol = Callable[[TrueWindows, FitOptions, BodyModel, int], Fit]
"""Fits windows with some options; the number is that of the first window in the list."""


def compared(windows: TrueWindows, seen: Seen, result: Reconstruction, body: BodyModel) -> Fit:
    """Fitted points or joints of space beside the truth."""
    truth, joints = body.pose(windows.truth).joints, result.body.joints.detach()
    if isinstance(seen.observed, Markers3D):
        away = seen.observed.predict(result.estimate).detach() - seen.points
        visible = seen.observed.visible
    else:
        away = joints - truth
        visible = torch.zeros(truth.shape[:-1], dtype=torch.bool)
        visible[..., list(seen.observed.joints)] = seen.observed.visible
    return Fit(result, joints, truth, away.norm(dim=-1).flatten(1), ~visible.flatten(1))


def _in_space(name: str) -> Protocol:
    """A protocol of points in space, whose noise is told (`benchmarks.converged`)."""

    def fit(windows: TrueWindows, options: FitOptions, body: BodyModel, _: int) -> Fit:
        seen = in_space(windows, body)[name]
        result = solve([seen.observed], method_of(options, seen.noise, body), body)
        return compared(windows, seen, result, body)

    return fit


def _filmed(case: str) -> Protocol:
    """A protocol of `benchmarks.cameras`; joints about the pelvis, in the true world."""

    def fit(windows: TrueWindows, options: FitOptions, body: BodyModel, first: int) -> Fit:
        rows = range(len(windows.names))
        filmed = batch_of([CASES[case](windows.truth[k], body, first + k) for k in rows])
        fitted = fit_clip(filmed.observations, options, body)
        motion = fitted.result.motion.detach()
        pelvis = body.rest_joints(motion.shape)[:, 0]
        there = motion.carried(to_true_world(filmed, fitted.T_world_recording), pelvis)
        joints, truth = (body.pose(one).joints for one in (there, windows.truth))
        joints, truth = joints - joints[:, :, :1], truth - truth[:, :, :1]
        errors = (joints - truth).norm(dim=-1)
        unseen = ~filmed.visible.bool()
        return Fit(fitted.result, joints, truth, errors.flatten(1), unseen.flatten(1))

    return fit


def _depth_and_joints(
    windows: TrueWindows, options: FitOptions, body: BodyModel, first: int
) -> Fit:
    """Noisy joints beside the points of a calibrated depth sensor; the ground is known."""
    clouds = []
    for k in range(len(windows.names)):
        truth = windows.truth[k]
        [camera] = dome(truth, body, depth_camera(), 1, first=2.4 * (first + k))
        file = depth_points(truth, body, camera, Corruption(), first + k)
        clouds.append(cloud_of(file, body, seed=first + k).cloud)
    joints = noisy_joints(windows.truth, body, SEED, JOINT_NOISE)
    result = fit_clip([joints, concatenate(clouds)], options, body).result
    return compared(windows, Seen(joints, JOINT_NOISE, joints.positions), result, body)


IN_SPACE = ("noisy joints", "hidden points", "in-betweening", "upper body")
PROTOCOLS: Mapping[str, Protocol] = {
    **{name: _in_space(name) for name in IN_SPACE},
    "one camera": _filmed("one camera"),
    "one camera, posed": _filmed("one camera, posed"),
    "three views": _filmed("three views"),
    "keypoints and depth": _filmed("2D + depth"),
    "joints and depth": _depth_and_joints,
}
