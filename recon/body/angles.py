"""Joint angles after the recommendations of the International Society of Biomechanics.

Wu et al. 2002 (doi 10.1016/S0021-9290(01)00222-6) for the legs and the spine, Wu et al. 2005
(doi 10.1016/j.jbiomech.2004.05.042) for the arms, Baker 2001 (doi 10.1016/S0167-9457(00)00044-9)
for the order of the pelvis, with which tilt and obliquity do not depend on the heading.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.body.segments import (
    cardan,
    carried,
    elevation,
    isb_axes,
)
from recon.core.motion import Motion
from recon.core.units import to_z_up

_MIRROR = np.diag([1.0, 1.0, -1.0])
"""Left limbs are described as if they were right ones, so that signs mean the same."""


@dataclass(frozen=True)
class _Angles:
    """Three angles between two segments."""

    proximal: str
    distal: str
    order: str
    """Axes of the sequence; YXY is that of the shoulder."""
    names: tuple[str, str, str]
    """What each angle means where it is positive, in the order of the sequence."""
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)


_MIDDLE = (
    _Angles(
        "ground", "pelvis", "YXZ",
        ("pelvis_left_rotation", "pelvis_left_up_obliquity", "pelvis_anterior_tilt"),
        (1.0, 1.0, -1.0),
    ),
    _Angles(
        "pelvis", "thorax", "ZXY",
        ("trunk_flexion", "trunk_right_bending", "trunk_left_rotation"), (-1.0, 1.0, 1.0),
    ),
)  # fmt: skip
_SIDED = (
    _Angles(
        "pelvis", "femur", "ZXY", ("hip_flexion", "hip_adduction", "hip_internal_rotation")
    ),
    _Angles(
        "femur", "tibia", "ZXY", ("knee_flexion", "knee_adduction", "knee_internal_rotation"),
        (-1.0, 1.0, 1.0),
    ),
    _Angles(
        "tibia", "foot", "ZXY",
        ("ankle_dorsiflexion", "ankle_inversion", "ankle_internal_rotation"),
    ),
    _Angles(
        "thorax", "humerus", "YXY",
        ("shoulder_plane_of_elevation", "shoulder_elevation", "shoulder_internal_rotation"),
    ),
    _Angles(
        "humerus", "forearm", "ZXY", ("elbow_flexion", "elbow_adduction", "forearm_pronation")
    ),
    _Angles(
        "forearm", "hand", "ZXY", ("wrist_flexion", "wrist_ulnar_deviation", "wrist_pronation")
    ),
)  # fmt: skip


ISB_ANGLES: tuple[str, ...] = (
    *(name for one in _MIDDLE for name in one.names),
    *(f"{name}_{end}" for end in ("r", "l") for one in _SIDED for name in one.names),
)
"""Names of all angles, in the order of `isb_angles`."""


def isb_angles(motion: Motion, body: BodyModel) -> dict[str, Float[np.ndarray, " time"]]:
    """Joint angles of one clip in degrees, by name; `_l` and `_r` end those of a side.

    A name says what a positive angle is, on either side. The pelvis is relative to the world,
    whose x axis points forwards at a left rotation of zero. Where the arm hangs, the plane of
    elevation and the rotation of the shoulder are hardly told apart, as the sequence of the ISB
    has it; only their sum is known there.

    Args:
        motion: one clip without a batch axis.
        body: whose motion it is; the bundled one, whose landmarks are known.

    Raises:
        ValueError: when the body is another one.
    """
    axes = carried(isb_axes(body, motion.shape), body, motion)
    axes["ground"] = np.broadcast_to(to_z_up("y"), axes["pelvis"].shape)
    found: dict[str, np.ndarray] = {}
    for one in _MIDDLE:
        found |= _three(one, axes, one.proximal, one.distal, "")
    for end in ("r", "l"):
        for one in _SIDED:
            proximal = one.proximal if one.proximal in axes else f"{one.proximal}_{end}"
            found |= _three(one, axes, proximal, f"{one.distal}_{end}", f"_{end}")
    return found


def _three(
    one: _Angles, axes: Mapping[str, np.ndarray], proximal: str, distal: str, ending: str
) -> dict[str, np.ndarray]:
    relative = np.swapaxes(axes[proximal], -1, -2) @ axes[distal]
    if ending == "_l":
        relative = _MIRROR @ relative @ _MIRROR
    angles = elevation(relative) if one.order == "YXY" else cardan(relative, one.order)
    degrees = np.rad2deg(angles) * one.signs
    return {f"{name}{ending}": degrees[:, k] for k, name in enumerate(one.names)}
