"""Writes motions on SMPL-family bodies, for robots and for users of SMPL."""

from pathlib import Path

import numpy as np
import torch

from recon.body.contacts import contact_labels, rest_heights
from recon.body.model import BodyModel
from recon.body.soles import Soles, Stance
from recon.core import rotations as so3
from recon.core.errors import ReconError
from recon.core.motion import Motion
from recon.core.skeleton import JOINTS
from recon.export.skeleton import one_clip
from recon.formats.replacing import save_arrays
from recon.formats.smpl import load_smpl
from recon.ingest.transfer import MotionOnOtherBody, aligned_at_rest, carried_rotations, transfer

FPS = 30.0
"""Frames per second of written motions, the rate at which GMR's loader keeps every frame."""
_BETAS = 16
_SMPLX_JOINTS = 55
_GENDERS = ("female", "male", "neutral")


def write_robot(path: Path, motion: Motion, body: BodyModel, smplx: Path) -> None:
    """Write a motion on SMPL-X for robot retargeting: 30 Hz, z up, soles on z = 0, contacts.

    Args:
        path: `.npz` to write.
        motion: one clip without a batch axis.
        body: the body model of the motion.
        smplx: the SMPL-X file of the body that the loader will pose; its name says the gender.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no SMPL-X file or its name says no gender, or the motion has a
            batch axis.
    """
    motion = one_clip(motion)
    gender = _gender_in_name(smplx)
    if gender is None:
        raise ReconError(
            f"{smplx}: expected a name with NEUTRAL, FEMALE or MALE in it, as SMPL-X files have: "
            "programs for robots choose their body file by the gender in this name"
        )
    if (count := len(load_smpl(smplx).parents)) != _SMPLX_JOINTS:
        raise ReconError(
            f"{smplx}: expected a SMPL-X body, which has {_SMPLX_JOINTS} joints, got {count}: "
            "programs for robots load no other bodies"
        )
    target = BodyModel.load(smplx)
    moved = motion_on_body(motion, body, target)
    joints = target.pose(moved).joints
    contacts = contact_labels(joints, rest_heights(target, moved.shape), FPS)
    standing = target.rest_vertices(moved.shape)[:, 1]
    arrays = _amass_arrays(moved, target, _SMPLX_JOINTS, gender)
    others = arrays["poses"][:, 3 * len(JOINTS) :]  # poses of jaw, eyes (both at rest) and hands
    arrays |= {
        "surface_model_type": np.array("smplx"),
        "mocap_frame_rate": np.array(FPS),
        "num_betas": np.array(len(moved.shape)),
        "pose_jaw": others[:, :3],
        "pose_eye": others[:, 3:9],
        "pose_hand": others[:, 9:],
        "global_joint_positions": joints.numpy(),
        "height": np.array(float(standing.max() - standing.min())),
        "contacts": contacts.numpy(),
        "joints": joints.numpy(),
        "joint_names": np.array(JOINTS),
    }
    save_arrays(path, arrays)


def _amass_arrays(
    motion: Motion, target: BodyModel, joints: int, gender: str
) -> dict[str, np.ndarray]:
    """Convert a motion to arrays in AMASS layout; beyond the 22 joints only fingers move."""
    poses = so3.log(motion.rotations.double()).float().numpy().reshape(motion.frames, -1)
    whole = np.zeros((motion.frames, 3 * joints), np.float32)
    whole[:, : poses.shape[1]] = poses
    if motion.hands is not None and joints >= len(JOINTS) + 30:
        whole[:, -90:] = motion.hands.arrays()["pose_hand"]
    return {
        "trans": motion.translation.numpy(),
        "poses": whole,
        "root_orient": poses[:, :3],
        "pose_body": poses[:, 3:],
        "betas": motion.shape.numpy(),
        "gender": np.array(gender),
        "start_time": np.array(motion.start_time),
        "up_axis": np.array("z"),
        "body": np.array(target.name),
        "body_checksum": np.array(target.checksum),
    }


def _gender_in_name(path: Path) -> str | None:
    """Return the gender that the name of a body file states; None if it states none."""
    return next((one for one in _GENDERS if one in path.stem.lower()), None)


def motion_on_body(motion: Motion, body: BodyModel, target: BodyModel) -> Motion:
    """Transfer a motion to another body at 30 Hz, with equal orientations and soles on z = 0.

    Args:
        motion: one clip without a batch axis.
        body: the body model of the motion.
        target: the body to move; its first 16 shape coefficients are used.
    """
    motion = motion.resample(FPS)
    count = min(_BETAS, target.shape_size)
    if target.checksum == body.checksum and not bool(motion.shape[count:].any()):
        moved = motion.replace(shape=motion.shape[:count])
    else:
        own, theirs = body.to(dtype=torch.float64), target.to(dtype=torch.float64)
        exact = motion.to(dtype=torch.float64)
        rest = aligned_at_rest(own, exact.shape, theirs, count)
        local, place = carried_rotations(exact, own, theirs, rest)
        moved = exact.replace(rotations=local, translation=place, shape=rest.shape)
        moved = moved.to(dtype=motion.translation.dtype)
    height = Stance.of(moved, target, Soles.of(target)).ground_height()
    down = moved.translation.new_tensor([0.0, 0.0, height])
    return moved.replace(translation=moved.translation - down)


def write_smpl(path: Path, motion: Motion, body: BodyModel, onto: Path) -> MotionOnOtherBody:
    """Write a motion in AMASS layout on a user's SMPL-family body; z up, metres.

    `poses` has as many joints as the file (SMPL 24, SMPL-H 52, SMPL-X 55); of those beyond the
    22 of the body, only fingers move. `betas` are coefficients of that file's shapes.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: the body model of the motion.
        onto: the body file that will be posed.

    Raises:
        FileNotFoundError: when there is no such body file.
        ValueError: when it is no body of the SMPL family.
    """
    target = BodyModel.load(onto)
    found = transfer(motion, body, target)
    moved = found.motion.replace(hands=motion.hands)
    arrays = _amass_arrays(
        moved, target, len(load_smpl(onto).parents), _gender_in_name(onto) or "neutral"
    )
    arrays |= {name: np.array(moved.fps) for name in ("mocap_framerate", "mocap_frame_rate")}
    save_arrays(path, arrays)
    return found
