"""Estimates scale and error correlation of one view from a first, rough motion.

The scale is the person's size over a known ground, or the unit of a camera's path. The first
motion is fitted by the pose prior, which needs no ground.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from observations.camera_paths import with_path_in_metres
from observations.keypoints2d import Keypoints2D
from recon.body.model import BodyModel
from recon.body.soles import ground_heights
from recon.core.motion import Motion
from recon.core.residuals import NORMAL_MAD
from recon.core.skeleton import joint_index
from recon.method.protocols import REFERENCE_FPS, Estimate

_TOE_JOINTS = [joint_index("left_foot"), joint_index("right_foot")]
_MAX_FACTOR = 1.5
"""Factor by which first sizes may be wrong; beyond it, camera and ground contradict."""
_MIN_CORRELATION = 0.1
"""Correlation in time below which it, and those at longer lags, are taken as zero."""
_MAX_REPETITION = 4.0
"""Largest repetition: that of real detectors is at most 3, of simulated ones 3.6; what lasts
longer is an error of the model's, such as a cartwheel's first motion, not a detector's."""
_REPETITION_GAIN = 3.0
"""Ratio of the excess of the errors' repetition over 1 to that of the residuals', as a fitted
motion follows lasting errors; chosen on simulated errors of BlazePose's size and duration,
validation people."""
_OUTLIER_STDS = 3.0
_UNFOLLOWED = 2.0
"""Ratio of a frame's mean squared residual to the median frame's above which the motion does not
follow its data, as in a cartwheel: 3 to 4 standard deviations for 17 to 33 keypoints."""


def correlated_frames(
    errors: Float[Tensor, "*batch time points dims"],
    visible: Bool[Tensor, "*batch time points"],
    noise: float,
    rate: float = 1.0,
) -> float:
    """Return the number of correlated frames that tell as much as one with independent errors.

    The mean of N frames of errors with standard deviation s and correlations ρ_k at lags of k
    frames has the variance s² (1 + 2 Σ ρ_k) / N, that of white noise σ² / N. Their quotient,
    computed for the residuals, exceeds 1 by a third of what that of the errors does, since a
    motion follows a part of the errors; the result, from 1 to 4, is corrected for this.
    `estimate_noise` does not see lasting errors, because bodies move as slowly: detectors of
    keypoints err by 1 to 2 cm for a sixth of a second. Constant errors of a point are left out,
    and so are frames that the motion does not follow: there, the model errs, not the detector.

    Args:
        errors: residuals of every coordinate, measured minus fitted.
        visible: mask of the points that count.
        noise: σ, the standard deviation of white noise.
        rate: number of frames that the energy counts per frame of data, as 0.5 for data at 60 Hz.
    """
    visible = visible & _followed_frames(errors, visible)
    shown = visible[..., None].to(errors)
    count = shown.sum(-3, keepdim=True).clamp(min=1)
    away = (errors - (errors * shown).sum(-3, keepdim=True) / count) * shown
    if not bool(visible.any()):
        return 1.0
    limit = _OUTLIER_STDS * away.abs()[visible].median() / NORMAL_MAD
    away = away.clamp(-limit, limit)
    variance = float(away.square().sum() / (shown.sum() * away.shape[-1]))
    if not variance > 0:
        return 1.0
    repeated = 1.0
    for lag in range(1, away.shape[-3] // 2):
        both = shown[..., lag:, :, :] * shown[..., :-lag, :, :]
        product = away[..., lag:, :, :] * away[..., :-lag, :, :]
        correlation = float(product.sum() / (both.sum() * away.shape[-1]).clamp(min=1)) / variance
        if correlation < _MIN_CORRELATION:
            break
        repeated += 2 * correlation
    excess = variance / noise**2 * repeated * rate - 1
    return min(1 + _REPETITION_GAIN * max(excess, 0.0), _MAX_REPETITION)


def _followed_frames(
    errors: Float[Tensor, "*batch time points dims"], visible: Bool[Tensor, "*batch time points"]
) -> Bool[Tensor, "*batch time 1"]:
    """Return whether the motion follows a frame's data about as well as those of most frames."""
    seen = errors.where(visible[..., None], torch.nan)
    away = seen - seen.nanmedian(-3, keepdim=True).values
    squared = away.square().nanmean((-1, -2))
    return (squared <= _UNFOLLOWED * squared.nanmedian(-1, keepdim=True).values)[..., None]


def correlated_view_frames(view: Keypoints2D, estimate: Estimate, noise: float) -> float:
    """Return `correlated_frames` of a view's residuals about a fitted motion; noise in pixels."""
    with torch.no_grad():
        residuals = view.residuals(estimate)
    errors = residuals.values * residuals.weights[..., None]
    return correlated_frames(errors, residuals.seen, noise, REFERENCE_FPS / view.fps)


def scaled_onto_ground(motion: Motion, view: Keypoints2D, body: BodyModel) -> Motion:
    """Return the motion scaled about the camera so that it stands on the ground z = 0.

    What a camera sees does not change when everything is scaled about its centre.
    """
    eye = view.camera.T_world_camera[..., :3, 3].mean(-2)
    factor = eye[:, 2] / (eye[:, 2] - ground_heights(motion, body))
    factor = torch.where((factor > 1 / _MAX_FACTOR) & (factor < _MAX_FACTOR), factor, 1.0)
    pelvis = body.rest_joints(motion.shape)[:, 0]
    place = motion.translation + (pelvis - eye)[:, None]
    return motion.replace(translation=place * factor[:, None, None] - (pelvis - eye)[:, None])


def scaled_to_feet(
    view: Keypoints2D, motion: Motion, body: BodyModel
) -> tuple[Keypoints2D, Motion] | None:
    """Scale the camera's path to metres by standing feet, and move the motion with the camera.

    The result is None where the motion does not cover the view.
    """
    feet = body.pose(motion).joints[..., _TOE_JOINTS, :]
    there, _ = view.at_own_times(feet, motion)
    if there.shape[-3] < view.moments:
        return None
    found = with_path_in_metres(view, view.camera.to_camera(there).detach().double().numpy())
    moved = found.camera.T_world_camera[..., :3, 3] - view.camera.T_world_camera[..., :3, 3]
    if motion.frames == view.moments:
        motion = motion.replace(translation=motion.translation + moved)
    return found, motion
