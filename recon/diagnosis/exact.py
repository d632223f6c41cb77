"""Checks 3D points for faults that need no fit: zeros, repeated values, ground height, size.

Sensors have noise, so no measured value repeats exactly; software that fills gaps writes zeros,
the last value, or the last frame again.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float

from recon.body.model import BodyModel
from recon.body.soles import Soles, Stance
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.diagnosis.findings import NOTHING, Finding, Findings, flagged, listed, spans, stretches
from recon.diagnosis.named_points import NamedPoints, relative_body_size
from recon.diagnosis.tracks import temporal_noise

_MIN_EQUAL_FRAMES = 3
"""Number of consecutive frames with one position from which on a point counts as held; two equal
values may be rounding in a file with few digits."""
_MIN_STEP_M = 1e-4
"""Step (m) of some point to the next frame above which the body moves; a statue does not."""
_MIN_PATH_M = 2e-3
"""Median length (m) of all points' paths while one is held, above which that is an error: people
who stand still sway by less than the last digit of some files."""
_MAX_COMPUTED_NOISE_M = 3e-4
"""Noise (m) below which positions are computed rather than measured; animated feet stand exactly
still, which is no fault."""
_MAX_ORIGIN_DISTANCE_M = 1.0
"""Distance (m) of a body from the origin within which a recording may be root-relative; then the
one point that is always exactly at the origin is the root."""


def unchanged(
    places: Float[np.ndarray, "*views moments points dims"],
    seen: Bool[np.ndarray, "*views moments points"],
) -> Bool[np.ndarray, "*views moments points"]:
    """Return a mask of points seen at exactly the same place as in the previous frame."""
    same = np.zeros_like(seen)
    same[..., 1:, :] = seen[..., 1:, :] & seen[..., :-1, :]
    same[..., 1:, :] &= (places[..., 1:, :, :] == places[..., :-1, :, :]).all(-1)
    return same


def repaired_zeros(points: NamedPoints) -> tuple[NamedPoints, Findings]:
    """Mark points at the origin as unseen, except a root that is at the origin in all frames."""
    zero = points.visible & (points.positions == 0).all(-1)
    root = zero.any(0) & (zero | ~points.visible).all(0)
    others = np.linalg.norm(points.without(zero).centre, axis=-1)
    if root.sum() == 1 and (others[np.isfinite(others)] < _MAX_ORIGIN_DISTANCE_M).all():
        zero[:, root] = False
    if not zero.any():
        return points, NOTHING
    joints = flagged(points.names, np.any(zero, axis=0))
    share = float(zero.sum() / points.visible.sum())
    said = Finding(
        "zeros",
        f"{100 * share:.3g} % of the visible positions are exactly (0, 0, 0), which is how "
        f"missing points are often written ({listed(joints)}); they were taken as not visible. "
        "Mark missing points in `visible`",
        joints,
        stretches(np.any(zero, axis=1)),
        share,
    )
    return points.without(zero), Findings((said,))


def repaired_copies(points: NamedPoints) -> tuple[NamedPoints, Findings]:
    """Mark frames as unseen in which every point equals the previous frame bit for bit."""
    same = unchanged(points.positions, points.visible)
    whole = (same | ~points.visible).all(1) & (same.sum(1) >= 2)
    if not whole.any() or whole[1:].all():
        return points, NOTHING
    said = Finding(
        "repeated frames",
        f"{int(whole.sum())} frames repeat the frame before them exactly "
        f"({spans(stretches(whole))}), which no moving person does; they were taken as not seen. "
        "If frames were repeated to reach a higher rate, give the true one",
        (),
        stretches(whole),
        float(whole.mean()),
    )
    return points.without(whole[:, None]), Findings((said,))


def repaired_frozen(points: NamedPoints) -> tuple[NamedPoints, Findings]:
    """Mark points as unseen where they keep one value for several frames while others move."""
    visible = points.visible
    same, step = unchanged(points.positions, visible), np.zeros(visible.shape)
    step[1:] = np.linalg.norm(np.diff(points.positions, axis=0), axis=-1)
    step[1:] *= visible[1:] & visible[:-1]
    moved, hidden = step.max(1) > _MIN_STEP_M, np.zeros_like(same)
    computed = temporal_noise(points) < _MAX_COMPUTED_NOISE_M
    for point, bone in enumerate(points.bones):
        # noise-free standing feet, and a root that is the origin in all frames, may stay in place
        if (computed and bone in FEET) or not points.positions[visible[:, point], point].any():
            continue
        for first, last in stretches(same[:, point], _MIN_EQUAL_FRAMES - 1):
            held = slice(first, last + 1)
            travelled = np.median(step[held].sum(0)[visible[held].any(0)])
            hidden[held, point] = moved[held].mean() > 0.5 and travelled > _MIN_PATH_M
    if not hidden.any():
        return points, NOTHING
    joints, frames = (
        flagged(points.names, np.any(hidden, axis=0)),
        stretches(np.any(hidden, axis=1)),
    )
    said = Finding(
        "constant point",
        f"{listed(joints)} {'keeps' if len(joints) == 1 else 'keep'} exactly one position while "
        f"the body moves ({spans(frames)}); the repeated values were taken as not visible",
        joints,
        frames,
        float(hidden.sum() / visible.sum()),
    )
    return points.without(hidden), Findings((said,))


_SOLE_RANGE_JOINTS_M, _SOLE_RANGE_MARKERS_M = (-0.065, 0.036), (-0.055, 0.07)
"""Lowest and highest plausible height (m) of standing soles where the ground is z = 0. The body's
soles reach a centimetre lower than recorded feet; shoes and carpets lift, and shoes lift markers
once more."""
_SOLE_RANGE_STDS = 1.0
"""Distance of soles from the ground that is always plausible, in standard deviations."""
_MIN_SIZE_RATIO, _MAX_SIZE_RATIO = 0.72, 1.25
"""Plausible sizes relative to the average body of 1.70 m: older children and adults."""
_LOWEST_QUANTILE, _MAX_SOLE_TO_POINT_M = 0.05, 0.2
"""Quantile of the heights of the points of feet that is their lowest height, and its largest
distance (m) from the soles of a fit: ankles are 0.1 m up."""
_MIN_STANCE_S = 0.2
"""Total time (s) for which a seen foot must stand."""
_MIN_FEET_SHARE = 0.3
"""Share of the frames in which a foot must be seen for its height to count."""


def floor_height(points: NamedPoints, motion: Motion, body: BodyModel, noise: float) -> float:
    """Return the ground's height (m) from a quick fit; 0 if z = 0 is plausible or feet are unseen.

    It is unknown where feet are hidden or none that is seen ever stands: hidden feet, as in a
    handstand, say nothing about the floor. Nor does a quick fit whose soles are far from the
    points of the feet.
    """
    feet = [k for k, bone in enumerate(points.bones) if bone in FEET]
    shown = points.visible[:, feet]
    if not feet or shown.any(1).mean() < _MIN_FEET_SHARE:
        return 0.0
    moments = (np.arange(motion.frames) * points.fps / motion.fps).round().astype(int)
    seen = torch.from_numpy(np.any(shown, axis=1)[moments.clip(max=len(shown) - 1)])
    clip = motion[0].detach()
    stance = Stance.of(clip, body, Soles.of(body), frames=seen)
    if stance.standing_frames < _MIN_STANCE_S * motion.fps:
        return 0.0
    height = stance.ground_height()
    lowest = np.quantile(points.positions[:, feet, 2][shown], _LOWEST_QUANTILE)
    low, high = _SOLE_RANGE_JOINTS_M if points.are_joints else _SOLE_RANGE_MARKERS_M
    noise *= _SOLE_RANGE_STDS
    usual = min(low, -noise) <= height <= max(high, noise)
    return 0.0 if usual or abs(height - lowest) > _MAX_SOLE_TO_POINT_M else height


def floor_finding(height: float) -> Finding:
    """Return the finding that the ground was moved to another height."""
    return Finding(
        "floor",
        f"the soles stand {100 * abs(height):.0f} cm {'above' if height > 0 else 'below'} the "
        "recording's ground at z = 0; the height of the ground was estimated instead. Turn the "
        "data where z is not up (--up); give --no-repair where the person stands on something",
        value=height,
    )


def scale_findings(points: NamedPoints) -> tuple[Finding, ...]:
    """Return a warning when the whole body is larger or smaller than people are."""
    ratio = relative_body_size(points)
    if ratio is None or _MIN_SIZE_RATIO < ratio < _MAX_SIZE_RATIO:
        return ()
    return (
        Finding(
            "scale",
            f"the body is {ratio:.2f} times as large as an average person ({1.7 * ratio:.2f} m "
            "tall); check the unit and the scale of the recording (--unit)",
            value=ratio,
        ),
    )
