"""Reads and writes motions as AMASS .npz files with arrays that recon adds.

Files of AMASS (SMPL-H and SMPL-X) and of recon can be read. `poses` may have more than 22 joints,
of which fingers are kept; a file may give `root_orient`, `pose_body` and `pose_hand` instead.
"""

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from recon.core import limits
from recon.core import rotations as so3
from recon.core.errors import FormatError
from recon.core.limits import Limit
from recon.core.motion import MOTION_FORMAT, Motion, MotionFile
from recon.core.units import snapped_rate
from recon.formats.opening import load_arrays

if TYPE_CHECKING:
    from recon.core.motion import FilmingCamera

_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_GENDERS = ("neutral", "male", "female")
_EXTRA = {
    "joints": ("time", 22, 3),
    "contacts": ("time", 22),
    "contact_probability": ("time", 22),
    "ground": (4,),
    "ground_std": (2,),
    "joint_std": ("time", 22),
    "angle_std": ("time", 42),
    "observed": ("time", 22),
    "truth_visible": ("time", 22),
    "T_world_camera": ("poses", 4, 4),
    "in_camera": ("time", 6),
}
"""Optional arrays of a motion file, fields of `MotionFile`, and their shapes."""
_CAMERAS = {
    "camera_matrix": ("views", 3, 3),
    "camera_size": ("views", 2),
    "camera_distortion": ("views", 8),
    "camera_pose": ("views", "poses", 4, 4),
    "camera_start": ("views",),
}
"""Arrays of the cameras that filmed the motion and their shapes; `camera_names` names them."""
_FLAGS = ("observed", "truth_visible")
"""Optional arrays that are masks."""
_RANGES: dict[str, Limit] = {
    "trans": limits.POSITION,
    "joints": limits.POSITION,
    "contacts": limits.PROBABILITY,
    "contact_probability": limits.PROBABILITY,
    "ground_std": limits.DEVIATION,
    "joint_std": limits.DEVIATION,
    "angle_std": limits.ANGLE_DEVIATION,
    "truth_visible": limits.PROBABILITY,
    "observed": limits.PROBABILITY,
}
"""Plausible range of the numbers in each array."""
_FINGERS = (156, 165)
"""Numbers of columns of `poses` with fingers: of SMPL-H and of SMPL-X, three per joint."""
_UNIT_NORMAL = 0.01
"""Greatest deviation of the length of the ground's normal from one."""


def load_motion(path: str | Path, dtype: torch.dtype = torch.float32) -> MotionFile:
    """Read a motion file, an .npz in the layout of AMASS.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, lacks a key (the message names those expected and found),
            holds NaN or infinity, has arrays of the wrong shape or type, or numbers outside the
            ranges of `recon.core.limits`.
    """
    path = Path(path)
    return motion_from(load_arrays(path), path, dtype)


def holds_motion(path: str | Path) -> bool:
    """Whether a file holds a motion with a frame rate, and not an observation or something else.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is an .npz file that is damaged.
    """
    path = Path(path)
    if path.suffix.lower() != ".npz":
        return False
    names = load_arrays(path).keys()
    return "trans" in names and "kind" not in names and any(key in names for key in _RATES)


def motion_from(
    arrays: dict[str, np.ndarray], path: Path, dtype: torch.dtype = torch.float32
) -> MotionFile:
    """Build a motion from the arrays of a motion file.

    Args:
        arrays: keyed by the names of the AMASS layout.
        path: of the file, for messages.
        dtype: precision of the motion.

    Raises:
        ValueError: as `load_motion` does.
    """
    _check_keys(path, arrays)
    numeric = {k: v for k, v in arrays.items() if v.dtype.kind in "fiub"}
    known = ("trans", "poses", "root_orient", "pose_body", "betas", "format_version", "start_time")
    for key in (*known, *_RATES, *_EXTRA, *_CAMERAS):
        if key in arrays and key not in numeric:
            raise FormatError(f"{path}: expected numbers in {key}, got {arrays[key].dtype}")
    translation = _checked(path, numeric, "trans", ("time", 3))
    poses = _rotation_vectors(path, numeric)
    if len(poses) != len(translation) or len(poses) == 0:
        raise FormatError(
            f"{path}: expected as many frames in trans as in poses, and at least one; got "
            f"{len(translation)} and {len(poses)}"
        )
    limits.FRAMES.check(len(poses), path, "poses")
    version = int(_number_or_default(path, numeric, "format_version", 0.0))
    if version > MOTION_FORMAT or version < 0:
        raise FormatError(f"{path}: written by a newer version (format {version}); update recon")
    if (up := _text_or_default(arrays, "up_axis", "z")) != "z":
        raise FormatError(f"{path}: expected a motion with z up, as in AMASS; its up axis is {up}")
    rate = next(key for key in _RATES if key in arrays)
    fps = snapped_rate(_number_or_default(path, numeric, rate, 0.0, limits.FRAME_RATE))
    motion = Motion.create(
        translation=torch.from_numpy(translation).to(dtype),
        rotations=so3.exp(torch.from_numpy(poses[:, :66].reshape(-1, 22, 3))).to(dtype),
        shape=torch.from_numpy(_shape_coefficients(path, numeric)).to(dtype),
        fps=fps,
        start_time=_number_or_default(path, numeric, "start_time", 0.0, limits.TIME),
    )
    if "pose_hand" in numeric or poses.shape[1] in _FINGERS:
        from recon.core.fingers import hands_of_arrays  # imported only for fingers

        motion = motion.replace(hands=hands_of_arrays(numeric, path, dtype))
    gender = _text_or_default(arrays, "gender", "neutral").lower()
    extra = {
        key: _as_tensor(_checked(path, numeric, key, shape, time=len(poses)), dtype)
        for key, shape in _EXTRA.items()
        if key in arrays
    }
    _check_ground_and_camera(path, extra)
    extra |= {key: extra[key] > 0.5 for key in _FLAGS if key in extra}
    return MotionFile(
        motion,
        body=_text_or_default(arrays, "body", "") or None,
        checksum=_text_or_default(arrays, "body_checksum", "") or None,
        gender=gender if gender in _GENDERS else "neutral",
        cameras=_make_cameras(path, arrays, len(poses), dtype) if "camera_names" in arrays else (),
        format_version=version,
        **extra,
    )


def save_motion(path: str | Path, file: MotionFile | Motion) -> None:
    """Write a motion file atomically; reading it gives the same record back.

    Raises:
        ValueError: when it has a batch axis, no frames, or NaN or infinity in it.
    """
    from recon.formats.replacing import save_arrays  # imported only when a motion is written

    path = Path(path)
    file = MotionFile(file) if isinstance(file, Motion) else file
    motion = file.motion
    if motion.translation.ndim != 2:
        raise FormatError(
            "expected one clip without a batch axis, got translations of shape "
            f"{tuple(motion.translation.shape)}; save motion[k]"
        )
    frames = int(motion.valid.sum())
    if frames == 0 or not bool(motion.valid[:frames].all()):
        raise FormatError("expected a clip whose missing frames are all at its end")
    precision = motion.translation.dtype
    # doubles, since the logarithm loses half of its digits near 180 degrees
    poses = so3.log(motion.rotations[:frames].detach().double().cpu()).to(precision)
    arrays: dict[str, np.ndarray] = {
        "trans": _as_numpy(motion.translation[:frames]),
        "poses": _as_numpy(poses.flatten(-2)),
        "root_orient": _as_numpy(poses[:, 0]),
        "pose_body": _as_numpy(poses[:, 1:].flatten(-2)),
        "betas": _as_numpy(motion.shape),
        "gender": np.array(file.gender),
        "mocap_framerate": np.array(motion.fps),
        "mocap_frame_rate": np.array(motion.fps),
        "start_time": np.array(motion.start_time),
        "up_axis": np.array("z"),
        "body": np.array(file.body or ""),
        "body_checksum": np.array(file.checksum or ""),
        "format_version": np.array(file.format_version),
    }
    if motion.hands is not None:
        arrays |= (hands := motion.hands.window(0, frames).arrays())
        arrays["poses"] = np.concatenate((arrays["poses"], hands["pose_hand"]), -1)
    for key, shape in _EXTRA.items():
        value: Tensor | None = getattr(file, key)
        if value is not None:
            per_frame = shape[0] == "time" or (shape[0] == "poses" and len(value) == motion.frames)
            arrays[key] = _as_numpy(value[:frames] if per_frame else value)
    if file.cameras:
        arrays |= _camera_arrays(file.cameras, frames)
    if bad := [k for k, v in arrays.items() if v.dtype.kind == "f" and not np.isfinite(v).all()]:
        raise FormatError(f"{path}: not written, as {', '.join(bad)} hold NaN or infinity")
    save_arrays(path, arrays)


def _camera_arrays(cameras: "tuple[FilmingCamera, ...]", frames: int) -> dict[str, np.ndarray]:
    """Stack cameras into the arrays of a file; if one moves, all get a pose per frame."""
    models = [one.camera for one in cameras]
    count = max(len(one.T_camera_world) for one in models)
    poses = [one.T_camera_world.expand(count, 4, 4)[:frames] for one in models]
    lens = [torch.zeros(0) if one.distortion is None else one.distortion for one in models]
    return {
        "camera_names": np.array([one.name for one in cameras]),
        "camera_matrix": _as_numpy(torch.stack([one.camera_matrix for one in models])),
        "camera_size": np.array([one.image_size for one in models]),
        "camera_distortion": np.stack([np.pad(_as_numpy(one), (0, 8 - len(one))) for one in lens]),
        "camera_pose": _as_numpy(torch.stack(poses)),
        "camera_start": np.array([one.start_time for one in cameras]),
    }


def _make_cameras(
    path: Path, arrays: dict[str, np.ndarray], frames: int, dtype: torch.dtype
) -> "tuple[FilmingCamera, ...]":
    """Build the cameras that filmed a motion from the arrays of its file.

    Raises:
        ValueError: when arrays are missing, of the wrong shape, or impossible for a camera.
    """
    from recon.core.camera import Camera, check_camera, check_pose  # imported only for cameras
    from recon.core.motion import FilmingCamera

    names = np.atleast_1d(arrays["camera_names"]).astype(str).tolist()
    if missing := [key for key in _CAMERAS if key not in arrays]:
        raise FormatError(f"{path}: has camera_names, but lacks {', '.join(missing)}")
    found = {key: _checked(path, arrays, key, shape, frames) for key, shape in _CAMERAS.items()}
    if counts := {key: len(one) for key, one in found.items() if len(one) != len(names)}:
        raise FormatError(f"{path}: expected {len(names)} cameras in all arrays, got {counts}")
    limits.TIME.check(found["camera_start"], path, "camera_start")
    check_pose(found["camera_pose"], path, "camera_pose")
    cameras: list[FilmingCamera] = []
    for name, matrix, size, lens, pose, start in zip(names, *found.values(), strict=True):
        width, height = size.astype(int).tolist()
        distortion = lens if lens.any() else None
        check_camera(matrix, (width, height), distortion, path, name)
        camera = Camera(
            _as_tensor(matrix, dtype), (width, height),
            None if distortion is None else _as_tensor(distortion, dtype), _as_tensor(pose, dtype),
        )  # fmt: skip
        cameras.append(FilmingCamera(name, camera, float(start)))
    return tuple(cameras)


def _check_keys(path: Path, arrays: dict[str, np.ndarray]) -> None:
    missing = [key for key in ("trans", "betas") if key not in arrays]
    if "poses" not in arrays and not {"root_orient", "pose_body"} <= set(arrays):
        missing.append("poses")
    if not any(key in arrays for key in _RATES):
        missing.append("mocap_framerate")
    if missing:
        raise FormatError(
            f"{path}: expected a motion in AMASS layout with trans, poses, betas and "
            f"mocap_framerate; missing {', '.join(missing)}; found {', '.join(sorted(arrays))}"
        )


def _rotation_vectors(path: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    if "poses" in arrays:
        poses = arrays["poses"]
    else:
        parts = [arrays[key] for key in ("root_orient", "pose_body")]
        if any(part.ndim not in (2, 3) for part in parts) or len(parts[0]) != len(parts[1]):
            raise FormatError(
                f"{path}: expected root_orient (T, 3) and pose_body (T, 63), got {parts[0].shape} "
                f"and {parts[1].shape}"
            )
        rows = len(parts[0])
        poses = np.concatenate([part.reshape(rows, -1 if rows else 0) for part in parts], axis=1)
    limits.check_rotation_vectors(poses, path, "poses")
    if poses.ndim == 3 and poses.shape[2] == 3:
        poses = poses.reshape(len(poses), -1)
    if poses.ndim != 2 or poses.shape[1] < 66 or poses.shape[1] % 3:
        raise FormatError(
            f"{path}: expected poses (T, 66) or longer rows, axis-angle with the root first; got "
            f"{poses.shape}"
        )
    _check_finite(path, "poses", poses)
    return poses.astype(np.float64)


def _check_ground_and_camera(path: Path, extra: dict[str, Tensor]) -> None:
    """Refuse a ground without a unit normal, and cameras with wrong poses.

    Raises:
        ValueError: naming file, quantity and what came.
    """
    if "ground" in extra:
        ground = extra["ground"].double().numpy()
        length = float(np.linalg.norm(ground[:3]))
        if not abs(length - 1) < _UNIT_NORMAL:
            raise FormatError(
                f"{path}: expected ground (nx, ny, nz, d) with a normal of length 1, got "
                f"{length:g}"
            )
        limits.POSITION.check(ground[3], path, "ground[3]")
    if "T_world_camera" in extra:
        from recon.core.camera import check_pose  # imported only for cameras

        check_pose(extra["T_world_camera"].double().numpy(), path, "T_world_camera")
    if "in_camera" in extra:
        place = extra["in_camera"].double().numpy()
        limits.POSITION.check(place[:, :3], path, "in_camera[:, :3]")
        limits.ROTATION.check(place[:, 3:], path, "in_camera[:, 3:]")


def _shape_coefficients(path: Path, arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Return the shape coefficients (S,); some files repeat them in every frame."""
    betas = arrays["betas"].astype(np.float64)
    if betas.ndim == 2 and len(betas) > 0 and np.allclose(betas, betas[:1], atol=1e-6):
        betas = betas[0]
    if betas.ndim != 1:
        raise FormatError(
            f"{path}: expected betas (S,), one shape for the clip; got {betas.shape}"
        )
    limits.SHAPES.check(len(betas), path, "betas")
    limits.SHAPE.check(betas, path, "betas")
    return betas


def _checked(
    path: Path,
    arrays: dict[str, np.ndarray],
    key: str,
    shape: tuple[str | int, ...],
    time: int | None = None,
) -> np.ndarray:
    if key not in arrays:
        raise FormatError(f"{path}: expected numbers in {key}, which is missing")
    value = arrays[key]
    if key == "T_world_camera" and value.shape == (4, 4):
        value = value[None]
    allowed = {"time": (time,), "poses": (1, time), "views": (len(value),) if value.ndim else ()}
    fits = value.ndim == len(shape) and all(
        got == want if isinstance(want, int) else time is None or got in allowed[want]
        for got, want in zip(value.shape, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join(str(time) if s == "time" and time else str(s) for s in shape)
        raise FormatError(f"{path}: expected {key} of shape ({wanted}), got {value.shape}")
    _check_finite(path, key, value)
    if key in _RANGES:
        _RANGES[key].check(value, path, key)
    return value.astype(np.float64)


def _check_finite(path: Path, key: str, value: np.ndarray) -> None:
    if not np.isfinite(value).all():
        raise FormatError(f"{path}: {key} holds NaN or infinity; missing frames must be cut out")


def _number_or_default(
    path: Path,
    arrays: dict[str, np.ndarray],
    key: str,
    default: float,
    limit: Limit | None = None,
) -> float:
    value = arrays.get(key, np.array(default))
    if value.size != 1 or not np.isfinite(value).all():
        raise FormatError(f"{path}: expected one number in {key}, got {value.shape}")
    if limit is not None:
        limit.check(value.reshape(()), path, key)
    return float(value.reshape(()))


def _text_or_default(arrays: dict[str, np.ndarray], key: str, default: str) -> str:
    value = arrays.get(key, np.array(default))
    if value.size != 1 or value.dtype.kind not in "US":
        return default
    item = value.reshape(()).item()
    return item.decode("latin-1") if isinstance(item, bytes) else str(item)


def _as_tensor(array: np.ndarray, dtype: torch.dtype) -> Tensor:
    return torch.from_numpy(array).to(dtype)


def _as_numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()


assert {f.name for f in fields(MotionFile)} >= set(_EXTRA)
