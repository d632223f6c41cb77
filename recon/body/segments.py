"""Axes of the body's segments; on a standing person x is forwards, y up, z to the right.

The axes are built once on the unposed body, from its joints and bony landmarks, and then carried
by the bones. `isb_axes` follows the International Society of Biomechanics (Wu et al. 2002,
doi 10.1016/S0021-9290(01)00222-6, and 2005, doi 10.1016/j.jbiomech.2004.05.042); `opensim_axes`
are the frames of the bodies of OpenSim's gait models, all of which are parallel in their zero
pose: upright, arms hanging, palms forwards, soles level.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.body.landmarks import landmark
from recon.body.model import BodyModel
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import joint_index

SIDES: Mapping[str, str] = MappingProxyType({"r": "right", "l": "left"})
"""The ending of a segment's name for each side of the body."""
BONES: Mapping[str, str] = MappingProxyType(
    {
        "pelvis": "pelvis",
        "thorax": "spine3",
        **{
            f"{segment}_{end}": f"{side}_{joint}"
            for end, side in SIDES.items()
            for segment, joint in {
                "femur": "hip", "tibia": "knee", "foot": "ankle", "toes": "foot",
                "humerus": "shoulder", "forearm": "elbow", "hand": "wrist",
            }.items()
        },
    }
)  # fmt: skip
"""The joint whose bone carries each segment."""
UP = np.array([0.0, 1.0, 0.0])

Axes = Mapping[str, Float[np.ndarray, "3 3"]]
"""Axes of every segment on the unposed body, as columns of a rotation."""


@dataclass(frozen=True)
class RestPoints:
    """Looks up joints and landmarks of the unposed body by name; positions in metres."""

    body: BodyModel
    shape: Tensor

    def joint(self, name: str) -> Float[np.ndarray, "3"]:
        """Position of a joint, metres."""
        return self.body.rest_joints(self.shape)[joint_index(name)].detach().double().numpy()

    def middle_of(self, *names: str) -> Float[np.ndarray, "3"]:
        """Mean position of landmarks of the skin, metres."""
        index = torch.tensor([landmark(name) for name in names])
        points = self.body.rest_vertices(self.shape, index)
        return points.detach().double().numpy().mean(0)

    def vector_to_right(self, side: str, medial: str, lateral: str) -> Float[np.ndarray, "3"]:
        """Return the vector between a medial and a lateral landmark, pointing right; metres."""
        name = SIDES[side]
        across = self.middle_of(f"{name}_{lateral}") - self.middle_of(f"{name}_{medial}")
        return across if side == "r" else -across


def isb_axes(body: BodyModel, shape: Float[Tensor, " shape"]) -> Axes:
    """Axes of segments by the recommendations of the ISB; the toes have none.

    The bundled body has no landmarks of the tibial condyles: the middle of the epicondyles of the
    femur stands for theirs. The foot's neutral position is the rest pose, in which it stands flat.

    Raises:
        ValueError: when the body is not the bundled one, whose landmarks alone are known.
    """
    points = rest_points(body, shape)
    across = points.middle_of("right_asis") - points.middle_of("left_asis")
    behind = points.middle_of("left_psis", "right_psis")
    front = points.middle_of("left_asis", "right_asis") - behind
    low, high = (points.middle_of("xiphoid", "t7"), points.middle_of("sternal_notch", "c7"))
    # the sagittal plane of the thorax contains the two landmarks at its upper end
    depth = points.middle_of("sternal_notch") - points.middle_of("c7")
    axes = {
        "pelvis": _axes_along_z(across, np.cross(across, front)),
        "thorax": axes_along_y(high - low, np.cross(depth, high - low)),
    }
    for end, side in SIDES.items():
        knee = points.middle_of(f"{side}_knee_lateral", f"{side}_knee_medial")
        elbow = points.middle_of(f"{side}_elbow_lateral", f"{side}_elbow_medial")
        wrist = points.middle_of(f"{side}_wrist_radial", f"{side}_wrist_ulnar")
        hip, shoulder = points.joint(f"{side}_hip"), points.joint(f"{side}_shoulder")
        ankle = points.middle_of(f"{side}_ankle_lateral", f"{side}_ankle_medial")
        malleoli = points.vector_to_right(end, "ankle_medial", "ankle_lateral")
        tibia = _axes_along_z(malleoli, knee - ankle)
        knuckles = points.middle_of(f"{side}_index_knuckle", f"{side}_pinky_knuckle")
        axes |= {
            f"femur_{end}": axes_along_y(
                hip - knee, points.vector_to_right(end, "knee_medial", "knee_lateral")
            ),
            f"tibia_{end}": tibia,
            f"foot_{end}": axes_along_y(UP, tibia[:, 2]),
            f"humerus_{end}": axes_along_y(
                shoulder - elbow, points.vector_to_right(end, "elbow_medial", "elbow_lateral")
            ),
            f"forearm_{end}": axes_along_y(
                elbow - points.middle_of(f"{side}_wrist_ulnar"),
                points.vector_to_right(end, "wrist_ulnar", "wrist_radial"),
            ),
            f"hand_{end}": axes_along_y(
                wrist - knuckles, points.vector_to_right(end, "pinky_knuckle", "index_knuckle")
            ),
        }
    return axes


def posed_axes(
    axes: Axes, body: BodyModel, motion: Motion
) -> dict[str, Float[np.ndarray, "time 3 3"]]:
    """Return the axes of every segment in every frame of a clip, in world coordinates.

    Args:
        axes: on the unposed body.
        body: whose motion it is.
        motion: one clip without a batch axis.
    """
    orientations = body.pose(motion).orientations.detach().double().cpu().numpy()
    return {name: orientations[:, joint_index(BONES[name])] @ at for name, at in axes.items()}


def rest_points(body: BodyModel, shape: Tensor) -> RestPoints:
    """Return the lookup of joints and landmarks of the unposed bundled body.

    Raises:
        ReconError: when the body is another one, whose landmarks are not known.
    """
    if body.checksum != BodyModel.load().checksum:
        raise ReconError(
            f"joint angles need bony landmarks, which are known of the bundled body only, not of "
            f"{body.name!r}: export a motion of the bundled body"
        )
    return RestPoints(body, shape)


def axes_along_y(up: np.ndarray, right: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Orthonormal axes with y along `up` and z in the plane of `up` and `right`."""
    y = up / np.linalg.norm(up)
    x = np.cross(y, right)
    x /= np.linalg.norm(x)
    return np.stack((x, y, np.cross(x, y)), -1)


def _axes_along_z(right: np.ndarray, up: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Orthonormal axes with z along `right` and y in the plane of `right` and `up`."""
    z = right / np.linalg.norm(right)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.stack((x, np.cross(z, x), z), -1)


_LOCKED = 1e-6
"""Distance from gimbal lock, as the sine of an angle, below which only the sum or the difference
of the first and the last angle is known."""


def cardan(rotations: Float[np.ndarray, "time 3 3"], order: str) -> Float[np.ndarray, "time 3"]:
    """Angles (q1, q2, q3), radians, with R = R_a(q1) R_b(q2) R_c(q3) for three different axes.

    The middle angle begins within ±90°. From then on, of the two solutions that every rotation
    has, the one nearer to the frame before is taken, and whole turns are added, so that angles do
    not jump. Where the middle angle is ±90° the last one is held.

    Args:
        rotations: of the distal segment relative to the proximal one.
        order: three different letters of XYZ.
    """
    a, b, c = ("XYZ".index(letter) for letter in order)
    sign = 1.0 if (b - a) % 3 == 1 else -1.0
    r = rotations
    cosine = np.hypot(r[:, a, a], r[:, a, b])
    q1 = np.arctan2(-sign * r[:, b, c], r[:, c, c])
    q2 = np.arctan2(sign * r[:, a, c], cosine)
    q3 = np.arctan2(-sign * r[:, a, b], r[:, a, a])
    first = np.stack((q1, q2, q3), -1)
    second = np.stack((q1 + np.pi, np.pi - q2, q3 + np.pi), -1)
    # in gimbal lock R = R_a(q1 ± q3) R_b(±90°), so that only q1 ± q3 is known
    turned = np.arctan2(sign * r[:, c, b], r[:, b, b])
    return _without_jumps(first, second, cosine, turned, np.sign(r[:, a, c]))


def elevation_angles(rotations: Float[np.ndarray, "time 3 3"]) -> Float[np.ndarray, "time 3"]:
    """Angles (q1, e, q3), radians, with R = R_y(q1) R_x(-e) R_y(q3) and e from 0° to 180°.

    It is the sequence of the ISB for the shoulder: plane of elevation, elevation, axial rotation.
    Where the elevation is 0° or 180° the last angle is held.
    """
    r = rotations
    sine = np.hypot(r[:, 0, 1], r[:, 2, 1])
    q1 = np.arctan2(-r[:, 0, 1], -r[:, 2, 1])
    q3 = np.arctan2(-r[:, 1, 0], r[:, 1, 2])
    angles = np.stack((q1, np.arctan2(sine, r[:, 1, 1]), q3), -1)
    # in gimbal lock R = R_y(q1 ± q3) R_x(0° or 180°), so that only q1 ± q3 is known
    turned = np.arctan2(-r[:, 2, 0], r[:, 0, 0])
    return _without_jumps(angles, angles, sine, turned, np.sign(r[:, 1, 1]))


def _without_jumps(
    first: Float[np.ndarray, "time 3"],
    second: Float[np.ndarray, "time 3"],
    lock_distance: Float[np.ndarray, " time"],
    known_angle: Float[np.ndarray, " time"],
    sign: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "time 3"]:
    """Choose one of two angle triples per frame so that angles do not jump between frames.

    Args:
        first: one solution of every frame.
        second: the other one.
        lock_distance: sine of the angle to gimbal lock.
        known_angle: q1 + sign q3, which is known in gimbal lock, too.
        sign: 1 or -1.
    """
    if (lock_distance < _LOCKED).any():
        return _continued_through_lock(first, second, lock_distance, known_angle, sign)
    both = np.stack((first, second))
    steps = both[None, :, 1:] - both[:, None, :-1]
    steps = np.abs(steps - 2 * np.pi * np.round(steps / (2 * np.pi))).sum(-1)
    branch = [0]
    # `follows` has, for each of a frame's two solutions, the index of the next frame's nearer one
    for follows in steps.argmin(1).T.tolist():
        branch.append(follows[branch[-1]])
    return np.unwrap(both[branch, np.arange(len(branch))], axis=0)


def _continued_through_lock(
    first: Float[np.ndarray, "time 3"],
    second: Float[np.ndarray, "time 3"],
    lock_distance: Float[np.ndarray, " time"],
    known_angle: Float[np.ndarray, " time"],
    sign: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "time 3"]:
    """Choose angle triples without jumps where some frames are in gimbal lock.

    A frame in gimbal lock takes the last angle of the frame before, so frames are done in order.
    """
    found = np.empty_like(first)
    before = np.zeros(3)
    for k in range(len(first)):
        if lock_distance[k] < _LOCKED:
            held = before[2]
            choices = [np.array([known_angle[k] - sign[k] * held, first[k, 1], held])]
        else:
            choices = [first[k]] if k == 0 else [first[k], second[k]]
        near = [one - 2 * np.pi * np.round((one - before) / (2 * np.pi)) for one in choices]
        if k == 0:
            near = choices
        before = found[k] = min(near, key=lambda q: float(np.abs(q - before).sum()))
    return found
