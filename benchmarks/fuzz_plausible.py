"""Whether a reader's own record lies within the ranges of `recon.core.limits`."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch

from priors.checkpoints import Checkpoint
from recon.core import limits
from recon.core.limits import Limit, check_camera, check_pose
from recon.formats.calibration import Calibration
from recon.formats.detections.records import Detections
from recon.formats.mocap.recording import MarkerRecording, SkeletonRecording
from recon.formats.motions import MotionFile
from recon.formats.observations import CameraArrays, KeypointsFile, PointsFile, PositionsFile
from recon.formats.smpl import SmplArrays

_RANGES: dict[type, dict[str, Limit]] = {
    SkeletonRecording: {
        "positions": limits.POSITION, "rest_offsets": limits.POSITION, "fps": limits.FRAME_RATE,
    },
    MarkerRecording: {"positions": limits.POSITION, "fps": limits.FRAME_RATE},
    PositionsFile: {
        "positions": limits.POSITION, "fps": limits.FRAME_RATE, "start_time": limits.TIME,
        "std": limits.DEVIATION,
    },
    KeypointsFile: {
        "pixels": limits.PIXEL, "confidence": limits.CONFIDENCE, "fps": limits.FRAME_RATE,
        "start_time": limits.TIME,
    },
    PointsFile: {
        "points": limits.POSITION, "fps": limits.FRAME_RATE, "start_time": limits.TIME,
        "frame": limits.FRAME_NUMBER,
    },
    Detections: {
        "pixels": limits.PIXEL, "confidence": limits.PROBABILITY, "frame": limits.FRAME_NUMBER,
        "identity": limits.PERSON, "frame_numbers": limits.FRAME_NUMBER,
    },
    MotionFile: {
        "joints": limits.POSITION, "contacts": limits.PROBABILITY, "joint_std": limits.DEVIATION,
    },
    SmplArrays: {
        "template": limits.MODEL_LENGTH, "shape_directions": limits.MODEL_LENGTH,
        "pose_directions": limits.MODEL_LENGTH, "joint_regressor": limits.MODEL_WEIGHT,
        "weights": limits.MODEL_WEIGHT,
    },
}  # fmt: skip


def implausible(read: Any) -> str:
    """What is out of range in a record that a reader gave, or nothing."""
    try:
        _check(read)
    except ValueError as error:
        return str(error)[:200]
    return ""


def _check(read: Any) -> None:
    for name, array in _arrays(read):
        if not np.isfinite(array).all():
            raise ValueError(f"{type(read).__name__}.{name} holds NaN or infinity")
    for name, limit in _RANGES.get(type(read), {}).items():
        if (value := getattr(read, name)) is not None:
            limit.check(value, type(read).__name__, name)
    if isinstance(read, MotionFile):
        limits.POSITION.check(read.motion.translation, "motion", "translation")
        limits.SHAPE.check(read.motion.shape, "motion", "shape")
        limits.FRAME_RATE.check(read.motion.fps, "motion", "fps")
        limits.TIME.check(read.motion.start_time, "motion", "start_time")
    if isinstance(read, SkeletonRecording):
        turned = read.orientations @ np.swapaxes(read.orientations, -1, -2)
        limits.ORTHOGONALITY.check(np.abs(turned - np.eye(3)).max(), "recording")
    if isinstance(read, Checkpoint):
        for name, tensor in read.tensors.items():
            limits.NETWORK_WEIGHT.check(tensor.double().numpy(), "weights", name)
    cameras: list[Any] = [getattr(read, "camera", None)]
    if isinstance(read, Calibration):
        cameras = list(read.cameras.values())
    for camera in cameras:
        if isinstance(camera, CameraArrays):
            check_camera(camera.camera_matrix, camera.image_size, camera.distortion, "camera")
            if camera.T_camera_world is not None:
                check_pose(camera.T_camera_world, "camera", "pose")


def _arrays(read: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Every array of numbers in a record."""
    if not is_dataclass(read):
        return
    for one in fields(read):
        value = getattr(read, one.name)
        value = value.detach().numpy() if isinstance(value, torch.Tensor) else value
        if isinstance(value, np.ndarray) and value.dtype.kind in "fc":
            yield one.name, value
