"""Joint angles after the recommendations of the International Society of Biomechanics.

Wu et al. 2002 (doi 10.1016/S0021-9290(01)00222-6) for the legs and the spine, Wu et al. 2005
(doi 10.1016/j.jbiomech.2004.05.042) for the arms, Baker 2001 (doi 10.1016/S0167-9457(00)00044-9)
for the order of the pelvis, with which tilt and obliquity do not depend on the heading.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.body.segments import (
    about_axes,
    cardan,
    carried,
    elevation,
    isb_axes,
    opensim_axes,
    pelvis_origin,
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


OpenSimModel = Literal["rajagopal2016", "gait2392"]
Axis3 = tuple[float, float, float]
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class _Joint:
    """A joint of a model: its coordinates turn the distal segment about axes in sequence."""

    proximal: str
    distal: str
    names: tuple[str, ...]
    """Coordinates, in sequence; an empty name is a turn that the model does not have."""
    axes: tuple[Axis3, ...]
    """Axes of the right side, x forwards, y up, z to the right; the left side's are mirrored."""


_PELVIS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation")
_BACK = _Joint(
    "pelvis", "thorax", ("lumbar_extension", "lumbar_bending", "lumbar_rotation"), (_Z, _X, _Y)
)
_HIP = _Joint("pelvis", "femur", ("hip_flexion", "hip_adduction", "hip_rotation"), (_Z, _X, _Y))
_ANKLE = _Joint(
    "tibia", "foot", ("ankle_angle", "subtalar_angle"),
    ((-0.105014, -0.174022, 0.979126), (0.787180, 0.604747, -0.120949)),
)  # fmt: skip
_MTP = (-0.580954, 0.0, 0.813936)


def _opposite(axis: Axis3) -> Axis3:
    return (-axis[0], -axis[1], -axis[2])


_LEGS = {
    "gait2392": (
        _HIP,
        _Joint("femur", "tibia", ("knee_angle", "", ""), (_Z, _X, _Y)),
        _ANKLE,
        _Joint("foot", "toes", ("mtp_angle",), (_MTP,)),
    ),
    "rajagopal2016": (
        _HIP,
        # bent knees are positive, and so are bent toes, unlike in the older model
        _Joint("femur", "tibia", ("knee_angle", "", ""), (_opposite(_Z), _X, _Y)),
        _ANKLE,
        _Joint("foot", "toes", ("mtp_angle",), (_opposite(_MTP),)),
    ),
}
_ARM = (
    _Joint("thorax", "humerus", ("arm_flex", "arm_add", "arm_rot"), (_Z, _X, _Y)),
    _Joint(
        "humerus", "forearm", ("elbow_flex", "pro_sup"),
        ((0.226047, 0.022269, 0.973863), (0.056398, 0.998406, 0.001952)),
    ),
    _Joint("forearm", "hand", ("wrist_flex", "wrist_dev"), (_Z, _X)),
)  # fmt: skip
_ARMS: Mapping[str, tuple[_Joint, ...]] = {"gait2392": (), "rajagopal2016": _ARM}

TRANSLATIONS: tuple[str, ...] = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
"""Coordinates in metres; all others are angles in degrees."""
MODEL_NAMES: Mapping[str, str] = MappingProxyType(
    {"rajagopal2016": "Rajagopal2016", "gait2392": "3DGaitModel2392"}
)
"""The name that each model file gives itself or has."""


def opensim_coordinates(
    motion: Motion, body: BodyModel, model: OpenSimModel
) -> dict[str, Float[np.ndarray, " time"]]:
    """Coordinates of a model by name in its own order: degrees, the pelvis's place in metres.

    The ground of OpenSim has y up; the turn from our world is that of `to_z_up("y")`, undone.
    Joints of a model that turn about fewer axes than ours get the angles with which the model
    follows best; what it cannot follow (the adduction of the knee) is left out. The zero pose of
    pelvis, trunk and feet is our rest pose: an unscaled model stands with a tilt of zero where
    our body stands upright.

    Args:
        motion: one clip without a batch axis.
        body: whose motion it is; the bundled one, whose landmarks are known.
        model: whose coordinates they are.

    Raises:
        ValueError: when the body is another one.
    """
    axes = carried(opensim_axes(body, motion.shape), body, motion)
    to_ground = to_z_up("y").T
    angles = np.rad2deg(cardan(to_ground @ axes["pelvis"], "ZXY"))
    found = {name: angles[:, k] for k, name in enumerate(_PELVIS)}
    place = pelvis_origin(body, motion) @ to_ground.T
    found |= {name: place[:, k] for k, name in enumerate(TRANSLATIONS)}
    for end in ("r", "l"):
        for joint in _LEGS[model]:
            found |= _coordinates(joint, axes, end)
            knee = f"knee_angle_{end}"
            if model == "rajagopal2016" and knee in found:
                # the patella follows the knee by a constraint
                found[f"{knee}_beta"] = found[knee]
    found |= _coordinates(_BACK, axes, "")
    for end in ("r", "l"):
        for joint in _ARMS[model]:
            found |= _coordinates(joint, axes, end)
    return found


def _coordinates(
    joint: _Joint, axes: Mapping[str, np.ndarray], end: str
) -> dict[str, Float[np.ndarray, " time"]]:
    proximal = joint.proximal if joint.proximal in axes else f"{joint.proximal}_{end}"
    distal = f"{joint.distal}_{end}" if end else joint.distal
    relative = np.swapaxes(axes[proximal], -1, -2) @ axes[distal]
    about = [_mirrored(axis) if end == "l" else axis for axis in joint.axes]
    if len(about) == 3:
        order = "".join("XYZ"[int(np.argmax(np.abs(axis)))] for axis in about)
        signs = [float(np.sum(axis)) for axis in about]
        turned = cardan(relative, order) * signs
    else:
        turned = about_axes(relative, about)
    ending = f"_{end}" if end else ""
    degrees = np.rad2deg(turned)
    return {f"{n}{ending}": degrees[:, k] for k, n in enumerate(joint.names) if n}


def _mirrored(axis: Axis3) -> Axis3:
    """The axis on the left side about which the same angle makes the mirror image."""
    return (-axis[0], -axis[1], axis[2])
