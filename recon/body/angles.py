"""Joint angles after the recommendations of the International Society of Biomechanics.

Wu et al. 2002 (doi 10.1016/S0021-9290(01)00222-6) for the legs and the spine, Wu et al. 2005
(doi 10.1016/j.jbiomech.2004.05.042) for the arms, Baker 2001 (doi 10.1016/S0167-9457(00)00044-9)
for the order of the pelvis, with which tilt and obliquity do not depend on the heading.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from recon.body.model import BodyModel
from recon.body.segments import BONES, cardan, elevation_angles, isb_axes, posed_axes
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS, joint_index
from recon.core.units import to_z_up

_MIRROR = np.diag([1.0, 1.0, -1.0])
"""Left limbs are described as if they were right ones, so that signs mean the same."""


@dataclass(frozen=True)
class _JointAngles:
    """Three joint angles between two segments: rotation sequence, names and signs."""

    proximal: str
    distal: str
    order: str
    """Axes of the sequence; YXY is that of the shoulder."""
    names: tuple[str, str, str]
    """What each angle means where it is positive, in the order of the sequence."""
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def degrees(
        self, proximal: np.ndarray, distal: np.ndarray, side: str
    ) -> Float[np.ndarray, "time 3"]:
        """Return the three angles between two segments' axes; `side` is `l` or `r`."""
        relative = np.swapaxes(proximal, -1, -2) @ distal
        if side == "l":
            relative = _MIRROR @ relative @ _MIRROR
        angles = (
            elevation_angles(relative) if self.order == "YXY" else cardan(relative, self.order)
        )
        return np.rad2deg(angles) * self.signs


_MIDDLE = (
    _JointAngles(
        "ground", "pelvis", "YXZ",
        ("pelvis_left_rotation", "pelvis_left_up_obliquity", "pelvis_anterior_tilt"),
        (1.0, 1.0, -1.0),
    ),
    _JointAngles(
        "pelvis", "thorax", "ZXY",
        ("trunk_flexion", "trunk_right_bending", "trunk_left_rotation"), (-1.0, 1.0, 1.0),
    ),
)  # fmt: skip
_SIDED = (
    _JointAngles(
        "pelvis", "femur", "ZXY", ("hip_flexion", "hip_adduction", "hip_internal_rotation")
    ),
    _JointAngles(
        "femur", "tibia", "ZXY", ("knee_flexion", "knee_adduction", "knee_internal_rotation"),
        (-1.0, 1.0, 1.0),
    ),
    _JointAngles(
        "tibia", "foot", "ZXY",
        ("ankle_dorsiflexion", "ankle_inversion", "ankle_internal_rotation"),
    ),
    _JointAngles(
        "thorax", "humerus", "YXY",
        ("shoulder_plane_of_elevation", "shoulder_elevation", "shoulder_internal_rotation"),
    ),
    _JointAngles(
        "humerus", "forearm", "ZXY", ("elbow_flexion", "elbow_adduction", "forearm_pronation")
    ),
    _JointAngles(
        "forearm", "hand", "ZXY", ("wrist_flexion", "wrist_ulnar_deviation", "wrist_pronation")
    ),
)  # fmt: skip


_PAIRS = (
    *((one, one.proximal, one.distal, "") for one in _MIDDLE),
    *(
        (
            one,
            name if (name := one.proximal) in BONES else f"{name}_{end}",
            f"{one.distal}_{end}",
            end,
        )
        for end in ("r", "l")
        for one in _SIDED
    ),
)
"""Angles, their two segments, and the side of the body."""
ISB_ANGLES: tuple[str, ...] = tuple(
    f"{name}_{end}" if end else name for one, _, _, end in _PAIRS for name in one.names
)
"""Names of all angles, in the order of `isb_angles`."""


def isb_angles(motion: Motion, body: BodyModel) -> dict[str, Float[np.ndarray, " time"]]:
    """Joint angles of one clip in degrees, by name; names of left and right end in `_l`, `_r`.

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
    axes = _segment_axes(motion, body)
    angles = [triple.degrees(axes[near], axes[far], end) for triple, near, far, end in _PAIRS]
    return dict(zip(ISB_ANGLES, np.concatenate(angles, -1).T, strict=True))


def isb_angle_derivatives(motion: Motion, body: BodyModel) -> Float[np.ndarray, "time angles 66"]:
    """Derivatives of all angles by rotation steps w of the joints, R_j Exp(w_j), degrees / radian.

    A joint between two segments turns the distal one, whose axes are A, by Aᵀ O_j w_j about its
    own axes, with O_j the orientation of the joint's bone; how the angles change when a segment
    turns about its own axes is a difference.

    Args:
        motion: one clip without a batch axis.
        body: whose motion it is; the bundled one, whose landmarks are known.

    Raises:
        ValueError: when the body is another one.
    """
    axes, turns = _segment_axes(motion, body), so3.exp(_STEP * torch.eye(3).double()).numpy()
    bones = body.pose(motion).orientations.detach().double().cpu().numpy()
    found = np.zeros((motion.frames, len(_PAIRS), 3, 22, 3))
    for row, (triple, near, far, end) in enumerate(_PAIRS):
        before, after = axes[near], axes[far]
        unturned = triple.degrees(before, after, end)
        change = np.stack([triple.degrees(before, after @ turn, end) for turn in turns], -1)
        change -= unturned[..., None]
        by_own_axes = (change - 360 * np.round(change / 360)) / _STEP
        for joint in _joints_between(near, far):
            own = np.swapaxes(after, -1, -2) @ bones[:, joint]
            found[:, row, :, joint] = by_own_axes @ own
    return found.reshape(motion.frames, len(ISB_ANGLES), -1)


_STEP = 1e-4
"""Radians by which a segment is turned where derivatives are differences."""


def _segment_axes(motion: Motion, body: BodyModel) -> dict[str, Float[np.ndarray, "time 3 3"]]:
    """Return each segment's axes in every frame, in the world, and those of the ground."""
    axes = posed_axes(isb_axes(body, motion.shape), body, motion)
    return axes | {"ground": np.broadcast_to(to_z_up("y"), axes["pelvis"].shape)}


def _joints_between(proximal: str, distal: str) -> list[int]:
    """Return the joints on the path from a proximal to a distal segment, distal joint first."""
    last = -1 if proximal == "ground" else joint_index(BONES[proximal])
    joints = [joint_index(BONES[distal])]
    while PARENTS[joints[-1]] != last:
        joints.append(PARENTS[joints[-1]])
    return joints
