"""Coordinates of OpenSim's gait models: the frames of their bodies, and turns about their axes.

The frames of their bodies are all parallel in their zero pose: upright, arms hanging, palms
forwards, soles level.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float
from torch import Tensor

from recon.body.model import BodyModel
from recon.body.segments import SIDES, UP, Axes, axes_along_y, cardan, posed_axes, rest_points
from recon.core.motion import Motion
from recon.core.units import to_z_up

OpenSimModel = Literal["rajagopal2016", "gait2392"]
Axis3 = tuple[float, float, float]
_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class _Joint:
    """A joint of an OpenSim model: two segments, and its coordinates with their axes in order."""

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


def _negative_axis(axis: Axis3) -> Axis3:
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
        # in rajagopal2016, unlike in gait2392, flexion of knees and toes is positive
        _Joint("femur", "tibia", ("knee_angle", "", ""), (_negative_axis(_Z), _X, _Y)),
        _ANKLE,
        _Joint("foot", "toes", ("mtp_angle",), (_negative_axis(_MTP),)),
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


_UPRIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Axes of a person who stands in the rest pose, as columns: the pose has y up and faces z."""
_ROUNDS = 60
"""Rounds of fitting one axis after the other; axes of joints are far from parallel, so that every
round leaves less than a tenth of the error."""


def opensim_coordinates(
    motion: Motion, body: BodyModel, model: OpenSimModel
) -> dict[str, Float[np.ndarray, " time"]]:
    """Coordinates of an OpenSim model by name, in the model's order; degrees, pelvis metres.

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
    axes = posed_axes(opensim_axes(body, motion.shape), body, motion)
    to_ground = to_z_up("y").T
    angles = np.rad2deg(cardan(to_ground @ axes["pelvis"], "ZXY"))
    found = {name: angles[:, k] for k, name in enumerate(_PELVIS)}
    place = pelvis_origin(body, motion) @ to_ground.T
    found |= {name: place[:, k] for k, name in enumerate(TRANSLATIONS)}
    for end in ("r", "l"):
        for joint in _LEGS[model]:
            found |= _joint_coordinates(joint, axes, end)
            knee = f"knee_angle_{end}"
            if model == "rajagopal2016" and knee in found:
                # OpenSim moves the patella by the knee's angle, through a constraint
                found[f"{knee}_beta"] = found[knee]
    found |= _joint_coordinates(_BACK, axes, "")
    for end in ("r", "l"):
        for joint in _ARMS[model]:
            found |= _joint_coordinates(joint, axes, end)
    return found


def _joint_coordinates(
    joint: _Joint, axes: Mapping[str, np.ndarray], side: str
) -> dict[str, Float[np.ndarray, " time"]]:
    proximal = joint.proximal if joint.proximal in axes else f"{joint.proximal}_{side}"
    distal = f"{joint.distal}_{side}" if side else joint.distal
    relative = np.swapaxes(axes[proximal], -1, -2) @ axes[distal]
    about = [_mirrored_axis(axis) if side == "l" else axis for axis in joint.axes]
    if len(about) == 3:
        order = "".join("XYZ"[int(np.argmax(np.abs(axis)))] for axis in about)
        signs = [float(np.sum(axis)) for axis in about]
        turned = cardan(relative, order) * signs
    else:
        turned = angles_about_axes(relative, about)
    ending = f"_{side}" if side else ""
    degrees = np.rad2deg(turned)
    return {f"{n}{ending}": degrees[:, k] for k, n in enumerate(joint.names) if n}


def leg_axes(
    body: BodyModel, motion: Motion, model: OpenSimModel
) -> dict[str, Float[np.ndarray, "time 3"]]:
    """Axes of the hips', knees' and ankles' coordinates in the world, by name; unit vectors.

    A coordinate grows when the distal segment turns about its axis: the first one of a joint goes
    with the proximal segment, the last with the distal one, and one between is normal to both.

    Raises:
        ValueError: when the body is another one.
    """
    axes = posed_axes(opensim_axes(body, motion.shape), body, motion)
    found: dict[str, Float[np.ndarray, "time 3"]] = {}
    for end in ("r", "l"):
        for joint in _LEGS[model]:
            proximal = joint.proximal if joint.proximal in axes else f"{joint.proximal}_{end}"
            about = [_mirrored_axis(axis) if end == "l" else axis for axis in joint.axes]
            first = axes[proximal] @ (np.array(about[0]) / np.linalg.norm(about[0]))
            last = axes[f"{joint.distal}_{end}"] @ (
                np.array(about[-1]) / np.linalg.norm(about[-1])
            )
            middle = np.cross(last, first)
            middle /= np.linalg.norm(middle, axis=-1, keepdims=True).clip(min=1e-9)
            three = (first, middle, last) if len(about) == 3 else (first, last)
            found |= {f"{n}_{end}": axis for n, axis in zip(joint.names, three, strict=False) if n}
    return found


def _mirrored_axis(axis: Axis3) -> Axis3:
    """Mirror a rotation axis to the left side, so that equal angles give mirrored poses."""
    return (-axis[0], -axis[1], axis[2])


def opensim_axes(body: BodyModel, shape: Float[Tensor, " shape"]) -> Axes:
    """Axes of segments as the bodies of OpenSim's gait models have them in their zero pose.

    Pelvis, thorax and soles are upright in our rest pose; long bones point from joint to joint.
    Thigh, shank and foot share the axis of the knee: the models know no torsion of the shank, and
    would have to turn the ankle for feet that point outwards at rest.

    Raises:
        ValueError: when the body is not the bundled one, whose landmarks alone are known.
    """
    points = rest_points(body, shape)
    axes = {"pelvis": _UPRIGHT, "thorax": _UPRIGHT}
    for end, side in SIDES.items():
        names = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
        hip, knee, ankle, shoulder, elbow, wrist = (points.joint(f"{side}_{n}") for n in names)
        flexion = points.vector_to_right(end, "knee_medial", "knee_lateral")
        foot = axes_along_y(UP, flexion)
        knuckles = points.middle_of(f"{side}_index_knuckle", f"{side}_pinky_knuckle")
        axes |= {
            f"femur_{end}": axes_along_y(hip - knee, flexion),
            f"tibia_{end}": axes_along_y(knee - ankle, flexion),
            f"foot_{end}": foot,
            f"toes_{end}": foot,
            f"humerus_{end}": axes_along_y(
                shoulder - elbow, points.vector_to_right(end, "elbow_medial", "elbow_lateral")
            ),
            f"forearm_{end}": axes_along_y(
                elbow - wrist, points.vector_to_right(end, "wrist_ulnar", "wrist_radial")
            ),
            f"hand_{end}": axes_along_y(
                wrist - knuckles, points.vector_to_right(end, "pinky_knuckle", "index_knuckle")
            ),
        }
    return axes


def pelvis_origin(body: BodyModel, motion: Motion) -> Float[np.ndarray, "time 3"]:
    """Return the midpoint of the two anterior iliac spines in every frame, world, metres.

    It is the origin of the pelvis in OpenSim's gait models, and moves with the bone.
    """
    posed = body.pose(motion)
    points = rest_points(body, motion.shape)
    offset = points.middle_of("left_asis", "right_asis") - points.joint("pelvis")
    orientations = posed.orientations[:, 0].detach().double().cpu().numpy()
    return posed.joints[:, 0].detach().double().cpu().numpy() + orientations @ offset


def angles_about_axes(
    rotations: Float[np.ndarray, "time 3 3"], axes: Sequence[Sequence[float]]
) -> Float[np.ndarray, "time axes"]:
    """Angles, radians, of the turns about one or two axes in sequence that are nearest to R.

    Nearest in the Frobenius norm, as a joint of a model can follow a rotation that has parts it
    does not allow.

    Args:
        rotations: R of the distal segment relative to the proximal one.
        axes: one or two unit vectors, in the frame of the proximal segment in its zero pose.
    """
    units = [np.asarray(axis, dtype=float) / np.linalg.norm(axis) for axis in axes]
    angles = np.zeros((len(rotations), len(units)))
    if len(units) == 1:
        angles[:, 0] = _nearest_angle(rotations, units[0])
    else:
        for _ in range(_ROUNDS):
            rest = rotations @ _rotations_about(-angles[:, 1], units[1])
            angles[:, 0] = _nearest_angle(rest, units[0])
            rest = _rotations_about(-angles[:, 0], units[0]) @ rotations
            angles[:, 1] = _nearest_angle(rest, units[1])
    return np.unwrap(angles, axis=0)


def _rotations_about(angles: np.ndarray, axis: np.ndarray) -> Float[np.ndarray, "time 3 3"]:
    """Return matrices of rotations by the given angles (radians) about one axis."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(angles[:, None] * axis).as_matrix()


def _nearest_angle(matrices: np.ndarray, axis: np.ndarray) -> Float[np.ndarray, " time"]:
    """Return the angle q about an axis whose rotation R(q) is nearest to each matrix M."""
    m = matrices
    axial = np.stack(
        (m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]), 1
    )
    trace = np.trace(m, axis1=1, axis2=2)
    return np.arctan2(axial @ axis, trace - np.einsum("i,tij,j->t", axis, m, axis))
