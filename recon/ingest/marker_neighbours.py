"""Fits frames with hidden markers together with their neighbours in time.

Every joint's rotation is a Gaussian process in time (Matérn 3/2) about its mean. The rotation
fitted to a frame's markers is an observation of it, with an inverse covariance that is small where
the joint's markers are hidden; such a frame takes its rotation from its neighbours in time.

Where markers come and go, errors of their offsets matter more than elsewhere: they pull at the
pose in those frames only in which the marker is seen. Offsets are therefore found again, from
poses that are smooth in time.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.derivatives import inverse_right_jacobian
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.ingest.marker_frames import fit_coarsely
from recon.ingest.marker_gaps import interpolated_poses, widened_flags, with_poses
from recon.ingest.marker_poses import PoseEnergies, Poses, SkinPoints, natural_pose
from recon.method.protocols import REFERENCE_FPS

_AROUND = 0.5
"""Seconds before and after a frame with a hidden marker that are fitted together with it."""
_SAMPLED = 20.0
"""Rate (Hz) at which poses about gaps are fitted: joints rotate little in between."""
_PULL = 1e-2
"""Weight of the distance from the pose that neighbours in time suggest."""
_OFTEN = 0.02
"""Share of hidden marker positions above which offsets are found again."""
_ROUNDS = 5
_FURTHER = 1.6
"""Step of an offset over the mean residual; above one, because poses follow their markers."""
_STILL = 2e-4
"""Mean change of the offsets (m) below which the rounds end."""
_MARKER = 0.02
"""Standard deviation (m) of a marker about its fitted position, in each thirtieth of a second. It
exceeds usual residuals, because skin moves slowly, so that errors of frames are correlated."""
_RATE = 6.0
"""√3 over the length scale of the Gaussian process of a joint's rotation, 1 / second."""
_SPREAD = 0.3
"""Standard deviation of a joint's rotation about its mean, radians."""
_MEAN = 1.0
"""Inverse variance of a joint's mean rotation about the natural pose, 1 / radian²."""
_LEAST = 1e-6
_AT_ONCE = 500
"""Number of frames whose Hessians are inverted together, which bounds the memory."""


def frames_about_gaps(visible: Bool[Tensor, "time markers"], fps: float) -> Bool[Tensor, " time"]:
    """Return a mask of frames in or near which a marker is hidden that other frames show."""
    hidden = (~visible & visible.any(0)).any(-1)
    return widened_flags(hidden, max(1, round(_AROUND * fps)))


def fitted_about_gaps(
    energies: PoseEnergies,
    points: Callable[[Tensor], SkinPoints],
    offsets: Float[Tensor, "markers 3"],
    bones: tuple[int, ...],
    motion: Motion,
    keys: Int[Tensor, " keys"],
    near_gaps: Bool[Tensor, " time"],
) -> tuple[PoseEnergies, Tensor, Motion, Int[Tensor, " frames"]]:
    """Fit frames in and around gaps by their markers and the neighbouring frames.

    Returns the energies of all frames, with a pull to the poses that neighbours in time suggest
    about gaps; the offsets of the markers; poses of some frames, and their numbers, ascending.

    Args:
        energies: energies of all frames.
        points: returns the markers as points of the body, given their offsets.
        offsets: of the markers from the skin, in the frames of their bones, metres.
        bones: the bone that moves each marker most.
        motion: poses of key frames.
        keys: numbers of the key frames, ascending.
        near_gaps: frames in and about gaps, if they have enough markers to place a body.
    """
    stride = max(1, round(motion.fps / _SAMPLED))
    sampled = near_gaps.nonzero()[:, 0]
    sampled = sampled[sampled % stride == 0]
    if len(sampled) == 0:
        return energies, offsets, motion, keys
    some, step = energies.frames(sampled), stride / motion.fps
    moments = (sampled - sampled[0]) // stride
    found = fit_coarsely(some, interpolated_poses(motion, keys, sampled))
    hidden = (some.visible == 0) & (some.visible > 0).any(0)
    for _ in range(_ROUNDS if float(hidden.float().mean()) > _OFTEN else 0):
        some = _tied_energies(some, found, moments, step)
        change = _offset_changes(some, found, bones)
        offsets = offsets + change
        some = replace(some, markers=points(offsets))
        found = fit_coarsely(some, found)
        if float(change.norm(dim=-1).mean()) < _STILL:
            break
    some = _tied_energies(some, found, moments, step)
    suggested = found.replace(rotations=torch.cat((found.rotations[:, :1], some.natural), 1))
    everywhere = interpolated_poses(suggested, sampled, torch.arange(len(near_gaps))).rotations[
        :, 1:
    ]
    everything = replace(
        energies,
        markers=some.markers,
        natural=everywhere.where(near_gaps[:, None, None, None], energies.natural),
        pull=some.pull[:1].where(near_gaps, energies.pull),
    )
    frames = torch.cat((keys[~near_gaps[keys]], sampled)).unique()
    rows = torch.searchsorted(frames, sampled)
    start = with_poses(interpolated_poses(motion, keys, frames), rows, found)
    return everything, offsets, start, frames


def _tied_energies(
    energies: PoseEnergies, motion: Motion, moments: Int[Tensor, " frames"], step: float
) -> PoseEnergies:
    """Return the energies with a pull to the rotations that neighbouring frames suggest."""
    natural = _smoothed_rotations(
        energies, energies.poses_of(motion.translation, motion.rotations), moments, step
    )
    return replace(energies, natural=natural, pull=natural.new_full((len(natural),), _PULL))


def _offset_changes(
    energies: PoseEnergies, motion: Motion, bones: tuple[int, ...]
) -> Float[Tensor, "markers 3"]:
    """Return changes (m) of marker offsets towards observed positions; zero for unseen markers."""
    poses = energies.poses_of(motion.translation, motion.rotations)
    force, weight = energies.forces(poses)
    turns = poses.orientations[:, list(bones)]
    away = (turns.mT @ force.mT[..., None])[..., 0].sum(0)
    return -_FURTHER * away / weight.sum(0).clamp(min=_LEAST)[:, None]


def _smoothed_rotations(
    energies: PoseEnergies, poses: Poses, moments: Int[Tensor, " frames"], step: float
) -> Float[Tensor, "frames 21 3 3"]:
    """Smooth joint rotations over time, most where the markers determine them least.

    Args:
        energies: energies of the poses, which are at their minimum.
        poses: fitted poses of some frames.
        moments: times of the frames, in steps.
        step: length of a step, seconds.
    """
    count = step * REFERENCE_FPS / energies.weight
    known = _inverse_covariances(energies, poses) * (count / _MARKER**2)
    natural = natural_pose().to(known)
    away = so3.log(natural.mT @ poses.rotations[:, 1:].to(known))
    told = (known @ away[..., None])[..., 0]
    prior = _MEAN * torch.eye(3).to(known)
    mean = torch.linalg.solve(known.sum(0) + prior, told.sum(0)[..., None])[..., 0]
    turn = mean + _smoothed_over_time(known, away - mean, moments, step)
    return (natural @ so3.exp(turn)).to(poses.rotations)


def _inverse_covariances(energies: PoseEnergies, poses: Poses) -> Float[Tensor, "frames 21 3 3"]:
    """Return the inverse covariance of each joint's rotation, given the markers; m² / radian².

    It is marginal over all other joints: where the markers allow two joints to rotate against each
    other, neither is determined.
    """
    rows = torch.arange(len(poses.translation)).split(_AT_ONCE)
    blocks = torch.cat([_rotation_covariances(energies, poses, some) for some in rows])
    turns = poses.orientations[:, 1:].double()
    variance = turns.mT @ blocks @ turns
    away = so3.log(natural_pose().double().mT @ poses.rotations[:, 1:].double())
    jacobian = inverse_right_jacobian(away)
    pull = (energies.weight * energies.pull.double())[:, None, None, None]
    share, axes = torch.linalg.eigh(pull * jacobian @ variance @ jacobian.mT)
    share = share.clamp(_LEAST, 1 - _LEAST)[..., None, :]
    return pull * (axes * (1 / share - 1)) @ axes.mT


def _rotation_covariances(
    energies: PoseEnergies, poses: Poses, rows: Int[Tensor, " rows"]
) -> Float[Tensor, "rows 21 3 3"]:
    """Return each joint's block of the inverse Hessian, for rotations about the world's axes."""
    curvature = energies.curvature(poses, rows).double()
    curvature.diagonal(dim1=1, dim2=2).add_(_LEAST)
    inverse = torch.cholesky_inverse(torch.linalg.cholesky(curvature))[:, 3:, 3:]
    # coordinates are ordered by axis, then by joint; take the 3 x 3 block of every joint
    blocks = inverse.unflatten(1, (3, -1)).unflatten(3, (3, -1)).diagonal(dim1=2, dim2=4)
    return blocks.permute(0, 3, 1, 2)[:, 1:]


def _smoothed_over_time(
    known: Float[Tensor, "frames 21 3 3"],
    values: Float[Tensor, "frames 21 3"],
    moments: Int[Tensor, " frames"],
    step: float,
) -> Float[Tensor, "frames 21 3"]:
    """Return posterior means of Gaussian processes, given values and their inverse covariances."""
    from scipy.linalg import solveh_banded  # imported only when markers have gaps

    at = moments.numpy()
    time = int(at[-1]) + 1
    process = _precision_band(time, step)
    told = (known @ values[..., None])[..., 0].numpy()
    found = np.zeros((len(at), len(JOINTS) - 1, 3))
    for joint in range(found.shape[1]):
        band, right = process.copy(), np.zeros((time, 3))
        right[at] = told[:, joint]
        own = known[:, joint].numpy()
        for row in range(3):
            for column in range(row + 1):
                band[row - column, 3 * at + column] += own[:, row, column]
        found[:, joint] = solveh_banded(band, right.ravel(), lower=True).reshape(-1, 3)[at]
    return torch.from_numpy(found)


def _precision_band(time: int, step: float) -> Float[np.ndarray, "7 coordinates"]:
    """Return the lower band of the precision matrix of three Gaussian processes over time.

    The energy of a Matérn 3/2 process is ∫ (κ⁴ x² + 2 κ² x'² + x''²) dt / (4 κ³ σ²).
    """
    band = np.zeros((7, 3 * time))
    scale = step / (4 * _RATE**3 * _SPREAD**2)
    parts = (
        (_RATE**4, (1.0,)),
        (2 * (_RATE / step) ** 2, (-1.0, 1.0)),
        (1 / step**4, (1.0, -2.0, 1.0)),
    )
    for weight, stencil in parts:
        count = max(0, time - len(stencil) + 1)
        for a, left in enumerate(stencil):
            for b, right in enumerate(stencil[a:]):
                band[3 * b, 3 * a : 3 * (a + count)] += scale * weight * left * right
    return band
