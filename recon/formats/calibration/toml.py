"""Calib.toml: one table per camera, as Pose2Sim, Anipose, FreeMoCap and caliscope write it."""

import tomllib
from pathlib import Path

from recon.core.errors import FormatError
from recon.core.limits import TABLE
from recon.formats.calibration.camera import CameraFields
from recon.formats.files.opening import decode, read_bytes


def read_toml(path: Path) -> dict[str, CameraFields]:
    """The cameras of a TOML file by name.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is damaged, two cameras have one name, or a lens is a fisheye.
    """
    try:
        tables = tomllib.loads(decode(read_bytes(path, TABLE)))
    except (ValueError, RecursionError) as error:
        # besides damage, numbers of more digits than Python converts
        raise FormatError(f"{path}: expected TOML, but it is damaged ({error})") from error
    cameras: dict[str, CameraFields] = {}
    for key, table in tables.items():
        if not isinstance(table, dict) or "matrix" not in table:
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
