"""Detects frames out of order and switches to another person in tracked 3D points."""

import itertools

import numpy as np
import torch
from jaxtyping import Bool, Float

from observations.noise import estimate_noise
from recon.core.residuals import NORMAL_MAD
from recon.diagnosis.findings import Code, Finding, spans, stretches
from recon.diagnosis.named_points import NamedPoints, distances, joint_pairs, same_bone_pairs
from recon.diagnosis.quick_fit import without_implausible

_MIN_LENGTHS = 8
"""Number of frames in which both ends of a bone must be seen."""
_TYPICAL_STDS = 2.2
"""Typical distance of two measurements of one place, in standard deviations of a coordinate."""
_MIN_DISORDER_RATIO = 2.0
"""Factor by which points must move more between two frames than their noise along bones explains;
bones keep their lengths in any order of frames."""
_MIN_DISORDER_M = 0.05
"""Distance (m) between two frames below which order hardly matters."""
_LAGS = (3, 6, 10)
"""Numbers of frames after which a moving body is farther away than after one frame."""
_MIN_GROWTH = 1.5
"""Ratio of the distances moved in `_LAGS` frames and in one, below which order is wrong."""
_MIN_SEAMS = 4
"""Number of seams, which are sudden changes of the whole body's velocity, from which on frames are
out of order; a change of person or of names has at most two."""
_MIN_SEAM_M_S = 0.8
"""Change of velocity (m/s) within one frame of at least half of the points at a seam. A kick or a
landing changes it by at most 0.5 within a frame of 1/30 s."""
_SEAM_NOISE_RATIO = 1.4
"""Ratio of the largest change of velocity by noise alone to the typical one."""
_SEAM_STD_RATIO = 5**0.5
"""Standard deviation of a change of velocity by noise, in standard deviations of a coordinate:
root of the sum of the squares of 1/2, 3/2, 3/2 and 1/2."""
_MEDIAN_LENGTH = 1.5381722544550522
"""Median length of a vector of three independent standard normal numbers (chi distribution)."""
_MIN_SEAM_POINTS = 8
"""Number of points that must be seen around a seam."""
_MAX_OUTLIERS = 0.08
"""Share of implausible positions above which seams are not searched."""
_MIN_JUMP_M = 0.12
"""Distance (m) by which a step of the whole body must exceed the steps around it to be a jump."""
_MIN_DISORDER_JUMPS = 3
"""Number of jumps from which on frames are out of order rather than another person's."""
_MIN_JUMP_M_S = 4.0
"""Speed (m/s) of a jump, at least: such a change within a frame is more than 10 g."""


def temporal_noise(points: NamedPoints) -> float:
    """Return the standard deviation (m) of a coordinate, from third differences in time.

    It is zero where it cannot be estimated.
    """
    positions, visible = torch.from_numpy(points.positions), torch.from_numpy(points.visible)
    noise = estimate_noise(positions, visible, (0.0, torch.inf))
    return noise if noise < torch.inf else 0.0


def bone_noise(points: NamedPoints) -> float | None:
    """Return the standard deviation (m) of a coordinate, from the lengths of bones.

    Points on one bone, and joints at its two ends, keep their distance whatever the order of the
    frames. None where there are no such pairs.
    """
    pairs = joint_pairs(points) if points.are_joints else same_bone_pairs(points)
    spreads = [
        float(np.median(np.abs(length - np.median(length))))
        for pair in pairs
        if len(length := distances(points, *pair)) >= _MIN_LENGTHS
    ]
    return float(np.median(spreads)) / NORMAL_MAD / 2**0.5 if spreads else None


def velocity_changes(
    positions: Float[np.ndarray, "*views moments points dims"],
) -> Float[np.ndarray, "*views moments points"]:
    """Return the distance of each frame's step from the mean of the steps before and after.

    It is NaN at the ends, and where a point is not seen in all four frames.

    Args:
        positions: positions of the points; NaN where not seen.
    """
    out = np.full(positions.shape[:-1], np.nan)
    step = np.diff(positions, axis=-3)
    around = (step[..., :-2, :, :] + step[..., 2:, :, :]) / 2
    out[..., 2:-1, :] = np.linalg.norm(step[..., 1:-1, :, :] - around, axis=-1)
    return out


def frame_order(points: NamedPoints) -> tuple[Finding, ...]:
    """Return a warning if frames are out of order: positions jump, but bones keep their length."""
    if found := _repeated_jumps_warning(points):
        return found
    noise, near = bone_noise(points), _distance_moved(points, 1)
    far = np.array([_distance_moved(points, lag) for lag in _LAGS])
    if noise is None or np.isnan(near) or np.isnan(far).all() or near < _MIN_DISORDER_M:
        return ()
    typical = float(np.nanmedian(far))
    if near < _MIN_DISORDER_RATIO * _TYPICAL_STDS * noise or typical > _MIN_GROWTH * near:
        return ()
    return (
        Finding(
            "frame order",
            f"from frame to frame points move by {100 * near:.0f} cm, which is no less than they "
            f"move in {_LAGS[-1]} frames, but bones keep their lengths to {100 * noise:.1f} cm: "
            "the frames do not seem to be in the order of time; sort them by their time stamps",
            value=near / max(typical, 1e-6),
        ),
    )


def _repeated_jumps_warning(points: NamedPoints) -> tuple[Finding, ...]:
    """Return a warning if the whole body jumps to another place repeatedly.

    This happens between blocks of frames that were put together in a wrong order. Changes of
    velocity are medians over the points, divided by the median for standard normal noise in each
    coordinate of the difference.
    """
    kept = without_implausible(points)
    if len(kept.visible) < 4 or kept.visible.sum() < (1 - _MAX_OUTLIERS) * points.visible.sum():
        return ()  # many outliers may look like a jump of half of the points
    change = velocity_changes(np.where(kept.visible[..., None], kept.positions, np.nan))
    change[np.isfinite(change).sum(1) < _MIN_SEAM_POINTS] = 0.0
    change = np.nanmedian(change, axis=1) / _MEDIAN_LENGTH
    noise = _SEAM_NOISE_RATIO * _SEAM_STD_RATIO * (bone_noise(points) or 0.0)
    limit = float(np.hypot(noise, _MIN_SEAM_M_S / points.fps))
    before, after = np.append(0.0, change[:-1]), np.append(change[1:], 0.0)
    seams = (change > limit) & (change >= before) & (change >= after)
    if seams.sum() < _MIN_SEAMS:
        return ()
    frames, speed = stretches(seams), float(np.median(change[seams])) * points.fps
    return (
        Finding(
            "frame order",
            f"the whole body changes its velocity by about {speed:.1f} m/s within one frame, "
            f"{int(seams.sum())} times ({spans(frames)}), which no person can: the frames do not "
            "seem to be in the order of time; sort them by their time stamps",
            (),
            frames,
            speed,
        ),
    )


def identity_changes(
    positions: Float[np.ndarray, "moments points 3"],
    visible: Bool[np.ndarray, "moments points"],
    fps: float,
) -> tuple[Finding, ...]:
    """Warn where the whole body jumps, as when a tracker switches to another person.

    A jump is a step of the whole body that differs from those before and after; the step is the
    median displacement of the points that are seen now and in the last frame with any.
    """
    count = len(visible)
    step, elapsed = np.full(count, np.nan), np.full(count, 1 / fps)
    for last, t in itertools.pairwise(np.flatnonzero(visible.any(1))):
        common = visible[t] & visible[last]
        if common.sum() >= 3:
            moved = positions[t, common] - positions[last, common]
            step[t] = np.linalg.norm(np.median(moved, axis=0))
            elapsed[t] = (t - last) / fps
    beyond, noise = (
        np.zeros(len(step)),
        estimate_noise(torch.from_numpy(positions), torch.from_numpy(visible), (0.0, torch.inf)),
    )
    for t in np.flatnonzero(np.isfinite(step)):
        near = np.r_[max(t - 3, 0) : t, t + 1 : min(t + 4, len(step))]
        near = near[np.isfinite(step[near])]
        usual = float(np.median(step[near] / elapsed[near])) * elapsed[t] if len(near) else 0.0
        beyond[t] = step[t] - usual
    jumps = (beyond > _MIN_JUMP_M + 3 * min(noise, 0.1) * (noise < torch.inf)) & (
        beyond > _MIN_JUMP_M_S * elapsed
    )
    if not jumps.any():
        return ()
    frames, most = stretches(jumps), float(step[jumps].max())
    code: Code = "identity change"
    said = (
        f"all points jump together by up to {most:.2f} m in one frame ({spans(frames)}): "
        "probably another person was tracked from there on; cut the recording there (`recon fit "
        "--between`) or correct the identities"
    )
    if jumps.sum() >= _MIN_DISORDER_JUMPS:
        code = "frame order"
        said = (
            f"all points jump together by up to {most:.2f} m and back, again and again "
            f"({spans(frames)}): the frames there do not seem to be in the order of time; sort "
            "them by their time stamps"
        )
    return (Finding(code, said, (), frames, most),)


def _distance_moved(points: NamedPoints, frames: int) -> float:
    """Return the median distance (m) that points move in a number of frames; NaN if unknown."""
    both = points.visible[frames:] & points.visible[:-frames]
    away = np.linalg.norm(points.positions[frames:] - points.positions[:-frames], axis=-1)[both]
    return float(np.median(away)) if away.size else np.nan
