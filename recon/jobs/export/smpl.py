"""Motions for people of SMPL: AMASS files with poses and betas of a body file that they have."""

from pathlib import Path

import numpy as np

from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.motion import Motion
from recon.formats.bodies.smpl import load_smpl
from recon.formats.files.opening import save_arrays
from recon.ingest.onto.transfer import Transferred, transfer

_GENDERS = ("female", "male", "neutral")


def write_smpl(path: Path, motion: Motion, body: BodyModel, onto: Path) -> Transferred:
    """Write a motion in AMASS layout on a body file of the SMPL family; z up, metres.

    `poses` has as many joints as the file (SMPL 24, SMPL-H 52, SMPL-X 55); those beyond the 22 of
    the body are at rest. `betas` are coefficients of that file's shapes.

    Args:
        path: file to write.
        motion: one clip without a batch axis.
        body: whose motion it is.
        onto: the body file that will be posed.

    Raises:
        FileNotFoundError: when there is no such body file.
        ValueError: when it is no body of the SMPL family.
    """
    target = BodyModel.load(onto)
    found = transfer(motion, body, target)
    moved = found.motion
    poses = so3.log(moved.rotations.double()).float().numpy()
    joints = len(load_smpl(onto).parents)
    whole = np.zeros((len(poses), joints, 3), np.float32)
    whole[:, : poses.shape[1]] = poses
    arrays = {
        "trans": moved.translation.numpy(),
        "poses": whole.reshape(len(poses), -1),
        "root_orient": poses[:, 0],
        "pose_body": poses[:, 1:].reshape(len(poses), -1),
        "betas": moved.shape.numpy(),
        "gender": np.array(_gender(onto)),
        "mocap_framerate": np.array(moved.fps),
        "mocap_frame_rate": np.array(moved.fps),
        "start_time": np.array(moved.start_time),
        "up_axis": np.array("z"),
        "body": np.array(target.name),
        "body_checksum": np.array(target.checksum),
    }
    save_arrays(path, arrays)
    return found


def _gender(onto: Path) -> str:
    """What the name of the body file says; neutral where it says nothing."""
    return next((one for one in _GENDERS if one in onto.stem.lower()), "neutral")
