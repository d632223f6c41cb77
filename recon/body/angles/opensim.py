"""Generalised coordinates of OpenSim's gait models: the angles that move their skeletons alike.

Names, axes and signs are those of the model files `Rajagopal2016.osim` (Rajagopal et al. 2016,
doi 10.1109/TBME.2016.2586891) and `gait2392` (Delp et al. 1990, doi 10.1109/10.102791), as the
project opensim-models publishes them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from recon.body.angles.rotations import about_axes, cardan
from recon.body.angles.segments import carried, opensim_axes, pelvis_origin
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.units import to_z_up

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
