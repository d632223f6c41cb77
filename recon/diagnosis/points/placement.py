"""Place and size of the body: a floor at another height, everything scaled by one factor."""

import numpy as np
import torch
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.body.soles import Soles, Stance
from recon.core.motion import Motion
from recon.core.skeleton import FEET
from recon.diagnosis.findings import Finding
from recon.diagnosis.points.bone_lengths import size
from recon.diagnosis.points.named_points import NamedPoints

_FLOOR_JOINTS, _FLOOR_MARKERS = (-0.065, 0.036), (-0.055, 0.07)
"""Metres by which standing soles may lie below and above the ground of a recording that knows it.
The body's soles reach a centimetre lower than recorded feet; shoes and carpets lift, and shoes
lift markers once more."""
_FLOOR_NOISE = 1.0
"""Multiple of a coordinate's standard deviation by which soles may lie off the ground besides."""
_SMALLEST, _LARGEST = 0.72, 1.25
"""Sizes against the average body, about 1.70 m tall, that grown people and older children have."""
_LOW, _SOLE_TO_POINT = 0.05, 0.2
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
    if abs(height - np.quantile(_foot_heights(points, feet), _LOW)) > _SOLE_TO_POINT:
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


def scale_findings(points: NamedPoints) -> list[Finding]:
    """Whether everything is larger or smaller than people are by one factor."""
    ratio = size(points)
    if ratio is None or _SMALLEST < ratio < _LARGEST:
        return []
    return [
        Finding(
            "scale",
            f"the body is {ratio:.2f} times as large as an average person ({1.7 * ratio:.2f} m "
            "tall); check the unit and the scale of the recording (--unit)",
            value=ratio,
        )
    ]
