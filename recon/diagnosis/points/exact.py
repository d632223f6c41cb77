"""Facts that need no model: points at exactly zero, points and frames that repeat bit for bit.

Sensors have noise, so no measured coordinate repeats exactly; software that fills what it has
lost writes zeros, the last value, or the last frame again.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float

from recon.body.model import BodyModel
from recon.body.soles import Soles, Stance
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.diagnosis.findings import NOTHING, Finding, Findings, listed, spans, stretches
from recon.diagnosis.points.named_points import NamedPoints, size
from recon.diagnosis.points.tracks import temporal_noise

_REPEATS = 3
"""Moments in a row at which a point must not move before it counts as held; two equal values
may be rounding in a file with few digits."""
_MOVES = 1e-4
"""Metres per moment that other points must move meanwhile: a recording of a statue repeats."""
_TRAVELLED = 2e-3
"""Metres that the other points' paths must be long meanwhile: somebody who stands still sways by
less than the last digit of some files, and a value that is held then is no harm."""
_NOISELESS = 3e-4
"""Metres of noise below which positions are computed rather than measured; animated feet then
stand exactly still, and that is no fault."""
_MAX_ORIGIN_DISTANCE_M = 1.0
"""Metres: in a root-relative recording the body lies about the origin, and a point that is always
exactly there is the root."""


def repaired_exact(points: NamedPoints) -> tuple[NamedPoints, Findings]:
    """The points with zeros, held points and repeated frames taken out, and what was found."""
    found = NOTHING
    for repair in (_zeros, _repeated_frames, _held_points):
        hidden, finding = repair(points)
        if finding is not None:
            points = points.without(hidden)
            found += Findings((finding,))
    return points, found


Found = tuple[Bool[np.ndarray, "moments points"], Finding | None]


def _zeros(points: NamedPoints) -> Found:
    """Points at the origin that are marked as visible, but for a root that is always there."""
    zero = points.visible & (points.positions == 0).all(-1)
    root = zero.any(0) & (zero | ~points.visible).all(0)
    if root.sum() == 1 and _about_origin(points, zero):
        zero[:, root] = False
    if not zero.any():
        return zero, None
    joints = tuple(n for n, some in zip(points.names, zero.any(0), strict=True) if some)
    share = float(zero.sum() / points.visible.sum())
    return zero, Finding(
        "zeros",
        f"{100 * share:.3g} % of the visible positions are exactly (0, 0, 0), which is how "
        f"missing points are often written ({listed(joints)}); they were taken as not visible. "
        "Mark missing points in `visible`",
        joints,
        stretches(zero.any(1)),
        share,
    )


def _about_origin(points: NamedPoints, zero: Bool[np.ndarray, "moments points"]) -> bool:
    """Whether the other points surround the origin in every frame, as about a root."""
    others = points.without(zero).centre
    return bool(
        (np.linalg.norm(others[np.isfinite(others[:, 0])], axis=-1) < _MAX_ORIGIN_DISTANCE_M).all()
    )


def _repeated_frames(points: NamedPoints) -> Found:
    """Frames in which every visible point stands bit for bit where it stood one frame before."""
    same = _unchanged(points)
    whole = (same | ~points.visible).all(1) & (same.sum(1) >= 2)
    hidden = np.zeros_like(points.visible)
    if not whole.any() or whole[1:].all():
        return hidden, None
    hidden[whole] = True
    share = float(whole.mean())
    return hidden, Finding(
        "repeated frames",
        f"{int(whole.sum())} frames repeat the frame before them exactly "
        f"({spans(stretches(whole))}), which no moving person does; they were taken as not seen. "
        "If frames were repeated to reach a higher rate, give the true one",
        (),
        stretches(whole),
        share,
    )


def _held_points(points: NamedPoints) -> Found:
    """Points that keep one value for several moments while others move."""
    same = _unchanged(points)
    step = _step(points)
    moved = step.max(1) > _MOVES
    hidden = np.zeros_like(same)
    computed = temporal_noise(points) < _NOISELESS
    for point in range(same.shape[1]):
        if computed and points.bones[point] in FEET:
            continue
        if (points.positions[points.visible[:, point], point] == 0).all():
            continue  # the root of what is relative to it: other zeros are out by now
        for first, last in stretches(same[:, point]):
            held = slice(first, last + 1)
            travelled = np.median(step[held].sum(0)[points.visible[held].any(0)])
            if (
                last - first + 2 >= _REPEATS
                and moved[held].mean() > 0.5
                and travelled > _TRAVELLED
            ):
                hidden[held, point] = True
    if not hidden.any():
        return hidden, None
    joints = tuple(n for n, some in zip(points.names, np.any(hidden, axis=0), strict=True) if some)
    frames = stretches(np.any(hidden, axis=1))
    return hidden, Finding(
        "constant point",
        f"{listed(joints)} {'keeps' if len(joints) == 1 else 'keep'} exactly one position while "
        f"the body moves ({spans(frames)}); the repeated values were taken as not visible",
        joints,
        frames,
        float(hidden.sum() / points.visible.sum()),
    )


def _unchanged(points: NamedPoints) -> Bool[np.ndarray, "moments points"]:
    """Points that are visible at this moment and the one before, at exactly the same place."""
    same = np.zeros_like(points.visible)
    both = points.visible[1:] & points.visible[:-1]
    same[1:] = both & (points.positions[1:] == points.positions[:-1]).all(-1)
    return same


def _step(points: NamedPoints) -> Float[np.ndarray, "moments points"]:
    """Metres by which every point moved since the moment before; zero where it was not seen."""
    step = np.zeros(points.visible.shape)
    both = points.visible[1:] & points.visible[:-1]
    step[1:] = np.linalg.norm(np.diff(points.positions, axis=0), axis=-1) * both
    return step


_FLOOR_JOINTS, _FLOOR_MARKERS = (-0.065, 0.036), (-0.055, 0.07)
"""Metres by which standing soles may lie below and above the ground of a recording that knows it.
The body's soles reach a centimetre lower than recorded feet; shoes and carpets lift, and shoes
lift markers once more."""
_FLOOR_NOISE = 1.0
"""Multiple of a coordinate's standard deviation by which soles may lie off the ground besides."""
_MIN_SIZE_RATIO, _MAX_SIZE_RATIO = 0.72, 1.25
"""Sizes against the average body, about 1.70 m tall, that grown people and older children have."""
_LOWEST_QUANTILE, _SOLE_TO_POINT = 0.05, 0.2
"""Quantile of the heights of a foot's points that stands for the lowest, and metres within which
the soles of a fit must be of it: ankles are a tenth of a metre up."""
_STANDING = 0.2
"""Seconds during which a foot that is seen must stand."""
_FEWEST_FEET = 0.3
"""Share of moments at which a foot must be seen for its height to count."""


def floor_height(points: NamedPoints, motion: Motion, body: BodyModel, noise: float) -> float:
    """Height of the ground below a quick fit, metres; zero where it is at z = 0 or unknown.

    It is unknown where feet hid, and where none that is seen ever stands: the hidden feet of a
    handstand say nothing about the floor. Nor does a quick fit whose soles are far from the points
    of the feet themselves.
    """
    feet = [k for k, bone in enumerate(points.bones) if bone in FEET]
    if not feet or np.any(points.visible[:, feet], axis=1).mean() < _FEWEST_FEET:
        return 0.0
    moments = (np.arange(motion.frames) * points.fps / motion.fps).round().astype(int)
    seen = np.any(points.visible[:, feet], axis=1)[moments.clip(max=len(points.visible) - 1)]
    clip = motion[0].detach().to(device="cpu")
    stance = Stance.of(clip, body, Soles.of(body), frames=torch.from_numpy(seen))
    if stance.frames < _STANDING * motion.fps:
        return 0.0
    height = stance.height()
    if abs(height - np.quantile(_foot_heights(points, feet), _LOWEST_QUANTILE)) > _SOLE_TO_POINT:
        return 0.0
    low, high = _FLOOR_JOINTS if points.are_joints else _FLOOR_MARKERS
    noise *= _FLOOR_NOISE
    return 0.0 if min(low, -noise) <= height <= max(high, noise) else height


def _foot_heights(points: NamedPoints, feet: list[int]) -> Float[np.ndarray, " seen"]:
    return points.positions[:, feet, 2][points.visible[:, feet]]


def floor_finding(height: float) -> Finding:
    """What is said where the ground was moved."""
    return Finding(
        "floor",
        f"the soles stand {100 * abs(height):.0f} cm {'above' if height > 0 else 'below'} the "
        "recording's ground at z = 0; the height of the ground was estimated instead. If the "
        "person stands on something, give --no-repair",
        value=height,
    )


def scale_findings(points: NamedPoints) -> tuple[Finding, ...]:
    """Whether everything is larger or smaller than people are by one factor."""
    ratio = size(points)
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
