"""Writes skeleton recordings and motions as BVH files."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from recon.body.model import BodyModel
from recon.core.bone_names import BoneNames, joint_names_in
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS, PARENTS
from recon.core.units import METRES, to_z_up
from recon.export.skeleton import offsets_from_parents
from recon.formats.replacing import write_text
from recon.mocap.recording import SkeletonRecording

Order = Literal["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]


def skeleton_of(motion: Motion, body: BodyModel, name: str) -> SkeletonRecording:
    """Convert a motion to a skeleton recording, with the tips of its five end bones.

    The tip of a bone, `<joint>_end`, is the vertex of its skin that is farthest from the joint:
    the crown, the toes, the fingertips.
    """
    if motion.hands is not None:
        return _skeleton_with_fingers(motion, body, name)
    posed = body.pose(motion)
    rest = body.rest_joints(motion.shape).detach().double().cpu().numpy()
    last = [joint for joint in range(len(JOINTS)) if joint not in PARENTS]
    tips = np.stack([_vector_to_tip(joint, rest[joint], motion, body) for joint in last])
    positions = posed.joints.detach().double().cpu().numpy()
    orientations = posed.orientations.detach().double().cpu().numpy()
    ends = positions[:, last] + (orientations[:, last] @ tips[..., None])[..., 0]
    return SkeletonRecording(
        name=name,
        joint_names=(*JOINTS, *(f"{JOINTS[joint]}_end" for joint in last)),
        parents=(*PARENTS, *last),
        rest_offsets=np.concatenate((offsets_from_parents(rest), tips)),
        positions=np.concatenate((positions, ends), axis=1),
        orientations=np.concatenate((orientations, orientations[:, last]), axis=1),
        fps=motion.fps,
        decisions=(),
    )


def _skeleton_with_fingers(motion: Motion, body: BodyModel, name: str) -> SkeletonRecording:
    """Convert a motion with fingers to a skeleton recording, ending in fingertips, not wrists."""
    from recon.body.hands import finger_offsets, pose_fingers  # imported only for fingers
    from recon.core.fingers import HAND_JOINTS, HAND_PARENTS

    body_only = skeleton_of(motion.replace(hands=None), body, name)
    count, joints = len(JOINTS), len(HAND_JOINTS)
    wrists = [JOINTS.index("left_wrist"), JOINTS.index("right_wrist")]
    ends = [k for k in range(count, len(body_only.parents)) if body_only.parents[k] not in wrists]
    places, turns = (one.detach().double().cpu().numpy() for one in pose_fingers(motion, body))
    offsets = finger_offsets(motion, body).detach().double().cpu().numpy()
    tips = np.array(HAND_PARENTS[joints:]) - count
    names = [*HAND_JOINTS, *(f"{HAND_JOINTS[k]}_end" for k in tips)]

    def joined(of_body: np.ndarray, of_fingers: np.ndarray, axis: int) -> np.ndarray:
        kept = (np.take(of_body, range(count), axis), of_fingers, np.take(of_body, ends, axis))
        return np.concatenate(kept, axis)

    return replace(
        body_only, joint_names=(*JOINTS, *names, *(body_only.joint_names[k] for k in ends)),
        parents=(*PARENTS, *HAND_PARENTS, *(body_only.parents[k] for k in ends)),
        rest_offsets=joined(body_only.rest_offsets, offsets, 0),
        positions=joined(body_only.positions, places, 1),
        orientations=joined(body_only.orientations, np.concatenate((turns, turns[:, tips]), 1), 1),
    )  # fmt: skip


def _vector_to_tip(
    joint: int, joint_position: np.ndarray, motion: Motion, body: BodyModel
) -> np.ndarray:
    """Return the vector from a joint to the farthest vertex of its bone at rest, metres.

    The vector is zero where the bone carries no skin.
    """
    vertices_of_bone = (body.weights.argmax(-1) == joint).nonzero()[:, 0]
    if len(vertices_of_bone) == 0:
        return np.zeros(3)
    vertices = (
        body.rest_vertices(motion.shape, vertices_of_bone).detach().double().cpu().numpy()
        - joint_position
    )
    return vertices[np.linalg.norm(vertices, axis=-1).argmax()]


def write_bvh(
    path: Path,
    recording: SkeletonRecording,
    *,
    unit: Literal["m", "cm", "mm", "inch", "cmu"] = "cm",
    order: Order = "ZYX",
    bones: BoneNames = "smpl",
) -> None:
    """Write a skeleton recording as BVH without loss: y up, one Euler order for all joints.

    Joints that move within their parent get position channels; joints called `<parent>_end`
    become end sites. The root's OFFSET is zero: some programs add it to its position channels,
    others take these instead of it. `bones` chooses another program's names for body joints.
    """
    # imported only when needed, since it loads slowly
    from scipy.spatial.transform import Rotation

    turn, scale = to_z_up("y").T, 1 / METRES[unit]
    # enough decimals for positions exact to 0.01 micrometres
    decimals = 8 if METRES[unit] == 1 else 6
    world = turn @ recording.orientations
    places = recording.positions @ (turn.T * scale)
    offsets = recording.rest_offsets * scale
    theirs = joint_names_in(recording.joint_names, bones)
    # three.js finds no joint whose name has a colon, as Mixamo's names have
    names = tuple(name.removeprefix("mixamorig:") for name in theirs)
    parents = recording.parents
    lines, columns = ["HIERARCHY"], list[np.ndarray]()

    def describe_joint(joint: int, indent: str) -> None:
        parent = parents[joint]
        children = [k for k, above in enumerate(parents) if above == joint]
        rest = offsets[joint] if parent >= 0 else np.zeros(3)
        offset = f"{indent}\tOFFSET {' '.join(f'{x:.{decimals}f}' for x in rest)}"
        if parent >= 0 and not children and names[joint] == f"{names[parent]}_end":
            lines.extend((f"{indent}End Site", f"{indent}{{", offset, f"{indent}}}"))
            return
        title = "ROOT" if parent < 0 else "JOINT"
        lines.extend((f"{indent}{title} {names[joint]}", f"{indent}{{", offset))
        rotations = " ".join(f"{axis}rotation" for axis in order)
        if parent < 0:
            shift, local = places[:, joint], world[:, joint]
        else:
            back = np.swapaxes(world[:, parent], -1, -2)
            shift = (back @ (places[:, joint] - places[:, parent])[..., None])[..., 0]
            local = back @ world[:, joint]
        if parent < 0 or np.abs(shift - offsets[joint]).max() > 1e-6 * scale:
            lines.append(f"{indent}\tCHANNELS 6 Xposition Yposition Zposition {rotations}")
            columns.append(shift)
        else:
            lines.append(f"{indent}\tCHANNELS 3 {rotations}")
        with warnings.catch_warnings():
            # the angles that scipy returns at gimbal lock are right, although it warns
            warnings.simplefilter("ignore", UserWarning)
            columns.append(Rotation.from_matrix(local).as_euler(order, degrees=True))
        for child in children:
            describe_joint(child, indent + "\t")
        lines.append(f"{indent}}}")

    for joint, parent in enumerate(parents):
        if parent < 0:
            describe_joint(joint, "")
    values = np.concatenate(columns, axis=1)
    row = " ".join([f"%.{decimals}f"] * values.shape[1])
    lines.extend(("MOTION", f"Frames: {len(values)}", f"Frame Time: {1 / recording.fps:.8f}"))
    lines.extend(row % tuple(frame) for frame in values.tolist())
    write_text(path, "\n".join(lines) + "\n")
