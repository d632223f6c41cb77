"""Reads camera calibrations of several programs into one mapping from names to cameras.

Formats are TOML (Pose2Sim, Anipose, FreeMoCap, caliscope), OpenCV YAML (EasyMocap's `intri.yml`
with `extri.yml`, or one file per camera), PROX's JSON and plain .npz files. All state poses from
world to camera, with OpenCV's axes.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from recon.core.camera import check_pose
from recon.core.errors import FormatError
from recon.core.limits import CALIBRATION
from recon.core.units import METRES, Up, to_z_up
from recon.formats.cameras import CameraArrays, CameraFields, checked_camera
from recon.formats.json_files import read_json
from recon.formats.opencv_yaml import read_opencv_yaml
from recon.formats.opening import existing_file, load_arrays
from recon.formats.texts import read_toml


def toml_cameras(path: Path) -> dict[str, CameraFields]:
    """Read the cameras of a TOML calibration, keyed by name; their values are not checked yet.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, two cameras have one name, or a lens is a fisheye.
    """
    tables = read_toml(path)
    found, cameras = tables.get("cameras"), dict[str, CameraFields]()
    if isinstance(found, dict) and "matrix" not in found:  # caliscope: [cameras.0], [cameras.1]
        tables = {f"cam_{key}": one for key, one in found.items()}
    for key, table in tables.items():
        if not isinstance(table, dict) or "matrix" not in table or table.get("ignore") is True:
            continue
        name = str(table.get("name") or key)
        if name in cameras:
            raise FormatError(f"{path}: expected every camera's name once, got {name} twice")
        if table.get("fisheye"):
            raise FormatError(
                f"{path}, camera {name}: fisheye lenses are not read; undistort the keypoints or "
                "the images, and give a calibration with fisheye = false"
            )
        cameras[name] = CameraFields(
            name=name, matrix=table["matrix"], size=table.get("size"),
            distortion=table.get("distortions"), rotation=table.get("rotation"),
            translation=table.get("translation"),
        )  # fmt: skip
    if len(cameras) == 0:
        raise FormatError(
            f"{path}: expected tables of cameras with matrix, rotation and translation, found "
            f"{', '.join(tables) or 'none'}"
        )
    return cameras


def camera_table(name: str, camera: CameraArrays) -> str:
    """Format a fixed camera as a TOML table, as Pose2Sim writes it and `--camera` reads it.

    The table of a camera without a pose has neither rotation nor translation.
    """
    distortion = [0.0] * 4 if camera.distortion is None else camera.distortion.tolist()
    pose = ""
    if camera.T_camera_world is not None:
        from scipy.spatial.transform import Rotation  # slow to import

        vector = Rotation.from_matrix(camera.T_camera_world[0, :3, :3]).as_rotvec()
        translation = camera.T_camera_world[0, :3, 3]
        pose = f"rotation = {vector.tolist()}\ntranslation = {translation.tolist()}\n"
    label, size = json.dumps(name), [float(one) for one in camera.image_size]
    return (
        f"[{label}]\nname = {label}\nsize = {size}\n"
        f"matrix = {camera.camera_matrix.tolist()}\ndistortions = {distortion}\n"
        f"{pose}"
        "fisheye = false\n"
    )


CameraUnit = Literal["m", "mm"]

_FARTHEST_METRES = 50.0
"""Distance of the farthest camera from the origin up to which the file's unit is the metre."""
_NEAREST_MILLIMETRES = 300.0
"""Distance of the farthest camera from the origin from which on the unit is the millimetre."""
_SUFFIXES = (".toml", ".yml", ".yaml", ".json", ".npz")
_IN_FOLDER = (".yml", ".yaml", ".npz")
"""Endings of calibration files of which a folder holds one per camera."""


@dataclass(frozen=True)
class Calibration:
    """Cameras that film one scene, with notes on how unit and up axis were decided."""

    cameras: Mapping[str, CameraArrays]
    """Cameras by name. Poses are in metres with world z up; the pose is None where the file has
    none."""
    unit: CameraUnit
    """Unit of the translations in the file."""
    decisions: tuple[str, ...]


def load_cameras(
    path: str | Path,
    *,
    unit: CameraUnit | None = None,
    up: Up | None = None,
    image_size: tuple[int, int] | None = None,
) -> Calibration:
    """Read a calibration file, or a folder of `intri.yml` and `extri.yml` or of single cameras.

    The files of Pose2Sim, in metres, and of Anipose and FreeMoCap, in millimetres, look the same.
    Without `unit`, the distance |t| of the farthest camera from the origin tells: up to 50 the
    unit is metres, from 300 on millimetres, and in between it is refused.

    Args:
        path: of the file or folder.
        unit: of the translations; None to tell it from them.
        up: axis of the calibration's world that points up; None for z. PROX's world is that of
            the depth sensor and not level, so its pose is only kept when this is given.
        image_size: width and height, pixels, of cameras whose file does not tell.

    Raises:
        FileNotFoundError: when the path does not exist.
        ValueError: when it is damaged, of an unknown kind, has a fisheye lens, no image size,
            or a unit that cannot be told.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such calibration")
    parts, decisions = _read_cameras(path, level=up is not None)
    if len(parts) == 0:
        raise FormatError(f"{path}: expected at least one camera, found none")
    cameras = {name: checked_camera(part, image_size, path) for name, part in parts.items()}
    chosen, reason = _unit_with_reason(cameras, unit, path)
    converted = {
        name: _in_metres_z_up(camera, METRES[chosen], up or "z")
        for name, camera in cameras.items()
    }
    for name, camera in converted.items():
        if camera.T_camera_world is not None:
            check_pose(camera.T_camera_world, path, f"pose of camera {name}")
    world = f"camera world {up or 'z'} up: " + ("given" if up else "believed")
    return Calibration(MappingProxyType(converted), chosen, (*decisions, reason, world))


def _read_cameras(path: Path, *, level: bool) -> tuple[dict[str, CameraFields], tuple[str, ...]]:
    if path.is_dir():
        if (path / "intri.yml").is_file():
            return read_opencv_yaml(path / "intri.yml"), ()
        files = sorted(one for one in path.iterdir() if one.suffix.lower() in _IN_FOLDER)
        tables = sorted(path.glob("*.toml"))
        if len(tables) == 1:
            return toml_cameras(tables[0]), ()
        if len(files) == 0:
            raise FormatError(
                f"{path}: expected intri.yml and extri.yml, one .toml, or one .yml or .npz file "
                "per camera in this folder"
            )
        found = [pair for one in files for pair in _read_cameras(one, level=level)[0].items()]
        if len(dict(found)) < len(found):
            raise FormatError(
                f"{path}: expected different names of cameras in all files, got "
                f"{', '.join(name for name, _ in found)}; rename those that occur twice"
            )
        return dict(found), ()
    existing_file(path)
    match path.suffix.lower():
        case ".toml":
            return toml_cameras(path), ()
        case ".yml" | ".yaml":
            return read_opencv_yaml(path), ()
        case ".json":
            return _read_prox(path, level=level)
        case ".npz":
            return {path.stem: _read_npz(path)}, ()
    raise FormatError(f"{path}: expected a calibration in one of {', '.join(_SUFFIXES)}")


def _read_prox(path: Path, *, level: bool) -> tuple[dict[str, CameraFields], tuple[str, ...]]:
    CALIBRATION.check(existing_file(path).stat().st_size, path)
    value = read_json(path)
    if not isinstance(value, dict) or "camera_mtx" not in value:
        raise FormatError(
            f"{path}: expected a calibration as in PROX, with camera_mtx, k, view_mtx"
        )
    part = CameraFields(
        name=path.stem, matrix=value["camera_mtx"], distortion=value.get("k"),
        pose=value.get("view_mtx") if level else None,
    )  # fmt: skip
    note = "the pose of PROX's camera relates it to a depth sensor, not to a level world: left out"
    return {path.stem: part}, () if level or "view_mtx" not in value else (note,)


def _read_npz(path: Path) -> CameraFields:
    arrays = load_arrays(path)
    if "camera_matrix" not in arrays:
        raise FormatError(
            f"{path}: expected camera_matrix, image_size, distortion and T_camera_world, found "
            f"{', '.join(sorted(arrays))}"
        )
    return CameraFields(
        name=path.stem, matrix=arrays["camera_matrix"], size=arrays.get("image_size"),
        distortion=arrays.get("distortion"), pose=arrays.get("T_camera_world"),
    )  # fmt: skip


def _unit_with_reason(
    cameras: Mapping[str, CameraArrays], unit: CameraUnit | None, path: Path
) -> tuple[CameraUnit, str]:
    if unit is not None:
        if unit not in ("m", "mm"):
            raise FormatError(f"--camera-unit must be m or mm, got {unit!r}")
        return unit, f"camera unit {unit}: given"
    poses = [c.T_camera_world for c in cameras.values() if c.T_camera_world is not None]
    if len(poses) == 0:
        return "m", "the cameras have no pose: the ground is unknown"
    far = max(float(np.linalg.norm(pose[:, :3, 3], axis=-1).max()) for pose in poses)
    if far <= _FARTHEST_METRES:
        return "m", f"camera unit m: the farthest camera is {far:.3g} m from the origin"
    if far >= _NEAREST_MILLIMETRES:
        metres = far * METRES["mm"]
        return "mm", f"camera unit mm: the farthest camera is then {metres:.3g} m from the origin"
    raise FormatError(
        f"{path}: the farthest camera is {far:.4g} units from the origin, which fits neither "
        "metres nor millimetres well; give --camera-unit m or --camera-unit mm"
    )


def _in_metres_z_up(camera: CameraArrays, metres: float, up: Up) -> CameraArrays:
    """Convert a camera's pose to metres, and its world to one with z up."""
    if camera.T_camera_world is None:
        return camera
    pose = camera.T_camera_world.copy()
    pose[:, :3, 3] *= metres
    pose[:, :3, :3] = pose[:, :3, :3] @ to_z_up(up).T
    return replace(camera, T_camera_world=pose)
