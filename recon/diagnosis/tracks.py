"""Detects frames out of order and changes of person, by noise in time and jumps of the body."""

import itertools

import numpy as np
import torch
from jaxtyping import Float

from observations.noise import estimate_noise
from recon.core.residuals import NORMAL_MAD
from recon.diagnosis.findings import Code, Finding, spans, stretches
from recon.diagnosis.named_points import NamedPoints, distances, joint_pairs, same_bone_pairs
from recon.diagnosis.quick_fit import without_implausible

_MIN_LENGTHS = 8
"""Moments at which both ends of a bone must be seen."""
_DIFFERENCE = 2.2
"""Typical distance of two measurements of one place, in standard deviations of a coordinate."""
_DISORDER = 2.0
"""Factor by which points must move more between two frames than their noise along bones makes
them; bones keep their lengths in any order."""
_LEAST_DISORDER = 0.05
"""Metres between two frames below which order hardly matters."""
_LAGS = (3, 6, 10)
"""Frames after which a body that moves is farther away than after one frame."""
_GROWTH = 1.5
"""Factor by which it must be farther then; a body in motion reaches more than two."""
_SEAMS = 4
"""Sudden changes of the whole body's velocity from which on frames are out of order; a change of
person or of names has at most two."""
_SEAM_SPEED = 0.8
"""Metres per second by which half of the points change their velocity there. A kick or a landing
changes it by at most 0.5 within a frame of 1/30 s."""
_SEAM_NOISE = 1.4
"""Factor by which noise alone makes the largest such changes exceed the typical one."""
_SEAM_DIFFERENCE = 5**0.5
"""Standard deviation of such a change, in standard deviations of a coordinate: squares of 1/2,
3/2, 3/2 and 1/2 summed."""
_MEDIAN_LENGTH = 1.5381722544550522
"""Median length of a vector of three independent standard normal numbers (chi distribution)."""
_SEAM_POINTS = 8
"""Points that must be seen around a moment."""
_WILD = 0.08
"""Share of the points that may lie where no body is."""
_JUMP = 0.12
"""Metres beyond its neighbours' steps by which the middle of all points may step between two
moments of one recording."""
_DISORDERLY = 3
"""Jumps from which on frames are out of order rather than somebody else's."""
_JUMP_SPEED = 4.0
"""Metres per second that a jump must amount to: a change of speed by this much within a frame is
more than ten times gravity."""


def temporal_noise(points: NamedPoints) -> float:
    """Standard deviation of one coordinate, metres, from third differences in time.

    Zero where it cannot be estimated.
    """
    positions, visible = torch.from_numpy(points.positions), torch.from_numpy(points.visible)
    noise = estimate_noise(positions, visible, (0.0, torch.inf))
    return noise if noise < torch.inf else 0.0


def bone_noise(points: NamedPoints) -> float | None:
    """Standard deviation of one coordinate, metres, from the lengths of bones.

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
    places: Float[np.ndarray, "*views moments points dims"],
) -> Float[np.ndarray, "*views moments points"]:
    """How much the step that leads to a frame differs from the mean of the steps around it.

    NaN where a point is not seen at all four moments, and at the ends.

    Args:
        places: NaN where not seen.
    """
    out = np.full(places.shape[:-1], np.nan)
    step = np.diff(places, axis=-3)
    around = (step[..., :-2, :, :] + step[..., 2:, :, :]) / 2
    out[..., 2:-1, :] = np.linalg.norm(step[..., 1:-1, :, :] - around, axis=-1)
    return out


def frame_order(points: NamedPoints) -> tuple[Finding, ...]:
    """A warning when frames are out of order: positions jump but bone lengths are constant."""
    if found := _repeated_jumps_warning(points):
        return found
    along, near = bone_noise(points), _distance_moved(points, 1)
    far = np.array([_distance_moved(points, lag) for lag in _LAGS])
    if along is None or np.isnan(near) or np.isnan(far).all() or near < _LEAST_DISORDER:
        return ()
    typical = float(np.nanmedian(far))
    if near < _DISORDER * _DIFFERENCE * along or typical > _GROWTH * near:
        return ()
    return (
        Finding(
            "frame order",
            f"from frame to frame points move by {100 * near:.0f} cm, which is no less than they "
            f"move in {_LAGS[-1]} frames, but bones keep their lengths to {100 * along:.1f} cm: "
            "the frames do not seem to be in the order of time; sort them by their time stamps",
            value=near / max(typical, 1e-6),
        ),
    )


def _repeated_jumps_warning(points: NamedPoints) -> tuple[Finding, ...]:
    """A warning if the whole body jumps to another place repeatedly.

    That is so between blocks of frames which were put together in a wrong order. Changes of
    velocity are medians over the points, divided by what the median is for normal noise of one
    metre in each coordinate of the difference.
    """
    kept = without_implausible(points)
    if len(kept.visible) < 4 or kept.visible.sum() < (1 - _WILD) * points.visible.sum():
        return ()  # many outliers may look like a jump of half of the points
    change = velocity_changes(np.where(kept.visible[..., None], kept.positions, np.nan))
    change[np.isfinite(change).sum(1) < _SEAM_POINTS] = 0.0
    change = np.nanmedian(change, axis=1) / _MEDIAN_LENGTH
    noise = _SEAM_NOISE * _SEAM_DIFFERENCE * (bone_noise(points) or 0.0)
    limit = float(np.hypot(noise, _SEAM_SPEED / points.fps))
    before, after = np.append(0.0, change[:-1]), np.append(change[1:], 0.0)
    seams = (change > limit) & (change >= before) & (change >= after)
    if seams.sum() < _SEAMS:
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


def identity_changes(points: NamedPoints) -> tuple[Finding, ...]:
    """Warn where the whole body jumps, as when a tracker switches to another person.

    The middle of the points steps there unlike it does before and after: the median displacement
    of the points that are seen now and were seen at the last frame with any.
    """
    count = len(points.visible)
    step, elapsed = np.full(count, np.nan), np.full(count, 1 / points.fps)
    for last, t in itertools.pairwise(np.flatnonzero(points.visible.any(1))):
        common = points.visible[t] & points.visible[last]
        if common.sum() >= 3:
            moved = points.positions[t, common] - points.positions[last, common]
            step[t] = np.linalg.norm(np.median(moved, axis=0))
            elapsed[t] = (t - last) / points.fps
    beyond, noise = np.zeros(len(step)), temporal_noise(points)
    for t in np.flatnonzero(np.isfinite(step)):
        near = np.r_[max(t - 3, 0) : t, t + 1 : min(t + 4, len(step))]
        near = near[np.isfinite(step[near])]
        usual = float(np.median(step[near] / elapsed[near])) * elapsed[t] if len(near) else 0.0
        beyond[t] = step[t] - usual
    jumps = (beyond > _JUMP + 3 * min(noise, 0.1)) & (beyond > _JUMP_SPEED * elapsed)
    if not jumps.any():
        return ()
    frames, most = stretches(jumps), float(step[jumps].max())
    code: Code = "identity change"
    said = (
        f"all points jump together by up to {most:.2f} m in one frame ({spans(frames)}): "
        "probably another person was tracked from there on; cut the recording there (--between) "
        "or correct the identities"
    )
    if jumps.sum() >= _DISORDERLY:
        code = "frame order"
        said = (
            f"all points jump together by up to {most:.2f} m and back, again and again "
            f"({spans(frames)}): the frames there do not seem to be in the order of time; sort "
            "them by their time stamps"
        )
    return (Finding(code, said, (), frames, most),)


def _distance_moved(points: NamedPoints, frames: int) -> float:
    """Median distance that points move in a number of frames, metres; NaN if unknown."""
    both = points.visible[frames:] & points.visible[:-frames]
    away = np.linalg.norm(points.positions[frames:] - points.positions[:-frames], axis=-1)[both]
    return float(np.median(away)) if away.size else np.nan
